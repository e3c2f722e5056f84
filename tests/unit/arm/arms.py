"""Arms for the tests of the control loop: the laboratory's arm, and two of a public registry."""

import os
import sysconfig
from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.elbow import Elbow

ROBOTS = Path(__file__).parents[3] / "src" / "aras_visual_servo_gazebo" / "robots"
FOREIGN = Path(sysconfig.get_paths()["purelib"], "cmeel.prefix/share/example-robot-data/robots")
FOREIGN_ARMS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp"),
}
NAMES = ("aras", *FOREIGN_ARMS)


def urdf(name: str) -> str:
    """Return the text of the description of a robot."""
    if name == "aras":
        return (ROBOTS / "aras_visual_servo.urdf").read_text()
    path = FOREIGN / FOREIGN_ARMS[name][0]
    if not path.is_file():
        missing = f"{path} is missing: run ./setup.sh --for developing (example-robot-data)"
        if os.environ.get("ARAS_REQUIRE_GRAPH"):
            pytest.fail(missing)
        pytest.skip(missing)
    return path.read_text()


def make(name: str) -> Arm:
    """Return an arm; without a camera, the tool frame is used as its optical frame."""
    return Arm.from_urdf(urdf(name), FOREIGN_ARMS.get(name, ("", "camera_optical_frame"))[1])


def within(arm: Arm, random: np.random.Generator, part: float = 0.9) -> np.ndarray:
    """Return random joints (n,) within a part of their limits, at most one radian from zero."""
    low, high = np.maximum(arm.lower, -1.5), np.minimum(arm.upper, 1.5)
    middle, half = 0.5 * (low + high), 0.5 * part * (high - low)
    return middle + half * random.uniform(-1.0, 1.0, len(low))


def bent(fold: Elbow, q: np.ndarray, angle: float) -> np.ndarray:
    """The posture q (n,) with the elbow at that angle from straight, rad, and what that turns with
    it."""
    posture = np.array(q, float)
    more = fold.straight_position + angle - posture[fold.joint]
    posture[fold.joint] += more
    posture[fold.joint_before] += fold.share_before * more
    posture[fold.joint_after] += fold.share_after * more
    return posture
