"""Learned: a network taught by the simulator's own pictures, beside image moments."""

from keeping import keep_runs

from aras_visual_servo_bench import Experiment

taught = "aras_visual_servo_bench.learning.learned:LearnedScheme"
base = Experiment(plant="chain", features="images", start="2016", goal="2016", duration=5.0)
learned, moments = keep_runs(
    {"learned": base.with_changes(scheme=taught), "moments": base.with_changes(scheme="moments")},
    "camera_path",
)
assert learned.verdict.is_reached and moments.is_success
