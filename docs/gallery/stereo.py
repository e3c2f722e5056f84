"""Stereo: a scheme of 32 lines measures the depth of the target by two cameras in front of the arm,
without a model of the target.
"""

import os
import sys

from output import EXAMPLES, folder, report_runs

from aras_visual_servo_bench import Experiment

sys.argv[1:] = [str(folder().resolve())]  # paths in portal.yaml are relative to its folder
os.chdir(EXAMPLES)
sys.path.append(str(EXAMPLES))
portal = Experiment.from_yaml("portal.yaml")
(run,) = report_runs(
    {"stereo": portal.with_changes(scheme="stereo_ibvs:StereoIBVS")}, "image_trajectory"
)
assert run.is_success
