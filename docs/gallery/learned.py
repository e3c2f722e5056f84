"""Learned: the example compares a network that was trained on images of the simulator with image
moments.
"""

from output import report_runs

from aras_visual_servo_bench import Experiment

network = "aras_visual_servo_bench.learning.learned_scheme:LearnedScheme"
base = Experiment(plant="chain", features="images", start="2016", goal="2016", duration=5.0)
learned, moments = report_runs(
    {"learned": base.with_changes(scheme=network), "moments": base.with_changes(scheme="moments")},
    "camera_path",
)
assert learned.verdict.is_reached and moments.is_success
