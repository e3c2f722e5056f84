"""Keyboard and gamepad of the teleoperation."""

import os
import pty
import sys
import termios
import time

import numpy as np
import pytest
from loop_rig import the_arm, the_limits

from aras_visual_servo_controller.teleop import gamepad, keyboard
from aras_visual_servo_controller.teleop.jog import MAX_TWIST, Jog

compute_twist, DEADBAND, EVENT = gamepad.compute_twist, gamepad.DEADBAND, gamepad.EVENT
SLOW, FAST, AXIS, BUTTON = gamepad.SLOW, gamepad.FAST, gamepad.AXIS, gamepad.BUTTON


@pytest.mark.parametrize(("names", "across", "along"), [
    (("gantry", "J1", "J2"), "gantry", "J2"), (("pan",), "pan", "pan"),
    (("shoulder_pan", "shoulder_lift", "elbow"), "shoulder_pan", "shoulder_lift"),
    (("pan", "tilt"), "pan", "tilt"),
])  # fmt: skip
def test_arrows_step_the_first_joints_of_another_arm(names, across, along):
    assert keyboard.choose_step_joints(names) == {"across": across, "along": along}


def test_arrows_step_gantry_and_j2():
    command = np.zeros(6)
    for key in ("\x1b[C", "\x1b[C", "\x1b[A"):
        command, _ = keyboard.step_joint(key, command, the_limits(), keyboard.JOINTS)
    np.testing.assert_allclose(command, [0.1, 0.0, 0.05, 0.0, 0.0, 0.0])
    after, told = keyboard.step_joint("\x1b[B", command, the_limits(), keyboard.JOINTS)
    assert (after[2], command[2], told) == (0.0, 0.05, "J2 to 0.000")
    for key, side, sign in (("\x1b[C", "upper", 1.0), ("\x1b[D", "lower", -1.0)):
        for bound, gone, told in ((0.02, 0.0, "gantry is at its limit"),
                                  (0.05, 0.05, f"gantry to {0.1 + 0.05 * sign:.3f}"),
                                  (0.051, 0.05, "gantry to")):  # fmt: skip
            limits = the_limits(**{side: {"gantry": command[0] + sign * bound}})
            after, words = keyboard.step_joint(key, command, limits, keyboard.JOINTS)
            assert after[0] - command[0] == pytest.approx(sign * gone) and told in words
            np.testing.assert_array_equal(after[1:], command[1:])


class Asked(Jog):
    def __init__(self):
        super().__init__(the_arm(), the_limits())
        self.heard = []

    def set_twist(self, twist, t):
        super().set_twist(twist, t)
        self.heard.append(list(twist))

    def set_joint_speed(self, name, speed_fraction, t):
        super().set_joint_speed(name, speed_fraction, t)
        self.heard.append((name, speed_fraction))


def test_each_key_moves_the_camera_in_its_direction():
    jog, keys = Asked(), keyboard.KeyboardState(the_arm().names)
    for row, pair in enumerate(("da", "sw", "rf", "ik", "ou", "lj")):
        for key, sign in zip(pair, (1, -1), strict=True):
            assert keys.press(key, jog, 0.0) == (True, "")
            expected = sign * keyboard.SPEEDS[keys.speed] * MAX_TWIST[row] * np.eye(6)[row]
            np.testing.assert_allclose(jog.heard[-1], expected)
    assert len(jog.heard) == 12


def test_a_chosen_joint_is_moved_and_no_other():
    jog, keys = Asked(), keyboard.KeyboardState(the_arm().names)
    assert keys.press("=", jog, 0.0) == (True, "")
    assert keys.press("3", jog, 0.0) == (False, "+ and - move J2")
    keys.press("+", jog, 0.0)
    keys.press("-", jog, 0.0)
    assert jog.heard == [("gantry", 0.2), ("J2", 0.2), ("J2", -0.2)]
    assert keys.press("x", jog, 0.0) == (False, "") and len(jog.heard) == 3
    assert keys.press("7", jog, 0.0)[1].startswith("there are 6 joints: gantry")
    assert keys.press("0", jog, 0.0) == (False, "") and keys.selected_joint == 2
    assert keys.press("6", jog, 0.0) == (False, "+ and - move J6")


def test_speed_stays_between_the_least_and_the_greatest():
    keys, jog = keyboard.KeyboardState(the_arm().names), Asked()
    assert [keys.press("<", jog, 0.0) for _ in range(6)][-1] == (False, "speed 5 %")
    told = [keys.press(">", jog, 0.0)[1] for _ in range(6)]
    assert told == [f"speed {part} %" for part in (10, 20, 40, 70, 100, 100)]
    assert not jog.heard


