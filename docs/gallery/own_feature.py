"""Your own feature: user-defined image processing finds the four corners of the target in each
image.
"""

import sys

from output import EXAMPLES, report_runs

from aras_visual_servo_bench import Experiment

sys.path.append(str(EXAMPLES))
mine = Experiment(scheme="own_corners:OwnCorners", start="2016", duration=5.0)
run, = report_runs({"own corners": mine}, "image_trajectory")
assert run.verdict.is_reached
