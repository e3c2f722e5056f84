"""Keys of the teleoperation."""

import numpy as np
from loop_rig import the_limits

from aras_visual_servo_controller.teleop import JOINTS, command_for


def test_arrows_step_gantry_and_j2():
    command = np.zeros(6)
    for key in ("\x1b[C", "\x1b[C", "\x1b[A", "x", ""):
        command, _ = command_for(key, command, the_limits(), JOINTS)
    np.testing.assert_allclose(command, [0.1, 0.0, 0.05, 0.0, 0.0, 0.0])


def test_a_step_beyond_the_limit_is_not_taken():
    command = np.zeros(6)
    command[0] = 1.48
    after, told = command_for("\x1b[C", command, the_limits(), JOINTS)
    np.testing.assert_array_equal(after, command)
    assert "gantry is at its limit" in told
