"""Keyboard teleoperation of single joints, or of the camera along its own axes.

    left, right     the first joint (gantry), in steps of 0.05      up, down    the second (J2)
    1 2 3 ...       select a joint          + -     move it while the key is held

    the camera in its own frame, while the key is held:
    w s a d         up, down, left, right   r f     forward, backward
    j l             rotate about the optical axis   i k     tilt up and down    u o     pan
    < >             slower, faster

    space           print the joints, and why the arm does not move     h       this help
    q, ^C           quit

The first motion of the camera or a selected joint stops the controller. The parameters ~across and
~along name other joints for the arrow keys. The parameters ~joy (topic) and ~joystick (device)
select a gamepad.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..kinematics import CommandLimits
from .jog import MAX_TWIST, Jog

STEP = 0.05
# default joints of the arrow keys: 'across' for left and right, 'along' for up and down
JOINTS = {"across": "gantry", "along": "J2"}
KEYS = {
    "\x1b[D": ("across", -STEP),
    "\x1b[C": ("across", STEP),
    "\x1b[A": ("along", STEP),
    "\x1b[B": ("along", -STEP),
}
# Component of the camera twist, and its sign, for each key. x is to the right, y down, z forward.
CAMERA_KEYS = {
    "a": (0, -1.0), "d": (0, 1.0), "w": (1, -1.0), "s": (1, 1.0), "r": (2, 1.0), "f": (2, -1.0),
    "i": (3, 1.0), "k": (3, -1.0), "o": (4, 1.0), "u": (4, -1.0), "l": (5, 1.0), "j": (5, -1.0),
}  # fmt: skip
# Speeds that can be chosen, as fractions of the maximum speed.
SPEEDS = (0.05, 0.1, 0.2, 0.4, 0.7, 1.0)
SIGNS = {"+": 1.0, "=": 1.0, "-": -1.0}


def choose_step_joints(names: Sequence[str]) -> dict[str, str]:
    """Return the joints that the arrow keys move.

    They are the gantry and J2, or else the first two joints.
    """
    first, second = names[0], names[min(1, len(names) - 1)]
    return {
        way: name if name in names else other
        for (way, name), other in zip(JOINTS.items(), (first, second), strict=True)
    }


def step_joint(
    key: str, command: np.ndarray, limits: CommandLimits, joints: Mapping[str, str]
) -> tuple[np.ndarray, str]:
    """Return the command (n,) after a key was pressed, and a text for the operator.

    A step that would exceed the limits is not made.

    Args:
        key: pressed arrow key, one of KEYS.
        command: (n,) present command, rad or m.
        limits: joint limits.
        joints: names of the joints that the arrow keys move: 'across' for left and right, 'along'
            for up and down.
    """
    way, step = KEYS[key]
    name = joints[way]
    joint = limits.names.index(name)
    value = command[joint] + step
    if not limits.lower[joint] <= value <= limits.upper[joint]:
        return command, f"{name} is at its limit ({command[joint]:.3f})"
    after = command.copy()
    after[joint] = value
    return after, f"{name} to {value:.3f}"


@dataclass
class KeyboardState:
    """State of the keyboard teleoperation.

    Attributes:
        names: names of the joints.
        selected_joint: index of the joint that + and - move.
        speed: index into SPEEDS.
    """

    names: Sequence[str]
    selected_joint: int = 0
    speed: int = 2

    def press(self, key: str, jog: Jog, t: float) -> tuple[bool, str]:
        """Process a key at the time t (s).

        Return whether it moves the arm, and a text for the operator.
        """
        if key in CAMERA_KEYS:
            row, sign = CAMERA_KEYS[key]
            twist = np.zeros(6)
            twist[row] = sign * SPEEDS[self.speed] * MAX_TWIST[row]
            jog.set_twist(twist, t)
            return True, ""
        if key in SIGNS:
            jog.set_joint_speed(self.names[self.selected_joint], SIGNS[key] * SPEEDS[self.speed], t)
            return True, ""
        if key in ("<", ">"):
            self.speed = min(max(self.speed + (1 if key == ">" else -1), 0), len(SPEEDS) - 1)
            return False, f"speed {100 * SPEEDS[self.speed]:.0f} %"
        if key.isdigit() and key != "0":
            if int(key) > len(self.names):
                return False, f"there are {len(self.names)} joints: {', '.join(self.names)}"
            self.selected_joint = int(key) - 1
            return False, f"+ and - move {self.names[self.selected_joint]}"
        return False, ""


def split_keys(text: str) -> list[str]:
    """Split the input of a terminal into keys; an arrow key is an escape sequence."""
    found: list[str] = []
    while text:
        arrow = next((key for key in KEYS if text.startswith(key)), None)
        found.append(arrow or text[0])
        text = text[len(found[-1]) :]
    return found


@contextlib.contextmanager
def raw_terminal() -> Iterator[None]:
    """Make the terminal pass keys one by one without echo, and restore it afterwards."""
    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def read_keys(timeout: float) -> list[str]:
    """Return the keys that are pressed within the timeout (s); an empty list if there are none."""
    if not select.select([sys.stdin], [], [], timeout)[0]:
        return []
    return split_keys(os.read(sys.stdin.fileno(), 64).decode(errors="replace")) or ["\x04"]
