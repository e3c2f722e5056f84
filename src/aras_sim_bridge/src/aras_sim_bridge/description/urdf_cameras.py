"""The cameras of a URDF, without what its links weigh, show and touch."""

from xml.etree.ElementTree import Element

from aras_sim_bridge.description import gazebo_tags
from aras_sim_bridge.description.types import CameraDescription, Link
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.urdf import Joint, UrdfTree, parse_tree


def parse_cameras(xml: str | Element) -> tuple[CameraDescription, ...]:
    """The cameras of a URDF, without what its links look like; raises as `parse_urdf`."""
    robot = safe_xml.parse(xml, "URDF")
    tree = parse_tree(robot)
    links = {name: Link(name, None, (), ()) for name in tree.links}

    def unread(uri: str, _where: str) -> str:
        return uri

    return gazebo_tags.parse(robot, links, tree.joints, link_poses(tree), unread, []).cameras


def link_poses(tree: UrdfTree) -> dict[str, Pose]:
    """Poses of the links in the root's frame, with all joints at 0."""
    below: dict[str, list[Joint]] = {}
    for joint in tree.joints.values():
        below.setdefault(joint.parent, []).append(joint)
    poses = {tree.root: Pose()}
    pending = [tree.root]
    for link in pending:
        for joint in below.get(link, ()):
            poses[joint.child] = poses[link] @ joint.pose
            pending.append(joint.child)
    return poses