def test_no_key_means_two_things_and_the_help_names_all():
    taken = set(keyboard.CAMERA_KEYS) | set(keyboard.SIGNS) | {"<", ">", "h", "q", " "}
    assert len(taken) == len(keyboard.CAMERA_KEYS) + len(keyboard.SIGNS) + 5
    words = set(keyboard.__doc__.replace(",", " ").split())
    assert set(keyboard.CAMERA_KEYS) | {"+", "-", "<", ">", "h", "q"} <= words
    for text, held in (("dd\x1b[Cq", ["d", "d", "\x1b[C", "q"]), ("", [])):
        assert keyboard.split_keys(text) == held


def test_keys_are_read_as_they_come_also_such_as_are_no_text(monkeypatch):
    end, begin = os.pipe()
    with os.fdopen(end) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        assert keyboard.read_keys(0.0) == []
        os.write(begin, 70 * b"d")
        assert [len(keyboard.read_keys(0.0)) for _ in range(2)] == [64, 6]
        os.write(begin, b"d\xff\x1b[C")
        assert keyboard.read_keys(5.0) == ["d", "\ufffd", "\x1b[C"]
        os.close(begin)
        assert keyboard.read_keys(5.0) == ["\x04"]  # the terminal is gone: as its end of input


def test_a_terminal_is_as_before_once_its_keys_were_read(monkeypatch):
    person, end = pty.openpty()
    with os.fdopen(end) as terminal, os.fdopen(person):
        monkeypatch.setattr(sys, "stdin", terminal)
        before = termios.tcgetattr(terminal)
        with pytest.raises(KeyboardInterrupt), keyboard.raw_terminal():
            assert not termios.tcgetattr(terminal)[3] & (termios.ICANON | termios.ECHO)
            raise KeyboardInterrupt
        assert termios.tcgetattr(terminal) == before


def test_a_pad_moves_nothing_until_a_shoulder_button_is_held():
    axes, none = DEADBAND + (1.0 - DEADBAND) * 0.1 * np.arange(1.0, 9.0), [0] * 8
    assert (DEADBAND, SLOW, FAST) == (0.12, 4, 5)
    for buttons in (none, [], [1] * 4):
        assert compute_twist(axes, buttons) is None
    assert compute_twist(axes, [0] * 4 + [1]) is not None
    slow, fast, both = ([int(k in held) for k in range(8)]
                        for held in ((SLOW,), (FAST,), (SLOW, FAST)))  # fmt: skip
    # left and up: the picture's left and up; nearer; turned to the left
    np.testing.assert_allclose(
        compute_twist(axes, fast), np.array(MAX_TWIST) * [-0.1, -0.2, 0.5, 0.8, -0.7, -0.4])
    np.testing.assert_allclose(compute_twist(axes, slow), 0.3 * compute_twist(axes, fast))
    np.testing.assert_allclose(compute_twist(-axes, both), -compute_twist(axes, fast))
    # a stick near its middle counts as none, and one beyond its end as at it
    assert not compute_twist([0.9 * DEADBAND, -0.9 * DEADBAND, float("nan")], slow).any()
    assert abs(compute_twist([1.02 * DEADBAND], slow)[0]) < 0.03 * MAX_TWIST[0]
    assert [compute_twist([way], slow)[0] for way in (5.0, -5.0)] == pytest.approx([-0.075, 0.075])


def test_the_kernels_events_are_a_pads_state(tmp_path):
    (path := tmp_path / "js0").write_bytes(b"")
    pad = gamepad.JoyDevice(path)
    pad.axes, pad.buttons = [0.0] * 8, [0] * 16
    assert (BUTTON, AXIS) == (1, 2)
    for event in ((1, -32767, AXIS | gamepad.INITIAL, 0),  # the kernel's left is negative
                  (2, 1, BUTTON, SLOW), (3, 1, BUTTON, 16), (3, 1, AXIS, 8),
                  (3, 1, 0x40, 3)):  # an event of a kind to come
        pad.handle_event(EVENT.pack(*event))
    assert pad.axes == [1.0] + [0.0] * 7 and pad.buttons[SLOW] == 1
    pad.handle_event(EVENT.pack(4, 0, BUTTON, SLOW))
    assert not any(pad.buttons)


def test_a_pad_that_is_unplugged_asks_for_nothing(tmp_path):
    os.mkfifo(path := tmp_path / "js0")
    cable = os.open(path, os.O_RDWR)
    pad = gamepad.JoyDevice(path)
    rest = [0.0] * 8, [0] * 16
    assert (pad.axes, pad.buttons) == rest
    os.write(cable, EVENT.pack(1, -32767, AXIS, 0) + EVENT.pack(2, 1, BUTTON, FAST))
    _wait(lambda: compute_twist(pad.axes, pad.buttons) is not None)
    os.close(cable)
    _wait(lambda: (pad.axes, pad.buttons) == rest)
    assert compute_twist(pad.axes, pad.buttons) is None


def _wait(until):
    for _ in range(2000):
        if until():
            return
        time.sleep(0.005)
    pytest.fail("it never came")
