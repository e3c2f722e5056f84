"""Drive the gantry and J2 by the arrow keys, in steps of 0.05 (m, rad), as the original did.

    left, right     gantry          up, down     J2
    space           where are we    q, ^C        end
"""

import contextlib
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Iterator

import numpy as np

from .kinematics import GANTRY, J2, JOINT_NAMES
from .tasks import JointLimits

STEP = 0.05
KEYS = {
    "\x1b[D": (GANTRY, -STEP),
    "\x1b[C": (GANTRY, STEP),
    "\x1b[A": (J2, STEP),
    "\x1b[B": (J2, -STEP),
}


def command_for(key: str, command: np.ndarray, limits: JointLimits) -> tuple[np.ndarray, str]:
    """The command (6,) after a key, and what to tell the driver.

    A step that would leave the limits is not taken.
    """
    if key not in KEYS:
        return command, ""
    joint, step = KEYS[key]
    value = command[joint] + step
    if not limits.lower[joint] <= value <= limits.upper[joint]:
        return command, f"{JOINT_NAMES[joint]} is at its limit ({command[joint]:.3f})"
    after = command.copy()
    after[joint] = value
    return after, f"{JOINT_NAMES[joint]} to {value:.3f}"


@contextlib.contextmanager
def _raw_terminal() -> Iterator[None]:
    """Keys one by one and unseen; the terminal is as before afterwards."""
    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def _key(timeout: float) -> str:
    """The next key, an arrow as its whole escape sequence, '' if none comes."""
    if not select.select([sys.stdin], [], [], timeout)[0]:
        return ""
    return os.read(sys.stdin.fileno(), 8).decode(errors="replace")


def main() -> int:
    """Run until q or ^C; returns the exit status."""
    if not sys.stdin.isatty():
        print("aras_teleop: needs a terminal for its keys: start it with rosrun", file=sys.stderr)
        return 1
    import rospy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    from .before.node import CONTROLLERS, NAMESPACE
    from .conversions import joint_positions

    rospy.init_node("aras_teleop", anonymous=True, disable_signals=True)
    measured: dict[str, np.ndarray] = {}
    heard = threading.Event()

    def on_joints(message: JointState) -> None:
        with contextlib.suppress(KeyError, ValueError):
            measured["q"] = joint_positions(message.name, message.position)
            heard.set()

    rospy.Subscriber(f"{NAMESPACE}/joint_states", JointState, on_joints, queue_size=1)
    publishers = {
        joint: rospy.Publisher(
            f"{NAMESPACE}/{CONTROLLERS[JOINT_NAMES[joint]]}_position_controller/command",
            Float64,
            queue_size=1,
        )
        for joint in (GANTRY, J2)
    }
    print(__doc__)
    try:
        while not heard.wait(2.0):
            print(f"waiting for joint states on {NAMESPACE}/joint_states")
        command, limits = measured["q"].copy(), JointLimits()
        with _raw_terminal():
            while not rospy.is_shutdown():
                key = _key(0.2)
                if key in ("q", "\x04"):
                    break
                if key == " ":
                    print("  ".join(f"{n} {v:.3f}" for n, v in
                                    zip(JOINT_NAMES, measured["q"], strict=True)))
                command, told = command_for(key, command, limits)
                if told:
                    print(told)
                    joint = KEYS[key][0]
                    publishers[joint].publish(Float64(float(command[joint])))
    except KeyboardInterrupt:
        pass
    return 0
