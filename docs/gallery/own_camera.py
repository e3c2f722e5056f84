"""Your own camera: a fisheye lens of 180 degrees, and what is believed of it wrong by a tenth."""

from keeping import keep_runs

from aras_visual_servo_bench import Experiment

lens = {"lens": "equidistant", "horizontal_fov": 3.1, "width": 640, "height": 480,
        "update_rate": 30.0}  # fmt: skip
seen = Experiment(camera=lens, start="2016", duration=4.0)
right, wrong = keep_runs(
    {"right": seen, "focal length 10 % short": seen.with_(believed={"focal": 0.9})},
    "image_trajectory",
)
assert right.succeeded and not wrong.verdict.reached
