"""Node of the live page and rviz markers on a graph: input, drawing, commands and output."""

import sys
import threading
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rospy
from gazebo_msgs.srv import GetModelState, GetWorldProperties
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from rospy import AnyMsg
from run_messages import ARM, made_state, position
from sensor_msgs.msg import Image
from std_msgs.msg import ColorRGBA
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import RefusedRequestError
from aras_visual_servo_bench.ros import dashboard, teleoperator
from aras_visual_servo_bench.ros import live_image_subscriber as live
from aras_visual_servo_bench.ros import rviz_markers as markers
from aras_visual_servo_bench.ros import target_drawing_updater as target_watch
from aras_visual_servo_bench.ros.graph_listener import GraphListener, make_listener_settings
from aras_visual_servo_bench.ros.target_pose_reader import TargetPoseReader, has_moved
from aras_visual_servo_bench.visualization import drawing_shapes as shapes
from aras_visual_servo_bench.visualization.run_drawing import RunDrawing
from aras_visual_servo_bench.web.live.page_requests import PageRequest
from aras_visual_servo_controller.errors import ConfigurationError, ServoError
from aras_visual_servo_controller.kinematics import Arm

GIVEN = {"namespace": "/two/", "camera_namespace": "/eye/camera/", "command_topic": "both"}
SQUARE = """<robot name="t"><link name="t"><visual><geometry><box size="0.2 0.1 0.02"/></geometry>
</visual></link></robot>"""
LAY = Pose(Point(0.1, 0.2, 0.3), Quaternion(0.5, 0.5, 0.5, 0.5))


@pytest.fixture
def listener(graph, life):
    """Listener of the arm of two joints that has received messages."""
    graph.parameters["/robot_description"] = ARM
    it = GraphListener(make_listener_settings(GIVEN))
    it.update()
    it.positions, it.velocities = position(1.5), np.array([0.01, 0.02])
    return it


def test_pictures_are_heard_while_somebody_looks(graph):
    overlay, plain = "/two/camera/overlay", "/eye/camera/image_raw"
    pictures = live.LiveImageSubscriber("/two", "/eye/camera")
    pictures.choose_topic()
    assert not graph.subscribers and pictures.note == live.PLAIN_NOTE
    pictures.set_viewer_count(2)
    assert set(graph.subscribers) == {overlay}
    pictures.choose_topic()  # no camera node
    assert set(graph.subscribers) == {overlay, plain}
    assert pictures.note == f"no image: no node publishes {overlay} or {plain}"
    graph.sources[plain] = 1
    pictures.choose_topic()
    assert pictures.note == live.PLAIN_NOTE
    plain_heard = graph.subscribers[plain]
    pictures.set_viewer_count(1)
    pictures.choose_topic()
    assert graph.subscribers[plain] is plain_heard
    kind, options = graph.heard[overlay]
    assert kind is Image and options == {"queue_size": 1, "buff_size": 2**24, "tcp_nodelay": True}
    assert pictures.take_jpeg() is None
    red_above = np.zeros((20, 30, 3), np.uint8)
    red_above[:10, :, 0], red_above[10:, :, 2] = 220, 90
    message = Image(height=20, width=30, step=90, encoding="rgb8", data=red_above.tobytes())
    graph.subscribers[plain](message)
    found = cv2.imdecode(np.frombuffer(pictures.take_jpeg(), np.uint8), cv2.IMREAD_COLOR)
    assert found.shape == (20, 30, 3)
    np.testing.assert_allclose(found[4, 15], [0, 0, 220], atol=9)
    np.testing.assert_allclose(found[16, 15], [90, 0, 0], atol=9)
    assert pictures.take_jpeg() is None  # each once
    graph.subscribers[overlay](Image(encoding="none"))
    assert pictures.take_jpeg() is None
    graph.sources[overlay] = 1
    pictures.choose_topic()
    assert set(graph.subscribers) == {overlay} and pictures.note == live.OVERLAY_NOTE
    graph.subscribers[overlay](message)
    pictures.set_viewer_count(0)
    assert not graph.subscribers and pictures.take_jpeg() is None
    pictures.set_viewer_count(0)
    pictures.choose_topic()
    assert not graph.subscribers


