"""Drive the arm by keys: joints one by one, or the camera along its own axes. A gamepad, too.

    left, right     the first joint (gantry), in steps of 0.05      up, down    the second (J2)
    1 2 3 ...       choose a joint          + -     move it, as long as the key is held

    the camera in its own picture, as long as the key is held:
    w s a d         up, down, left, right   r f     nearer to what it sees, away from it
    j l             turn about the view     i k     tilt up and down      u o     to the sides
    < >             slower, faster

    space           where are we, and why does it not move              h       this help
    q, ^C           end

The controller is stopped when the camera or a chosen joint is first moved. Other joints for the
arrows than gantry and J2: ~across and ~along. A gamepad: ~joy (topic), ~joystick (device).
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..kinematics import Limits
from .jog import MAX_TWIST, Jog

STEP = 0.05
JOINTS = {"across": "gantry", "along": "J2"}  # where an arm has them
KEYS = {
    "\x1b[D": ("across", -STEP),
    "\x1b[C": ("across", STEP),
    "\x1b[A": ("along", STEP),
    "\x1b[B": ("along", -STEP),
}
# Row of the camera's twist, and sign: x right, y down, z forward.
CAMERA_KEYS = {
    "a": (0, -1.0), "d": (0, 1.0), "w": (1, -1.0), "s": (1, 1.0), "r": (2, 1.0), "f": (2, -1.0),
    "i": (3, 1.0), "k": (3, -1.0), "o": (4, 1.0), "u": (4, -1.0), "l": (5, 1.0), "j": (5, -1.0),
}  # fmt: skip
SPEEDS = (0.05, 0.1, 0.2, 0.4, 0.7, 1.0)  # parts of the greatest
SIGNS = {"+": 1.0, "=": 1.0, "-": -1.0}


def choose_step_joints(names: Sequence[str]) -> dict[str, str]:
    """The joints that the arrows step, of an arm with these names: the first two of another arm."""
    first, second = names[0], names[min(1, len(names) - 1)]
    return {
        way: name if name in names else other
        for (way, name), other in zip(JOINTS.items(), (first, second), strict=True)
    }


def step_joint(
    key: str, command: np.ndarray, limits: Limits, joints: Mapping[str, str]
) -> tuple[np.ndarray, str]:
    """The command (n,) after a key, and what to tell the driver.

    A step that would leave the limits is not taken. `joints`: names by 'across' and 'along'.
    """
    if key not in KEYS:
        return command, ""
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
    """What the keys of a drive mean now.

    Attributes:
        names: of the joints.
        chosen: the joint that + and - move.
        speed: which of SPEEDS.
    """

    names: Sequence[str]
    selected_joint: int = 0
    speed: int = field(default=2)

    def press(self, key: str, jog: Jog, t: float) -> tuple[bool, str]:
        """Take a key at t (s); whether the arm is to move for it, and what to tell the driver."""
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
    """The keys of what a terminal sent: an arrow is an escape sequence, a held key comes many
    times."""
    found: list[str] = []
    while text:
        arrow = next((key for key in KEYS if text.startswith(key)), None)
        found.append(arrow or text[0])
        text = text[len(found[-1]) :]
    return found


@contextlib.contextmanager
def raw_terminal() -> Iterator[None]:
    """Keys one by one and unseen; the terminal is as before afterwards."""
    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def read_keys(timeout: float) -> list[str]:
    """The next keys, none if none comes in time (s)."""
    if not select.select([sys.stdin], [], [], timeout)[0]:
        return []
    return split_keys(os.read(sys.stdin.fileno(), 64).decode(errors="replace")) or ["\x04"]
