"""Your own camera: a fisheye lens of 180 degrees, and what is believed of it wrong by a tenth."""

from keeping import keep_runs

from aras_visual_servo_bench import Experiment

lens = {"lens": "equidistant", "horizontal_fov": 3.1, "width": 640, "height": 480,
        "update_rate": 30.0}  # fmt: skip
seen = Experiment(camera=lens, start="2016", duration=4.0)
right, wrong = keep_runs(
    {
        "right": seen,
        "focal length 10 % short": seen.with_changes(calibration_offset={"focal": 0.9}),
    },
    "image_trajectory",
)
assert right.is_success and not wrong.verdict.is_reached
