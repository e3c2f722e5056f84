"""Changes of robot descriptions.

The functions move a camera, mount it at the pose of a hand-eye calibration, or remove the friction
of the joints.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import TYPE_CHECKING

import numpy as np

from .errors import DescriptionError, HandEyeFileError
from .names import suggest
from .poses import LINK_R_OPTICAL, inverse, matrix_from_xyz_rpy, optical_pose, xyz_rpy_from_matrix
from .urdf import LINK, OPTICAL, parse_tree

if TYPE_CHECKING:
    from .hand_eye_files import HandEyeCalibration

CAMERA_LINK, CAMERA_MOUNT = "camera_link", "camera_mount"


def find_camera_link(urdf: str, calibration: HandEyeCalibration, link: str = "") -> str:
    """Return the name of the link that carries the camera.

    It is `link`, or, if `link` is '', the link that the calibration file names.

    Raises:
        HandEyeFileError: neither `link` nor the file names a link, or the robot description `urdf`
            has no link with this name.
    """
    name, links = link or calibration.link, parse_tree(urdf).links
    if not name:
        raise HandEyeFileError(
            "the file does not name the link that carries the camera: set "
            "hand_eye.link (launch: hand_eye_link), for example tool0"
        )
    if name not in links:
        raise HandEyeFileError(f"the description has no link '{name}' that could carry the camera "
                               f"({suggest(name, links)}): set hand_eye.link")  # fmt: skip
    return name


def check_optical(calibration: HandEyeCalibration) -> None:
    """Check that the calibrated camera frame is named as an optical frame, or has no name.

    Raises:
        HandEyeFileError: the frame has a name that does not contain "optical".
    """
    if calibration.frame and "optical" not in calibration.frame:
        raise HandEyeFileError(
            f"the hand-eye file contains the pose of the frame '{calibration.frame}', which is not "
            "in the description. Check whether this is the optical frame (z forward); if so, "
            f"rename it in the file to {calibration.frame}_optical_frame"
        )


def mount_camera(urdf: str, calibration: HandEyeCalibration, link: str, camera_frame: str) -> str:
    """Return a robot description (URDF) whose camera has the pose of a hand-eye calibration.

    The camera link is moved, and all links that it carries move with it. The name of the camera
    link follows from that of the optical frame: `camera_link` for `camera_optical_frame`. If the
    description does not contain the camera link or the optical frame, they are added. The optical
    frame is not added if a camera sensor of the camera link defines it.

    Args:
        link: link that carries the camera; '' for the link that the calibration file names.
        camera_frame: name of the camera's optical frame.

    Raises:
        HandEyeFileError: a link does not exist, or the camera can move relative to the link that
            carries it.
    """
    tree, robot = parse_tree(urdf), ElementTree.fromstring(urdf)
    carrier = find_camera_link(urdf, calibration, link)
    moved = f"{camera_frame.removesuffix(OPTICAL)}{LINK}"
    if moved not in tree.links and (camera_frame in tree.links or OPTICAL not in camera_frame):
        moved = camera_frame
    frame = calibration.frame if calibration.frame in (*tree.links, moved) else camera_frame
    if frame == camera_frame:
        check_optical(calibration)
    moved_T_frame = np.eye(4)
    if frame in tree.links and moved in tree.links:
        try:
            for joint in tree.find_path(moved, frame):
                if joint.kind != "fixed":
                    raise HandEyeFileError(
                        f"joint '{joint.name}' moves {frame} relative to {moved}: a "
                        "hand-eye calibration needs a fixed camera; make the joint "
                        "fixed"
                    )
                moved_T_frame = moved_T_frame @ matrix_from_xyz_rpy(
                    joint.origin_xyz, joint.origin_rpy
                )
        except DescriptionError as error:
            raise HandEyeFileError(
                f"the camera frame '{frame}' is not fixed to the camera link '{moved}': {error}"
            ) from None
    elif frame != moved and moved in tree.cameras:
        moved_T_frame = optical_pose(tree.cameras[moved].matrix())
    elif frame != moved:
        moved_T_frame[:3, :3] = LINK_R_OPTICAL
    joint = next((j for j in robot.findall("joint") if j.find("child").get("link") == moved), None)
    if joint is not None and joint.get("type") != "fixed":
        raise HandEyeFileError(f"joint '{joint.get('name')}' moves {moved}: a hand-eye calibration "
                               "needs a camera that is fixed to its link; make the joint "
                               "fixed")  # fmt: skip
    if moved in tree.links and moved in (carrier, *(j.parent for j in tree.find_path("", carrier))):
        raise HandEyeFileError(f"link '{carrier}' is the camera itself or a child of it: set "
                               "hand_eye.link to the link that carries the camera")  # fmt: skip
    link_T_moved = calibration.link_T_camera @ inverse(moved_T_frame)
    if joint is None:
        add_fixed_joint(robot, carrier, moved, link_T_moved)
    else:
        _set_joint_pose(joint, carrier, link_T_moved)
    if moved not in tree.links:
        ElementTree.SubElement(robot, "link", name=moved)
    placed = frame == camera_frame or moved not in tree.links
    if placed and camera_frame not in (*tree.links, moved) and moved not in tree.cameras:
        add_fixed_joint(robot, moved, camera_frame, optical_pose(np.eye(4)))
        ElementTree.SubElement(robot, "link", name=camera_frame)
    return ElementTree.tostring(robot, encoding="unicode")


def add_fixed_joint(
    robot: ElementTree.Element, parent: str, child: str, parent_T_child: np.ndarray
) -> None:
    """Add a fixed joint between two links at the pose parent_T_child (4, 4)."""
    joint = ElementTree.SubElement(robot, "joint", name=f"{child}_joint", type="fixed")
    ElementTree.SubElement(joint, "child", link=child)
    _set_joint_pose(joint, parent, parent_T_child)


def _set_joint_pose(joint: ElementTree.Element, parent: str, parent_T_child: np.ndarray) -> None:
    """Attach the joint's child to the link `parent` at the pose parent_T_child (4, 4)."""
    for old in (*joint.findall("parent"), *joint.findall("origin")):
        joint.remove(old)
    xyz, rpy = (" ".join(map(repr, part)) for part in xyz_rpy_from_matrix(parent_T_child))
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "origin", xyz=xyz, rpy=rpy)


