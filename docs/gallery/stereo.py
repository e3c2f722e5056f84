"""Stereo: two cameras before an arm tell the depth by themselves, in a scheme of 32 lines."""

import os
import sys

from keeping import EXAMPLES, folder, keep_runs

from aras_visual_servo_bench import Experiment

sys.argv[1:] = [str(folder().resolve())]  # portal.yaml names its files as from its own folder
os.chdir(EXAMPLES)
sys.path.append(str(EXAMPLES))
portal = Experiment.from_yaml("portal.yaml")
(run,) = keep_runs(
    {"stereo": portal.with_changes(scheme="stereo_ibvs:StereoIBVS")}, "image_trajectory"
)
assert run.is_success
