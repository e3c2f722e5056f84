"""Make a file of desired features: from what the camera sees now, or from the target's geometry.

    rosrun aras_visual_servo_controller teach my_pose.yaml               # the pose it stands in
    rosrun aras_visual_servo_controller teach --go 2016 desired_2016.yaml
    rosrun aras_visual_servo_controller teach --geometry 2015 desired_2015.yaml   # no ROS needed
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from .desired import Desired, DesiredKernel
from .errors import ServoError
from .goals import DESIRED_JOINTS, ORDER, from_geometry
from .kinematics import JOINT_NAMES, Kinematics
from .target import target_depth


def from_samples(
    joints: np.ndarray,
    depth: float,
    order: int,
    m: np.ndarray,
    mu: np.ndarray,
    name: str,
    flange_T_optical: np.ndarray | None = None,
) -> Desired:
    """Average of several views: m, mu (images, count), all of one pose and one mounting."""
    count = (ORDER + 1) * (ORDER + 2) // 2
    if order < ORDER:
        raise ServoError(
            f"the camera node sends moments up to order {order}, {ORDER} are needed: raise ~order"
        )
    return Desired(name, joints, depth, ORDER, m[:, :count].mean(0), mu[:, :count].mean(0),
                   mounting=flange_T_optical)


def _live(arguments: argparse.Namespace) -> Desired:
    """Collect images from the running graph."""
    import rospy
    from aras_visual_servo_camera.msg import ImageMoments
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64, Float64MultiArray

    from .before.node import CONTROLLERS, NAMESPACE, find_mounting
    from .conversions import joint_positions

    rospy.init_node("teach", anonymous=True)
    images: list[ImageMoments] = []
    kernels: list[np.ndarray] = []
    joints: list[np.ndarray] = []

    def on_joints(message: JointState) -> None:
        joints[:] = [joint_positions(message.name, message.position)]

    def on_data(message: Float64MultiArray) -> None:
        if len(message.data) == 20 and message.data[18] > 0.0:
            kernels.append(np.array(message.data[16:]))

    rospy.Subscriber(f"{NAMESPACE}/joint_states", JointState, on_joints, queue_size=1)

    if arguments.go:
        publishers = [
            rospy.Publisher(f"{NAMESPACE}/{CONTROLLERS[n]}_position_controller/command", Float64,
                            queue_size=1, latch=True)
            for n in JOINT_NAMES
        ]
        for publisher, value in zip(publishers, DESIRED_JOINTS[arguments.go], strict=True):
            publisher.publish(Float64(value))
        rospy.sleep(4.0)
    rospy.Subscriber(f"{NAMESPACE}/camera/moments", ImageMoments, images.append, queue_size=5)
    rospy.Subscriber(f"{NAMESPACE}/camera/data", Float64MultiArray, on_data, queue_size=5)

    give_up = time.monotonic() + arguments.timeout
    while len([i for i in images if i.valid]) < arguments.images or not joints:
        if rospy.is_shutdown() or time.monotonic() > give_up:
            reason = images[-1].reason if images else "no images arrive"
            raise ServoError(
                f"after {arguments.timeout:.0f} s only {len(images)} images and "
                f"{'joint states' if joints else 'no joint states'} on {NAMESPACE} ({reason}): "
                "are the simulator and the camera node running, and is the target in view?"
            )
        time.sleep(0.05)

    good = [image for image in images if image.valid]
    pose = np.array(DESIRED_JOINTS[arguments.go]) if arguments.go else joints[0]
    kinematics = Kinematics(mounting=find_mounting())
    depth = arguments.depth or target_depth(kinematics.pose(pose))
    desired = from_samples(
        pose,
        depth,
        good[0].order,
        np.array([image.m for image in good]),
        np.array([image.mu for image in good]),
        arguments.file.name,
        kinematics.mounting,
    )
    if not kernels:
        return desired
    kernel = DesiredKernel(
        good[0].width, good[0].height, np.array(good[0].K).reshape(3, 3), np.mean(kernels, axis=0)
    )
    return Desired(**{**vars(desired), "kernel": kernel})


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns its exit status."""
    parser = argparse.ArgumentParser(prog="teach", description=__doc__.splitlines()[0])
    given = [a for a in (sys.argv[1:] if argv is None else argv) if ":=" not in a]
    parser.add_argument("file", type=Path, help="YAML file to write")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--geometry", choices=DESIRED_JOINTS, help="compute it, without ROS")
    source.add_argument("--go", choices=DESIRED_JOINTS, help="drive the robot there first")
    parser.add_argument("--images", type=int, default=30, help="to average over (default 30)")
    parser.add_argument("--depth", type=float, help="of the target's plane, m (default: robot's)")
    parser.add_argument("--timeout", type=float, default=30.0, help="s to wait for images")
    arguments = parser.parse_args(given)
    try:
        if arguments.geometry:
            desired = from_geometry(DESIRED_JOINTS[arguments.geometry], arguments.file.name)
            heading = "What an exact camera sees of the demo's target at this pose."
        else:
            desired = _live(arguments)
            heading = f"Taught from {arguments.images} images."
        heading += f"\nMade by: teach {' '.join(given[:-1])} {arguments.file.name}"
        arguments.file.write_text(desired.to_yaml(heading), encoding="utf-8")
    except (ServoError, OSError) as error:
        print(f"teach: {error}", file=sys.stderr)
        return 1
    print(f"wrote {arguments.file}: depth {desired.depth:.4f} m, area {desired.m[0]:.6f}")
    return 0
