"""Drive two joints by the arrow keys, in steps of 0.05 (m, rad), as the original did.

    left, right     the first (gantry)     up, down     the second (J2)
    space           where are we           q, ^C        end

Others than gantry and J2: ~across and ~along.
"""

import contextlib
import os
import select
import sys
import termios
import threading
import tty
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from .arm import Limits
from .errors import ConfigurationError, MeasurementError, ServoError
from .naming import unknown
from .settings import Settings

STEP = 0.05
JOINTS = {"across": "gantry", "along": "J2"}
KEYS = {
    "\x1b[D": ("across", -STEP),
    "\x1b[C": ("across", STEP),
    "\x1b[A": ("along", STEP),
    "\x1b[B": ("along", -STEP),
}


def command_for(
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

    rospy.init_node("aras_teleop", anonymous=True, disable_signals=True)
    try:
        return _drive()
    except ServoError as error:
        print(f"aras_teleop: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0


def _drive() -> int:
    import rospkg
    import rospy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    package = Path(rospkg.RosPack().get_path("aras_visual_servo_controller"))
    settings = Settings(package=package)
    urdf = str(rospy.get_param(settings.description, ""))
    if not urdf:
        raise ConfigurationError(f"no robot description on parameter {settings.description}")
    settings = settings.for_robot(ElementTree.fromstring(urdf).get("name", ""), ())
    arm = settings.arm(urdf)
    limits, space = settings.limits(arm), settings.namespace.rstrip("/")
    joints = {way: str(rospy.get_param(f"~{way}", name)) for way, name in JOINTS.items()}
    for name in joints.values():
        if name not in arm.names:
            raise unknown("joint", name, arm.names)
    measured: dict[str, np.ndarray] = {}
    heard = threading.Event()

    def on_joints(message: JointState) -> None:
        with contextlib.suppress(MeasurementError):
            measured["q"] = arm.sample(message.name, message.position).positions
            heard.set()

    rospy.Subscriber(f"{space}/joint_states", JointState, on_joints, queue_size=1)
    publishers = {
        way: rospy.Publisher(
            f"{space}/{settings.controllers.get(name, f'{name}_position_controller')}/command",
            Float64,
            queue_size=1,
        )
        for way, name in joints.items()
    }
    print(__doc__)
    while not heard.wait(2.0):
        print(f"waiting for joint states on {space}/joint_states")
    command = measured["q"].copy()
    with _raw_terminal():
        while not rospy.is_shutdown():
            key = _key(0.2)
            if key in ("q", "\x04"):
                break
            if key == " ":
                print("  ".join(f"{n} {v:.3f}" for n, v in
                                zip(arm.names, measured["q"], strict=True)))
            command, told = command_for(key, command, limits, joints)
            if told:
                print(told)
                way = KEYS[key][0]
                value = command[limits.names.index(joints[way])]
                publishers[way].publish(Float64(float(value)))
    return 0
