"""Keys of the teleoperation."""

import numpy as np

from aras_visual_servo_controller.kinematics import GANTRY, J2
from aras_visual_servo_controller.tasks import JointLimits
from aras_visual_servo_controller.teleop import command_for


def test_arrows_step_gantry_and_j2():
    limits, command = JointLimits(), np.zeros(6)
    for key in ("\x1b[C", "\x1b[C", "\x1b[A", "x", ""):
        command, _ = command_for(key, command, limits)
    assert command[GANTRY] == 0.1
    assert command[J2] == 0.05


def test_a_step_beyond_the_limit_is_not_taken():
    command = np.zeros(6)
    command[GANTRY] = 1.48
    after, told = command_for("\x1b[C", command, JointLimits())
    np.testing.assert_array_equal(after, command)
    assert "gantry is at its limit" in told
