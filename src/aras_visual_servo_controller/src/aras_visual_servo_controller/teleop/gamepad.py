"""Camera twists from the axes and buttons of a gamepad, as in sensor_msgs/Joy. No ROS.

The numbers of axes and buttons are those of common two-stick gamepads under Linux (joydev and
joy_node).
"""

from __future__ import annotations

import contextlib
import struct
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..kinematics.task import DIRECTIONS
from .jog import MAX_TWIST

DEADBAND = 0.12  # a stick is at rest if it is closer to its centre than this fraction of its range
SLOW, FAST = 4, 5  # shoulder buttons; the arm moves only while one is pressed
# Speed while the slow or the fast button is pressed, as a fraction of the maximum speed.
SPEEDS = {SLOW: 0.3, FAST: 1.0}
# Axis number and sign for each camera direction. In Joy messages, axes are positive to the left and
# upwards; x is to the right, and y downwards, in the camera frame.
AXES = {"vx": (0, -1.0), "vy": (1, -1.0), "wz": (3, -1.0), "vz": (4, 1.0), "wy": (6, -1.0),
        "wx": (7, 1.0)}  # fmt: skip
HELP = """gamepad: hold a shoulder button (left: slow, right: fast)
    left stick    parallel to the image   right stick    along and about the optical axis
    cross         tilt"""

EVENT = struct.Struct("IhBB")  # joydev event: time (ms), value, type, number of the axis or button
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80
AXIS_RANGE = 32767.0


def compute_twist(axes: Sequence[float], buttons: Sequence[int]) -> np.ndarray | None:
    """Compute the camera twist (6,), m/s and rad/s; None while no shoulder button is pressed.

    Args:
        axes: values of the axes, -1 to 1, positive to the left and up.
        buttons: 1 for each button that is pressed, 0 for the others.
    """
    speeds = [SPEEDS[b] for b in (SLOW, FAST) if b < len(buttons) and buttons[b]]
    if not speeds:
        return None
    twist = np.zeros(6)
    for i, direction in enumerate(DIRECTIONS):
        axis, sign = AXES[direction]
        value = float(axes[axis]) if axis < len(axes) else 0.0
        if not np.isfinite(value) or abs(value) < DEADBAND:
            continue
        part = (abs(min(max(value, -1.0), 1.0)) - DEADBAND) / (1.0 - DEADBAND)
        twist[i] = sign * max(speeds) * MAX_TWIST[i] * np.copysign(part, value)
    return twist


class JoyDevice:
    """A gamepad that is read from the kernel (/dev/input/js0) without joy_node.

    Attributes:
        axes, buttons: current values, with the signs of Joy messages; 0 after the gamepad was
            unplugged.
    """

    def __init__(self, path: Path) -> None:
        """Open the device.

        Raises:
            OSError: the device cannot be read.
        """
        self._file = path.open("rb", buffering=0)
        self.axes, self.buttons = [0.0] * 8, [0] * 16
        threading.Thread(target=self._read, name="gamepad", daemon=True).start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while len(event := self._file.read(EVENT.size)) == EVENT.size:
                self.handle_event(event)
        self.axes, self.buttons = [0.0] * 8, [0] * 16  # the gamepad was unplugged

    def handle_event(self, event: bytes) -> None:
        """Process one joydev event, whose axes are positive to the right and down."""
        _, value, kind, number = EVENT.unpack(event)
        kind &= ~INITIAL
        if kind == BUTTON and number < len(self.buttons):
            self.buttons[number] = int(value != 0)
        elif kind == AXIS and number < len(self.axes):
            self.axes[number] = -value / AXIS_RANGE
