"""What a run looks like, as markers for rviz: camera, goal, paths, twists, features, words."""

from __future__ import annotations

import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_ros.shutdown import iterate_at_period, node_main

from ..drawing.shapes import ARROW, FACES, LINES, STRIP, TEXT, Shape
from .graph_listener import GraphListener, make_listener_settings
from .target_watch import TargetWatch

PERIOD = 0.1  # s of wall time; rviz draws 30 times a second, and interpolates nothing
MARKER_TYPES = {
    LINES: Marker.LINE_LIST, STRIP: Marker.LINE_STRIP, ARROW: Marker.ARROW,
    TEXT: Marker.TEXT_VIEW_FACING, FACES: Marker.TRIANGLE_LIST,
}  # fmt: skip
HEAD_WIDTH, HEAD_LENGTH = 2.2, 3.0  # an arrow's head, in widths of its shaft


def make_marker(shape: Shape, frame: str) -> Marker:
    """visualization_msgs/Marker of a shape; one without points takes the former one away."""
    message = Marker(ns=shape.name, type=MARKER_TYPES[shape.kind], action=Marker.ADD)
    message.header.frame_id = frame  # stamp 0: as the frame stands now
    message.pose.orientation.w = 1.0
    if not len(shape.points):
        message.action = Marker.DELETE
        return message
    message.color = ColorRGBA(*shape.colour)
    width = shape.width
    if shape.kind == TEXT:
        message.text, message.scale.z = shape.text, width
        place = message.pose.position
        place.x, place.y, place.z = (float(v) for v in shape.points[0])
        return message
    message.scale.x = width
    if shape.kind == FACES:  # a factor there
        message.scale.x = message.scale.y = message.scale.z = 1.0
    if shape.kind == ARROW:
        message.scale.y, message.scale.z = HEAD_WIDTH * width, HEAD_LENGTH * width
    message.points = [Point(*point) for point in shape.points.tolist()]
    return message


def make_markers(shapes: list[Shape], frame: str, previous: set[str]) -> MarkerArray:
    """All of them, and the end of those of `previous` that are no more."""
    array = MarkerArray([make_marker(shape, frame) for shape in shapes])
    for name in sorted(previous - {shape.name for shape in shapes}):
        array.markers.append(Marker(ns=name, action=Marker.DELETE))
    return array


def main() -> int:
    """Run the node; returns its exit status."""
    return node_main(
        "aras_visual_servo_markers", __doc__, _publish, ConfigurationError, disable_rostime=True
    )


def _publish() -> None:
    """Draw, ten times a second, for whoever looks."""
    settings = make_listener_settings(rospy.get_param("~", {}))
    listener, target, drawn = GraphListener(settings), TargetWatch(), set()
    topic = f"{settings.namespace.rstrip('/')}/markers"
    publisher = rospy.Publisher(topic, MarkerArray, queue_size=1)
    for _ in iterate_at_period(PERIOD):
        story = listener.update()
        if story is not None and publisher.get_num_connections():
            target.update(story, listener.robot_name)
            with listener.lock:
                shapes, frame = story.make_shapes(), story.arm.target_frame or story.arm.base_frame
            publisher.publish(make_markers(shapes, frame, drawn))
            drawn = {shape.name for shape in shapes}
