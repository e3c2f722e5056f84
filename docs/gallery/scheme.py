"""A scheme: image moments control the simulated arm, from the start pose of the paper of 2016."""

from output import report_runs

from aras_visual_servo_bench import Experiment

run, = report_runs({"moments": Experiment(scheme="moments", start="2016")}, "feature_errors")
assert run.is_success
