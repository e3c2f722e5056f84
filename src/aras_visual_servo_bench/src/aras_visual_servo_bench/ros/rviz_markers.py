"""Node that shows a run in rviz as markers: camera, goal, paths, twists, features and texts."""

from __future__ import annotations

import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_ros.shutdown import iterate_at_period, node_main

from ..visualization.drawing_shapes import ARROW, FACES, LINES, STRIP, TEXT, DrawingShape
from .graph_listener import GraphListener, make_listener_settings
from .target_drawing_updater import TargetDrawingUpdater

PERIOD = 0.1  # time between two publications of the markers, s of wall time
MARKER_TYPES = {
    LINES: Marker.LINE_LIST, STRIP: Marker.LINE_STRIP, ARROW: Marker.ARROW,
    TEXT: Marker.TEXT_VIEW_FACING, FACES: Marker.TRIANGLE_LIST,
}  # fmt: skip
# width and length of an arrow's head, divided by the width of its shaft
HEAD_WIDTH, HEAD_LENGTH = 2.2, 3.0


def make_marker(shape: DrawingShape, frame: str) -> Marker:
    """Convert a shape to a visualization_msgs/Marker.

    If the shape has no points, the message deletes the marker in rviz.

    frame: name of the frame of the points.
    """
    message = Marker(ns=shape.name, type=MARKER_TYPES[shape.kind], action=Marker.ADD)
    message.header.frame_id = frame  # the stamp remains 0, so that rviz uses the latest transform
    message.pose.orientation.w = 1.0
    if not len(shape.points):
        message.action = Marker.DELETE
        return message
    message.color = ColorRGBA(*shape.colour)
    width = shape.width
    if shape.kind == TEXT:
        message.text, message.scale.z = shape.text, width
        position = message.pose.position
        position.x, position.y, position.z = (float(v) for v in shape.points[0])
        return message
    message.scale.x = width
    # For a triangle list, rviz multiplies the vertices by the scale, so the scale has to be 1.
    if shape.kind == FACES:
        message.scale.x = message.scale.y = message.scale.z = 1.0
    if shape.kind == ARROW:
        message.scale.y, message.scale.z = HEAD_WIDTH * width, HEAD_LENGTH * width
    message.points = [Point(*point) for point in shape.points.tolist()]
    return message


def make_markers(shapes: list[DrawingShape], frame: str, previous: set[str]) -> MarkerArray:
    """Return the markers of all shapes, and messages that delete obsolete markers.

    Args:
        shapes: shapes of the drawing.
        frame: name of the frame of their points.
        previous: names of the shapes in the last message.
    """
    array = MarkerArray([make_marker(shape, frame) for shape in shapes])
    for name in sorted(previous - {shape.name for shape in shapes}):
        array.markers.append(Marker(ns=name, action=Marker.DELETE))
    return array


def main() -> int:
    """Run the node and return its exit status."""
    return node_main(
        "aras_visual_servo_markers", __doc__, _publish, ConfigurationError, disable_rostime=True
    )


def _publish() -> None:
    """Publish the markers every PERIOD if a subscriber such as rviz is connected."""
    settings = make_listener_settings(rospy.get_param("~", {}))
    listener, target, previous = GraphListener(settings), TargetDrawingUpdater(), set()
    topic = f"{settings.namespace.rstrip('/')}/markers"
    publisher = rospy.Publisher(topic, MarkerArray, queue_size=1)
    for _ in iterate_at_period(PERIOD):
        trace = listener.update()
        if trace is not None and publisher.get_num_connections():
            target.update(trace, listener.robot_name)
            with listener.lock:
                shapes, frame = trace.make_shapes(), trace.arm.target_frame or trace.arm.base_frame
            publisher.publish(make_markers(shapes, frame, previous))
            previous = {shape.name for shape in shapes}
