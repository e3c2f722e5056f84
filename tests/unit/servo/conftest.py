"""Loops that several tests close."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
import pytest

from aras_visual_servo_controller.before import laws, schemes
from aras_visual_servo_controller.before.servo import Servo, ServoSettings
from aras_visual_servo_controller.before.settings import STARTS
from aras_visual_servo_controller.goals import DESIRED_JOINTS, from_geometry
from aras_visual_servo_controller.kinematics import Kinematics
from aras_visual_servo_controller.resolver import Resolver


class Loops:
    """Makes loops for the demo's two generations."""

    starts = STARTS
    desired_joints = DESIRED_JOINTS
    kinematics = Kinematics()

    def desired(self, year):
        return from_geometry(DESIRED_JOINTS[year], year)

    def servo(self, year, scheme="moments", law=None, desired=None, smoothing=0.1, **settings):
        law = law if law is not None else laws.Proportional(3.0, 0.1)
        desired = desired if desired is not None else self.desired(year)
        scheme = schemes.create(scheme, desired, law)
        scheme.smoothing = smoothing
        return Servo(
            scheme,
            Resolver(self.kinematics),
            ServoSettings(**settings),
        )


@pytest.fixture(scope="session")
def loops():
    return Loops()


def settling_time(history, part=0.02):
    """When the error's norm falls below a part of its first value for good, s."""
    norms = [np.linalg.norm(c.scheme_result.error) for c in history if c.scheme_result]
    stamps = [c.stamp for c in history if c.scheme_result]
    above = [i for i, norm in enumerate(norms) if norm > part * norms[0]]
    assert above[-1] + 1 < len(stamps), "never settles"
    return stamps[above[-1] + 1] - stamps[0]


@pytest.fixture(scope="session")
def settle():
    return settling_time
