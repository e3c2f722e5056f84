"""No features at all: the scheme compares the grey levels of the whole image of a textured poster
with those of the goal image.
"""

from output import report_runs

from aras_visual_servo_bench import Experiment

poster = Experiment(
    plant="free", features="images", scheme="luminance",
    target={"shape": "poster", "size": [0.8, 0.6]},
    goal={"pose": [0, 0, 0.4, 3.14159, 0, 0]},
    start={"pose": [0.02, -0.01, 0.42, 3.12, 0.02, 0.05]},
)  # fmt: skip
run, = report_runs({"grey levels": poster}, "image_trajectory")
assert run.is_success