@pytest.fixture
def world(graph):
    it = SimpleNamespace(models=["ground", "target", "two"], asked=[], success=True)

    def state(request):
        it.asked.append((request.model_name, request.relative_entity_name))
        answer = GetModelState._response_class(success=it.success, pose=LAY)
        answer.header.frame_id = request.relative_entity_name
        return answer

    rospy.Service("/gazebo/get_model_state", GetModelState, state)
    rospy.Service("/gazebo/get_world_properties", GetWorldProperties, lambda _: (
        GetWorldProperties._response_class(model_names=it.models)))
    return it


def test_the_target_is_asked_for_where_there_is_one(graph, world):
    place = TargetPoseReader()
    assert place.has_simulator is False
    found = place.read_pose("two")
    assert (found.header.frame_id, found.pose) == ("two", LAY) and place.has_simulator
    assert place.read_pose("three").header.frame_id == ""
    assert world.asked == [("target", "two"), ("target", "")]
    world.success = False
    assert place.read_pose("two") is None and place.has_simulator
    world.models.remove("target")
    assert place.read_pose("two") is None and place.has_simulator and len(world.asked) == 3
    graph.services.pop("/gazebo/get_world_properties")
    assert place.read_pose("two") is None and not place.has_simulator


def test_a_model_has_moved_when_one_of_its_numbers_has():
    def pose(**more):
        numbers = {"x": 0.1, "y": 0.2, "z": 0.3, "qx": 0.5, "qy": 0.5, "qz": 0.5, "qw": 0.5, **more}
        return Pose(Point(*list(numbers.values())[:3]), Quaternion(*list(numbers.values())[3:]))

    assert has_moved(None, pose()) and not has_moved(pose(), pose())
    for name, value in (("x", 0.1), ("y", 0.2), ("z", 0.3), ("qx", 0.5), ("qw", 0.5)):
        assert has_moved(pose(), pose(**{name: value + 1.1e-5}))
        assert has_moved(pose(**{name: value + 1.1e-5}), pose())
        assert not has_moved(pose(), pose(**{name: value - 0.9e-5}))


