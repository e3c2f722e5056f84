"""A failure and its reason: with a delay of 0.2 s a gain of 8 1/s is too high; the loop says so."""

from keeping import keep_runs

from aras_visual_servo_bench import Experiment

late = Experiment(plant="chain", delay=0.2, gain=8.0, duration=6.0)
run, remedied = keep_runs({"gain 8": late, "gain 2": late.with_changes(gain=2.0)}, "feature_errors")
assert run.outcome == "gain_too_high" and remedied.is_success
