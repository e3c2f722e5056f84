"""Your own camera: the camera has a fisheye lens of 180 degrees; the controller uses the true focal
length in one run and a focal length that is 10 % too short in the other run.
"""

from output import report_runs

from aras_visual_servo_bench import Experiment

lens = {"lens": "equidistant", "horizontal_fov": 3.1, "width": 640, "height": 480,
        "update_rate": 30.0}  # fmt: skip
fisheye = Experiment(camera=lens, start="2016", duration=4.0)
right, wrong = report_runs(
    {
        "right": fisheye,
        "focal length 10 % short": fisheye.with_changes(calibration_offset={"focal": 0.9}),
    },
    "image_trajectory",
)
assert right.is_success and not wrong.verdict.is_reached
