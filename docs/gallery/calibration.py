"""Calibration: recorded images of a chessboard give the intrinsics and the hand-eye pose of the
camera, with which the arm then servoes to a computed goal.
"""

import sys
from dataclasses import replace

import numpy as np
from output import EXAMPLES, folder, report_runs

from aras_visual_servo_bench import Experiment, assemble
from aras_visual_servo_controller import Arm

sys.path.append(str(EXAMPLES))
import chessboard as example  # noqa: E402  docs/examples/chessboard.py

recording = folder() / "recording"
recording.mkdir(exist_ok=True)
example.record(recording)
K, mounting = example.calibrate(recording)

# The true camera: settings and description of the simulated robot.
focal = 0.5 * example.CAMERA["width"] / np.tan(0.5 * example.CAMERA["horizontal_fov"])  # px
urdf = example.URDF.read_text()
zero = np.zeros(6)
true = np.linalg.inv(Arm.from_urdf(urdf, example.LINK).pose(zero)) @ Arm.from_urdf(urdf).pose(zero)
distance = np.linalg.norm(mounting[:3, 3] - true[:3, 3])
print(f"focal length {K[0, 0]:.2f} px, true {focal:.2f}; hand-eye pose {1e3 * distance:.2f} mm off")

calibrated = {
    "focal": float(K[0, 0] / focal), "centre": [float(K[0, 2] - 319.5), float(K[1, 2] - 239.5)],
    "hand_eye": {"file": str(recording / "hand_eye.yaml"), "link": example.LINK},
}  # fmt: skip
drawing = {"focal": 1.03, "xyz": [0.005, -0.004, 0.0], "rpy": [0.0, 0.03, 0.0]}  # not calibrated
mine = Experiment(
    robot={"urdf": str(example.URDF), "config": str(example.CONTROLLERS)}, camera=example.CAMERA,
    target={"shape": "l_shape", "size": [0.1, 0.1], "pose": [0.45, 0.05, 0.051, 0, 0, 0]},
    goal={"pose": [0.45, 0.05, 0.3, 3.14159, 0, 0.2]},
    start={"pose": [0.42, 0.03, 0.35, 3.05, 0.05, 0.4]}, scheme="points", gain=2.0, duration=5.0,
)  # fmt: skip
# A view computed for the true camera, instead of one taught with the camera that servoes. Without
# joints, only the calibrated camera relates it to the arm.
view = replace(assemble(mine).goal, joints={}, mounting=None)
goal = folder() / "goal.yaml"
goal.write_text(view.to_yaml("0.25 m above the target"))
mine = mine.with_changes(goal=str(goal))
runs = report_runs(
    {
        "drawing and data sheet": mine.with_changes(calibration_offset=drawing),
        "calibrated": mine.with_changes(calibration_offset=calibrated),
    },
    "pose_errors",
)
assert runs[1].verdict.distance < 1e-3 < 5e-3 < runs[0].verdict.distance