def move_camera(urdf: str, xyz: str, rpy: str) -> str:
    """Return a robot description in which camera_link is displaced from its present pose.

    A new link, camera_mount, is added at the former pose of camera_link, and camera_link is
    attached to it.

    Args:
        xyz: translation, m, as in the attribute xyz of a URDF.
        rpy: rotation about fixed axes, rad, as in the attribute rpy of a URDF.

    Raises:
        ValueError: the description does not have exactly one joint that carries camera_link.
    """
    robot = ElementTree.fromstring(urdf)
    joints = [j for j in robot.findall("joint") if j.find("child").get("link") == CAMERA_LINK]
    if len(joints) != 1:
        raise ValueError(f"{len(joints)} joints carry {CAMERA_LINK}; exactly one is required")
    joints[0].find("child").set("link", CAMERA_MOUNT)
    ElementTree.SubElement(robot, "link", name=CAMERA_MOUNT)
    joint = ElementTree.SubElement(robot, "joint", name=f"{CAMERA_MOUNT}_joint", type="fixed")
    ElementTree.SubElement(joint, "parent", link=CAMERA_MOUNT)
    ElementTree.SubElement(joint, "child", link=CAMERA_LINK)
    ElementTree.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    return ElementTree.tostring(robot, encoding="unicode")


def remove_friction(urdf: str) -> str:
    """Return a robot description without dry friction of the joints."""
    robot = ElementTree.fromstring(urdf)
    for dynamics in robot.iterfind("joint/dynamics"):
        dynamics.set("friction", "0")
    return ElementTree.tostring(robot, encoding="unicode")