def test_the_target_is_drawn_where_it_lies_twice_a_second(graph, life, world):
    story = RunDrawing(Arm.from_urdf(ARM, "camera_optical_frame"))
    watch = target_watch.TargetDrawingUpdater()
    graph.parameters["/target_description"] = SQUARE

    def look(seconds=0.6):
        life.now += seconds
        watch.update(story, "two")
        return [len(shape.points) for shape in story.target]

    look()
    edges, *faces = story.target
    a_T_b = matrix_from_xyz_rpy((0.1, 0.2, 0.3), (0.0, 0.0, 0.0))
    a_T_b[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # a third of a turn about (1, 1, 1)
    half = np.array([0.1, 0.05, 0.01])
    corners = np.array([half * (x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = corners @ a_T_b[:3, :3].T + a_T_b[:3, 3]
    for shape in (edges, *faces):
        np.testing.assert_allclose(
            np.unique(shape.points.round(6), axis=0), np.unique(corners.round(6), axis=0))
    assert len(edges.points) == 24 and watch.missing_reason == "" and len(world.asked) == 1
    drawn = story.target
    look(0.5)
    assert len(world.asked) == 1 and story.target is drawn
    world.models.remove("target")
    assert look(0.001) == [0]
    assert watch.missing_reason == "the simulation has no model named target"
    graph.services.clear()  # a replay
    assert look() == [0] and watch.missing_reason == ""
    told = PoseStamped(pose=LAY)
    assert graph.heard["/aras_visual_servo/target"] == (PoseStamped, {"queue_size": 1})
    graph.subscribers["/aras_visual_servo/target"](told)
    look()
    np.testing.assert_array_equal(story.target[0].points, drawn[0].points)
    for description in ("", 7, "<robot", SQUARE.replace("0.02", "-1")):
        graph.parameters["/target_description"] = description
        assert look() == [0]
    graph.parameters["/target_description"] = SQUARE.replace("0.2", "0.4")
    look()
    assert np.ptp(story.target[0].points, axis=0) == pytest.approx([0.02, 0.4, 0.1])
    story.arm = Arm.from_urdf(ARM, "camera_optical_frame", target_frame="hand")  # it carries it
    assert look() == [0]


def test_each_kind_of_shape_is_a_marker():
    points = np.array([(0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (0.7, 0.8, 0.9)])
    colour = (0.1, 0.3, 0.5, 0.7)

    def made(kind, width=0.02, points=points, text=""):
        shape = shapes.DrawingShape("it", kind, points, colour, width, text)
        return markers.make_marker(shape, "base")

    for kind, number, scale in ((shapes.LINES, Marker.LINE_LIST, (0.02, 0, 0)),
                                (shapes.STRIP, Marker.LINE_STRIP, (0.02, 0, 0)),
                                (shapes.FACES, Marker.TRIANGLE_LIST, (1, 1, 1)),
                                (shapes.ARROW, Marker.ARROW, (0.02, 0.044, 0.06))):
        marker = made(kind)
        assert (marker.ns, marker.type, marker.action) == ("it", number, Marker.ADD)
        assert marker.header.frame_id == "base" and marker.header.stamp == rospy.Time()
        assert marker.color == ColorRGBA(*colour) and marker.pose.orientation.w == 1.0
        assert (marker.scale.x, marker.scale.y, marker.scale.z) == pytest.approx(scale)
        assert marker.points == [Point(*row) for row in points.tolist()]
    text = made(shapes.TEXT, text="words")
    assert (text.type, text.text, text.scale.z) == (Marker.TEXT_VIEW_FACING, "words", 0.02)
    assert text.pose.position == Point(0.1, 0.2, 0.3) and not text.points and text.scale.x == 0.0
    assert text.color == ColorRGBA(*colour)
    gone = made(shapes.LINES, points=np.zeros((0, 3)))
    assert gone.action == Marker.DELETE and not gone.points


def test_markers_are_published_for_who_looks_and_taken_away_again(graph, life, world):
    graph.parameters["/robot_description"] = ARM
    for key, value in GIVEN.items():
        rospy.set_param(f"~{key}", value)
    graph.parameters["/target_description"] = SQUARE

    def publisher():
        return graph.publishers["/two/markers"]

    def look():
        publisher().impl.connections = [None]

    def other():
        publisher().sent.clear()
        life.now += 1.0
        world.models.remove("target")

    def leave():
        publisher().impl.connections = []

    life.steps = [look, other, leave, lambda: None]
    assert markers.main() == 0
    options = {"disable_signals": True, "disable_rostime": True}
    assert life.begun == [("aras_visual_servo_markers", options)]
    assert set(life.slept) == {0.1} and world.asked == [("target", "two")]
    assert publisher().kind is markers.MarkerArray and publisher().options["queue_size"] == 1
    after, = publisher().sent
    names = [(one.ns, one.action) for one in after.markers if one.ns.startswith("target")]
    assert names == [("target", Marker.DELETE), ("target face 0", Marker.DELETE)]
    assert after.markers[0].header.frame_id == "base"


class Wake:
    def __init__(self, life):
        self.life, self.up = life, False

    def set(self):
        self.up = True

    def clear(self):
        self.up = False

    def wait(self, limit):
        if not self.up:
            self.life.sleep(limit)


@pytest.fixture
def driven(graph, life, listener, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(threading, "Thread", life.thread)
        patch.setattr(threading, "Event", lambda: Wake(life))
        it = teleoperator.Teleoperator(listener, listener.settings)
    thread, = life.threads
    assert (thread.name, thread.daemon, thread.started) == ("teleoperator", True, True)

    def sent():
        topic = graph.publishers.get("/two/both")
        return [] if topic is None else [list(one.data) for one in topic.sent]

    def run(seconds):
        """The thread, for so long, with joints that follow; what is sent."""
        before, end, life.down = len(sent()), life.now + seconds, False

        def on():
            life.down = life.now >= end
            if sent()[before:]:
                listener.positions = np.array(sent()[-1])

        life.steps = 200 * [on]
        thread.target()
        return sent()[before:]

    it.run = run
    return it


def test_a_joint_is_driven_for_a_moment(graph, life, listener, driven):
    stopped = []
    rospy.Service("/two/controller/stop", Trigger, lambda _: stopped.append(life.now) or (
        Trigger._response_class(True, "")))
    assert driven.move_camera(*[0.0] * 6) == "" and not graph.publishers.get("/two/both")
    assert driven.run(0.3) == []
    listener.run_trace.state = made_state(1.0, "stopped")
    assert driven.move_joint("elbow", -0.5) == "" and not stopped
    slide, elbow = listener.positions
    sent = np.array(driven.run(0.8))
    assert (sent[:, 0] == slide).all() and (np.diff(sent[:, 1]) <= 1e-12).all()
    assert elbow - 0.5 < sent[-1, 1] < elbow - 0.1 and 10 < len(sent) < 40
    assert life.slept.count(0.02) > 10
    listener.run_trace.state = made_state(1.0, "servoing")
    driven.move_joint("slide", 0.5)
    assert len(stopped) == 1 and life.waited == [("/two/controller/stop", 0.5)]
    with pytest.raises(ConfigurationError, match="finger"):
        driven.move_joint("finger", 1.0)


def test_the_camera_is_driven_by_a_twist(graph, life, listener, driven):
    way = listener.run_trace.arm.pose(listener.positions)[:3, :3].T @ np.array([1.0, 0.0, 0.0])
    driven.move_camera(*(0.1 * way), 0.0, 0.0, 0.0)
    driven.move_camera(*[0.0] * 6)  # at once
    assert np.ptp(driven.run(0.3), axis=0).max() < 1e-9
    driven.move_camera(0.25, 0.1, -0.1, 0.3, 0.2, 0.5)
    assert np.ptp(driven.run(0.3), axis=0).max() > 1e-3


def test_another_robot_is_driven_by_topics_of_its_own(graph, life, listener, driven):
    driven.move_joint("elbow", 0.5)
    first = graph.publishers["/two/both"]
    driven.move_joint("elbow", 0.5)
    assert graph.publishers["/two/both"] is first
    listener.run_trace = RunDrawing(Arm.from_urdf(ARM.replace('"elbow"', '"wrist"'),
                                         "camera_optical_frame"))
    driven.move_joint("wrist", 0.5)
    assert first.impl is None and driven.run(0.1) != []
    listener.positions = None
    with pytest.raises(RefusedRequestError,
                       match="^no joint states are received: is the robot running"):
        driven.move_joint("wrist", 0.5)
    listener.run_trace = None
    with pytest.raises(RefusedRequestError, match="^no joint states are received"):
        driven.move_camera(*[0.1] * 6)


def test_joints_without_a_controller_are_not_driven(graph, life, monkeypatch):
    monkeypatch.setattr(threading, "Thread", life.thread)
    graph.parameters |= {"/robot_description": ARM, "/two/s/type": "velocity_controllers/Joint"
                         "VelocityController", "/two/s/joint": "slide"}
    it = GraphListener(make_listener_settings({"namespace": "/two"}))
    it.update()
    it.positions = position(1.0)
    with pytest.raises(RefusedRequestError, match="slide"):
        teleoperator.Teleoperator(it, it.settings).move_joint("slide", 1.0)


@pytest.fixture
def host(listener, life, monkeypatch, tmp_path):
    monkeypatch.setattr(threading, "Thread", life.thread)
    it = dashboard.Dashboard(listener, "robo", tmp_path)
    yield it
    it.close()


@pytest.mark.parametrize("name", ["start", "stop", "hold"])
def test_a_request_reaches_the_loop_or_says_why_not(host, name):
    with pytest.raises(RefusedRequestError, match="controller"):
        host.execute(PageRequest(name, {}))
    rospy.Service(f"/two/controller/{name}", Trigger, lambda _: (
        Trigger._response_class(True, f"{name}: servoing")))
    assert "servoing" in host.execute(PageRequest(name, {}))


def test_recording_and_teaching_are_refused_where_nothing_would_be_recorded(
    host, listener, tmp_path
):
    """The recorder waited for a time, and the page had no answer."""
    listener.run_trace.factor = None
    with pytest.raises(RefusedRequestError, match="^/gazebo/get_world_properties does not answer"):
        host.execute(PageRequest("record", {}))
    assert not (tmp_path / "bags").exists()
    teach = PageRequest("teach", {"name": "mine"})
    listener.run_trace.factor = None
    with pytest.raises(RefusedRequestError,
                       match="^the simulation is paused, so there are no images"):
        host.execute(teach)
    listener.run_trace.factor, listener.no_target_reason = 1.0, "dark"
    with pytest.raises(RefusedRequestError,
                       match=r"target is not detected \(dark\): bring it into"):
        host.execute(teach)
    listener.run_trace = None
    with pytest.raises(RefusedRequestError, match="^the simulation is paused"):
        host.execute(teach)


def test_the_robot_is_drawn_once_and_news_are_of_its_joints(host, graph, listener):
    first = host.make_robot_model()
    assert first["name"] == "two" and host.make_robot_model() is first
    listener.urdf = "<robot"
    empty = {"name": "", "root": "", "joints": [], "links": {}}
    assert host.make_robot_model() == empty and host.make_robot_model() == empty
    line, = graph.lines
    assert line.startswith("the live page cannot draw the robot: ")
    listener.urdf = ""
    assert host.make_robot_model() is None
    news = host.make_update()
    assert news["joints"] == pytest.approx(position(1.5).tolist())
    assert news["velocities"] == [0.01, 0.02] and news["stamp"] == 0.0
    listener.stamp, listener.positions = 1.75, None
    news = host.make_update()
    assert "joints" not in news and news["stamp"] == 1.75


def test_a_page_on_a_dead_graph_says_what_is_missing_and_why(graph, life, tmp_path, monkeypatch):
    monkeypatch.setattr(threading, "Thread", life.thread)
    it = GraphListener(make_listener_settings(GIVEN))
    host = dashboard.Dashboard(it, "robo", tmp_path)

    def missing():
        life.now += 3.0
        host.refresh()
        return host.page.state["missing"]

    host.set_viewer_count(1)
    assert missing().startswith("There is no robot: parameter robot_description is not set")
    assert "roslaunch" in missing()
    graph.parameters["/robot_description"] = ARM
    assert missing().startswith("No node publishes the joint states (/two/joint_states)")
    graph.sources["/two/joint_states"] = 1
    assert "paused (press Resume)" in missing()
    life.now += 3.0
    graph.subscribers["/two/joint_states"](AnyMsg())
    host.refresh()
    assert host.page.state["missing"] == ""
    assert "paused" in missing()
    def dead(_name):
        raise ConnectionRefusedError

    monkeypatch.setattr(rospy, "has_param", dead)
    assert missing().startswith("The ROS master at http")


def test_parameters_of_the_page_and_pages_that_cannot_be_served(graph, life, monkeypatch):
    own, rest = dashboard.split_parameters({"port": 9000, "namespace": "/x", "token": "a" * 12})
    assert (own.host, own.port, own.token, own.robot) == ("127.0.0.1", 9000, "a" * 12,
                                                          "aras_visual_servo")
    assert rest == {"namespace": "/x"}
    for given, why in (({"token": "a" * 11}, "easy to guess"), ({"token": 12 * "\u00e4"}, "easy"),
                       ({"port": 0}, "parameter ~port"), ({"port": 65536}, "parameter ~port")):
        with pytest.raises(ServoError, match=why):
            dashboard.split_parameters(given)
    assert dashboard.split_parameters({})[0].port == 8080
    assert dashboard.split_parameters({"port": 65535})[0].port == 65535
    rospy.set_param("~port", 0)
    assert dashboard.main() == 1 and "parameter ~port" in graph.lines[-1]

    class Missing:
        def find_spec(self, name, *_):
            if name.endswith("live.server"):
                raise ModuleNotFoundError(name="websockets")

    monkeypatch.delitem(sys.modules, "aras_visual_servo_bench.web.live.server", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    assert dashboard.main() == 1
    assert graph.lines[-1] == (
        "the live page needs websockets, which is not installed; run: ./setup.sh --for bench")
