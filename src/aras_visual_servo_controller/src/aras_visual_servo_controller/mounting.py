"""Where the camera sits on the flange, read from the robot's description.

The description is what the simulator, robot_state_publisher (hence tf and rviz) and this package
agree on: move the camera there and all of them follow.
"""

import xml.etree.ElementTree as ElementTree

import numpy as np

from .errors import ConfigurationError
from .kinematics import link_mounting, pose_difference, transform

FLANGE = "link6"
CAMERA_LINK = "camera_link"
OPTICAL_FRAME = "camera_optical_frame"
# Beyond these two mountings are two, m and rad.
SAME_PLACE, SAME_ANGLE = 1e-5, 1e-5


def from_description(urdf: str) -> np.ndarray:
    """`flange_T_optical` (4, 4) along the fixed joints from link6 to the camera's optical frame.

    A description without camera_optical_frame has its camera look along camera_link's +x, z up.

    Raises:
        ConfigurationError: no XML, no camera, or a joint on the way that is missing or moves.
    """
    try:
        robot = ElementTree.fromstring(urdf)
    except ElementTree.ParseError as error:
        raise ConfigurationError(f"robot_description is not XML: {error}") from error
    joints = {}
    for joint in robot.findall("joint"):
        child = joint.find("child")
        if child is not None:
            joints[child.get("link")] = joint
    if OPTICAL_FRAME in joints:
        return _chain(joints, OPTICAL_FRAME)
    if CAMERA_LINK in joints:
        return link_mounting(_chain(joints, CAMERA_LINK))
    raise ConfigurationError(
        f"robot_description has neither {OPTICAL_FRAME} nor {CAMERA_LINK}: where is its camera?"
    )


def same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two mountings (4, 4) are one, but for the rounding of what they were written in."""
    distance, angle = pose_difference(one, other)
    return distance < SAME_PLACE and angle < SAME_ANGLE


def to_xyz_rpy(mounting: np.ndarray) -> tuple[list[float], list[float]]:
    """Place (m) and fixed-axis roll, pitch, yaw (rad) of a mounting (4, 4), as URDF has them."""
    R = mounting[:3, :3]
    across = float(np.hypot(R[0, 0], R[1, 0]))
    pitch = float(np.arctan2(-R[2, 0], across))
    if across > 1e-9:
        roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    else:  # roll and yaw turn about one axis: all of it is yaw
        roll, yaw = 0.0, np.arctan2(-R[0, 1], R[1, 1])
    return [float(v) for v in mounting[:3, 3]], [float(roll), pitch, float(yaw)]


def words(mounting: np.ndarray) -> str:
    """A mounting (4, 4) for messages."""
    xyz, rpy = to_xyz_rpy(mounting)
    numbers = [round(value, 4) + 0.0 for value in (*xyz, *rpy)]  # no -0.0
    return "xyz {:.4f} {:.4f} {:.4f} rpy {:.4f} {:.4f} {:.4f}".format(*numbers)


def _chain(joints: dict[str, ElementTree.Element], link: str) -> np.ndarray:
    """`flange_T_link` (4, 4) up the fixed joints, which are known by their child link."""
    flange_T_link = np.eye(4)
    while link != FLANGE:
        joint = joints.get(link)
        if joint is None or joint.find("parent") is None:
            raise ConfigurationError(
                f"robot_description: {link} hangs on no {FLANGE}, where the camera has to be"
            )
        if joint.get("type") != "fixed":
            raise ConfigurationError(
                f"robot_description: joint {joint.get('name')} between {FLANGE} and the camera is "
                f"'{joint.get('type')}', it has to be 'fixed'"
            )
        flange_T_link = _origin(joint) @ flange_T_link
        link = joint.find("parent").get("link")
    return flange_T_link


def _origin(joint: ElementTree.Element) -> np.ndarray:
    """Pose (4, 4) of a joint in its parent."""
    origin = joint.find("origin")
    values = []
    for key in ("xyz", "rpy"):
        text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
        try:
            numbers = [float(word) for word in text.split()]
        except ValueError:
            numbers = []
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            raise ConfigurationError(
                f"robot_description: {key}='{text}' of joint {joint.get('name')} must be three "
                "finite numbers"
            )
        values.append(numbers)
    return transform(*values)
