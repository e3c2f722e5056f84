"""A failure and its reason: with a delay of 0.2 s, a gain of 8 1/s makes the loop oscillate, and
the loop reports the cause.
"""

from output import report_runs

from aras_visual_servo_bench import Experiment

delayed = Experiment(plant="chain", delay=0.2, gain=8.0, duration=6.0)
run, remedied = report_runs(
    {"gain 8": delayed, "gain 2": delayed.with_changes(gain=2.0)}, "feature_errors"
)
assert run.outcome == "gain_too_high" and remedied.is_success
