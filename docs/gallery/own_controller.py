"""Your own controller: a user-defined model-predictive controller of 60 lines commands the joints
within their limits.
"""

import sys

from output import EXAMPLES, report_runs

from aras_visual_servo_bench import Experiment

sys.path.append(str(EXAMPLES))
mine = Experiment(scheme="joint_mpc:JointMPC", start="2016", duration=5.0)
run, = report_runs({"joint MPC": mine}, "joint_positions")
assert run.verdict.is_reached
