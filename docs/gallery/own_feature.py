"""Your own feature: four corners, found in the image by your own image processing."""

import sys

from output import EXAMPLES, report_runs

from aras_visual_servo_bench import Experiment

sys.path.append(str(EXAMPLES))
mine = Experiment(scheme="own_corners:OwnCorners", start="2016", duration=5.0)
run, = report_runs({"own corners": mine}, "image_trajectory")
assert run.verdict.is_reached
