"""What a gamepad asks of the camera, from its axes and buttons as sensor_msgs/Joy has them. No ROS.

Axes and buttons are those of the usual two-stick pads under Linux (joydev, and joy_node after it).
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..kinematics.task import DIRECTIONS
from .jog import MAX_TWIST

DEADBAND = 0.12  # part of a stick's way around its middle that counts as none
SLOW, FAST = 4, 5  # shoulder buttons: one has to be held, or nothing moves
SPEEDS = {SLOW: 0.3, FAST: 1.0}  # part of the greatest speeds
# Axis of each direction and its sign, so that the picture goes where the stick goes: a stick's axes
# are positive to the left and upwards in Joy messages.
AXES = {"vx": (0, -1.0), "vy": (1, -1.0), "wz": (3, -1.0), "vz": (4, 1.0), "wy": (6, -1.0),
        "wx": (7, 1.0)}  # fmt: skip
HELP = """gamepad: hold a shoulder button (left: slow, right: fast)
    left stick    along the picture       right stick    along the view, turn about it
    cross         tilt"""

EVENT = struct.Struct("IhBB")  # time (ms), value, kind, number: joydev's
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80
AXIS_RANGE = 32767.0


def compute_twist(axes: Sequence[float], buttons: Sequence[int]) -> np.ndarray | None:
    """The twist (6,) that a pad asks for, m/s and rad/s; None while no shoulder button is held.

    Args:
        axes: -1 to 1, positive to the left and up.
        buttons: 1 while pressed.
    """
    held = [SPEEDS[b] for b in (SLOW, FAST) if b < len(buttons) and buttons[b]]
    if not held:
        return None
    twist = np.zeros(6)
    for i, direction in enumerate(DIRECTIONS):
        axis, sign = AXES[direction]
        value = float(axes[axis]) if axis < len(axes) else 0.0
        if not np.isfinite(value) or abs(value) < DEADBAND:
            continue
        part = (abs(min(max(value, -1.0), 1.0)) - DEADBAND) / (1.0 - DEADBAND)
        twist[i] = sign * max(held) * MAX_TWIST[i] * np.copysign(part, value)
    return twist


class JoyDevice:
    """A pad read from the kernel itself (/dev/input/js0), where no joy_node runs.

    Attributes:
        axes, buttons: as they stand now, signed as in Joy messages.
        gone: the pad was unplugged.
    """

    def __init__(self, path: Path) -> None:
        """OSError where it cannot be read."""
        self._file = path.open("rb", buffering=0)
        self.axes, self.buttons, self.is_disconnected = [0.0] * 8, [0] * 16, False
        threading.Thread(target=self._read, name="gamepad", daemon=True).start()

    def _read(self) -> None:
        try:
            while len(event := self._file.read(EVENT.size)) == EVENT.size:
                self.handle_event(event)
        except OSError:
            pass
        self.is_disconnected, self.axes, self.buttons = True, [0.0] * 8, [0] * 16

    def handle_event(self, event: bytes) -> None:
        """One event of the kernel's; its axes are positive to the right and down."""
        _, value, kind, number = EVENT.unpack(event)
        kind &= ~INITIAL
        if kind == BUTTON and number < len(self.buttons):
            self.buttons[number] = int(value != 0)
        elif kind == AXIS and number < len(self.axes):
            self.axes[number] = -value / AXIS_RANGE
