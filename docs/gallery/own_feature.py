"""Your own feature: four corners, found in the picture by image processing of its own."""

import sys

from keeping import EXAMPLES, keep_runs

from aras_visual_servo_bench import Experiment

sys.path.append(str(EXAMPLES))
mine = Experiment(scheme="own_corners:OwnCorners", start="2016", duration=5.0)
run, = keep_runs({"own corners": mine}, "image_trajectory")
assert run.verdict.is_reached
