"""Servo nodes: messages reach the loop, and requests are executed."""

import copy
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus
from aras_visual_servo_camera.msg import ImageMoments, KernelFeatures
from aras_visual_servo_controller.msg import ServoToTargetActionGoal, ServoToTargetGoal
from graph_helpers import until
from run_messages import ARM, JOINTS, SETTINGS, K, joint_states, made_state, position
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from aras_visual_servo_bench.experiment.robot_spec import RobotSpec
from aras_visual_servo_bench.experiment.robots import Robot
from aras_visual_servo_camera import node as camera_module
from aras_visual_servo_camera.camera_node import CameraNode
from aras_visual_servo_camera.errors import ImageError
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.parameters import VisionParameters
from aras_visual_servo_camera.segmentation_settings import SegmentationSettings
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.kinematics.joint_sample import JointSample
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.parameters import CameraEntry
from aras_visual_servo_controller.records.outcomes import make_outcome
from aras_visual_servo_controller.records.state import ImageSource
from aras_visual_servo_controller.ros import (
    controller_node,
    description,
    loop_services,
    node,
    node_settings,
)
from aras_visual_servo_controller.ros import goal_publishers as goal_topics
from aras_visual_servo_controller.ros import loop_subscribers as inputs
from aras_visual_servo_controller.ros.camera_subscribers import CameraSubscribers
from aras_visual_servo_controller.ros.command_publishers import stop_controller
from aras_visual_servo_controller.ros.depth_image import read_depth
from aras_visual_servo_controller.ros.detection_subscribers import DetectionSubscribers
from aras_visual_servo_controller.settings import ControllerSettings

SOURCES = Path(__file__).parents[3] / "src"
STAMP = rospy.Time(3, 250_000_000)
INFO = CameraInfo(width=64, height=48, K=K, D=[0.0] * 5, distortion_model="plumb_bob")
ENTRY = CameraEntry("eye", "/eye/camera", "/two/camera", "")
SQUARE = np.array([(-0.1, -0.1), (0.2, -0.1), (0.2, 0.15), (-0.1, 0.15)])


def observer(*needs, name="left", segmentation=None):
    return FeatureObserver(None, frozenset(needs), segmentation, name=name)


def moments(valid=True, stamp=STAMP, **more):
    m = Moments.from_polygon(SQUARE, 3)
    message = ImageMoments(valid=valid, order=3, m=m.m_array, mu=m.mu_array, width=64, height=48,
                           K=K, D=[0.0] * 5, distortion_model="plumb_bob", pixel_count=77, **more)
    message.header.stamp = stamp
    return message


def test_moments_reach_the_loop(graph, hear_with):
    eye = observer(Need.MOMENTS)
    driver = hear_with(eye)
    driver.joints = JointSample.from_values(3.25, JOINTS, position(3.25))
    DetectionSubscribers(ENTRY, driver, eye)
    source = ImageSource("features", "/two/camera/moments", "the camera node")
    assert driver.sources == {"left": source}
    assert set(graph.subscribers) == {"/two/camera/moments"}
    assert graph.heard["/two/camera/moments"] == (
        ImageMoments, {"queue_size": 1, "tcp_nodelay": True})
    hear = graph.subscribers["/two/camera/moments"]
    hear(moments(touches_border=True))
    (stamp, seen, name), = driver.images
    assert (stamp, seen.stamp, name, seen.valid, seen.reason) == (3.25, 3.25, "left", True, "")
    assert (seen.camera.width, seen.camera.K) == (64, K) and seen.joints is driver.joints
    assert (seen.kernel, seen.pixel_count, seen.touched_borders) == (None, 77, ("border",))
    np.testing.assert_allclose(seen.moments.m_array, Moments.from_polygon(SQUARE, 3).m_array)
    for message, why in ((moments(valid=False, reason="dark"), "dark"),
                         (moments(valid=False), "the target is not visible")):
        hear(message)
        seen = driver.images[-1][1]
        assert (seen.moments, seen.valid, seen.reason, seen.touched_borders) == (
            None, False, why, ())
    broken = moments()
    broken.m = broken.m[:4]
    hear(broken)
    seen = driver.images[-1][1]
    assert not seen.valid and "unusable moments" in seen.reason
    blind = moments()
    blind.K = [0.0] * 9
    hear(blind)
    seen = driver.images[-1][1]
    assert not seen.valid and seen.reason and seen.camera.width == 1


def test_a_camera_node_in_the_same_process_passes_on_its_moments_itself(graph, hear_with):
    """Without features, the message names what sends the images; the camera node does run."""
    eye = observer(Need.MOMENTS)
    driver, camera = hear_with(eye), CameraNode(VisionParameters())
    entry = CameraEntry("eye", "/eye/camera", "/aras_visual_servo/camera", "")
    before = set(graph.subscribers)
    DetectionSubscribers(entry, driver, eye, camera)
    assert set(graph.subscribers) == before
    assert driver.sources["left"].describe_silence() == (
        "no features on /aras_visual_servo/camera/moments (is the simulator or camera's driver "
        "running?)")
    camera.on_moments(moments())
    assert [(stamp, name) for stamp, _, name in driver.images] == [(3.25, "left")]
    other = hear_with(eye)
    DetectionSubscribers(ENTRY, other, eye, camera)  # another camera's features
    assert other.sources["left"].sender == "the camera node"
    assert set(graph.subscribers) - before == {"/two/camera/moments"}


def test_moments_wait_for_their_kernel_features(graph, hear_with):
    eye = observer(Need.KERNEL, Need.MOMENTS)
    driver = hear_with(eye)
    DetectionSubscribers(ENTRY, driver, eye)
    assert driver.sources["left"] == ImageSource("features", "/two/camera/kernel",
                                                 "the camera node")
    hear, kernel = (graph.subscribers[f"/two/camera/{name}"] for name in ("moments", "kernel"))
    assert graph.heard["/two/camera/kernel"][0] is KernelFeatures
    numbers = KernelFeatures(data=np.arange(20.0))
    numbers.header.stamp = STAMP
    hear(moments())
    assert not driver.images
    kernel(numbers)
    seen = driver.images[-1][1]
    assert seen.valid and not seen.reason and list(seen.kernel) == list(range(20))
    later = rospy.Time(4)
    kernel(KernelFeatures(header=rospy.Header(stamp=later), reason="too small"))
    hear(moments(stamp=later))
    stamp, seen, _ = driver.images[-1]
    assert (stamp, seen.valid, seen.reason) == (4.0, False, "too small")
    hear(moments(valid=False, stamp=rospy.Time(5)))  # of which there are none
    assert driver.images[-1][0] == 5.0 and len(driver.images) == 3


def picture(encoding="mono8", stamp=STAMP, value=7, **more):
    data = np.full((48, 64), value, {"mono8": "u1", "16UC1": "<u2", "32FC1": "<f4"}[encoding])
    message = Image(height=48, width=64, step=data.strides[0], encoding=encoding,
                    data=data.tobytes(), **more)
    message.header.stamp = stamp
    return message


def test_pictures_reach_the_loop_with_their_depth(graph, hear_with):
    eye = observer(Need.IMAGE, Need.DEPTH)
    driver = hear_with(eye)
    driver.joints = JointSample.from_values(3.25, JOINTS, position(3.25))
    heard = CameraSubscribers(ENTRY, driver, eye)
    topics = [f"/eye/camera/{name}" for name in ("camera_info", "image_raw", "depth/image_raw")]
    assert list(graph.subscribers) == topics and len(heard.subscribers) == 3
    assert driver.sources["left"] == ImageSource("image", topics[1],
                                                 "the simulator or camera's driver")
    plain = {"queue_size": 1, "tcp_nodelay": True}
    assert [graph.heard[t] for t in topics] == [
        (CameraInfo, plain), *[(Image, {**plain, "buff_size": 2**24})] * 2]
    info, image, depth = (graph.subscribers[topic] for topic in topics)
    image(picture(stamp=rospy.Time(1)))
    assert not graph.lines
    image(picture())
    assert graph.lines == ["images wait for their camera_info"] and graph.periods == [5.0]
    depth(picture("16UC1", value=1250))
    bad = CameraInfo(width=64, height=48, K=[0.0] * 9)
    info(bad)
    assert graph.lines[-1].startswith("camera_info cannot be used: ") and not driver.images
    info(INFO)
    (stamp, seen, name), = driver.images
    assert (stamp, seen.stamp, name) == (3.25, 3.25, "left") and seen.joints is driver.joints
    assert seen.camera.K == K and seen.depth.shape == (48, 64) and seen.depth.dtype == np.float32
    np.testing.assert_allclose(seen.depth, 1.25, rtol=1e-6)
    assert (seen.image == 7).all()
    info(INFO)
    depth(picture("32FC1", rospy.Time(5), 0.5))
    assert len(driver.images) == 1
    image(picture(stamp=rospy.Time(5)))
    np.testing.assert_allclose(driver.images[-1][1].depth, 0.5)
    depth(picture("mono8", rospy.Time(6)))
    image(picture(stamp=rospy.Time(6)))
    assert graph.lines[-1].startswith("image skipped: the depth image has the encoding 'mono8'")
    assert len(driver.images) == 2
    info(bad)  # and images wait again
    image(picture(stamp=rospy.Time(7)))
    assert len(driver.images) == 2 and set(graph.periods) == {5.0}


def test_pictures_without_depth_and_with_labels(graph, hear_with):
    segmentation = SegmentationSettings(method="label", label="box")
    for needs, count in (({Need.IMAGE}, 2), ({Need.CONTOUR}, 4)):
        eye = observer(*needs, segmentation=segmentation)
        driver = hear_with(eye)
        assert len(CameraSubscribers(ENTRY, driver, eye).subscribers) == count
        graph.subscribers["/eye/camera/camera_info"](INFO)
        graph.subscribers["/eye/camera/image_raw"](picture())
        assert len(driver.images) == (count == 2)
    graph.subscribers["/eye/camera/segmentation/labels"](String("{3: 'box::link', 4: other}"))
    labels = np.full((48, 64), 4, np.int32)
    labels[10:30, 20:50] = 3
    message = Image(height=48, width=64, step=256, encoding="32SC1", data=labels.tobytes())
    message.header.stamp = STAMP
    graph.subscribers["/eye/camera/segmentation/image_raw"](message)
    seen = driver.images[-1][1]
    assert seen.valid and seen.depth is None and seen.pixel_count == 600


def test_depth_images_of_either_kind_and_order():
    message = Image(height=2, width=3, step=8, encoding="16UC1", is_bigendian=1)
    rows = np.zeros((2, 4), ">u2")
    rows[:, :3] = [[1000, 2000, 3000], [400, 500, 65535]]
    message.data = rows.tobytes() + b"more"
    np.testing.assert_allclose(read_depth(message), [[1, 2, 3], [0.4, 0.5, 65.535]], rtol=1e-6)
    message.data = message.data[:15]
    with pytest.raises(ImageError, match="is too short: it has 15 bytes"):
        read_depth(message)
    message.data, message.step = 16 * b"0", 5
    with pytest.raises(ImageError, match="too short"):
        read_depth(message)
    message.encoding = "mono8"
    with pytest.raises(ImageError, match="encoding 'mono8'; use one of 32FC1, 16UC1"):
        read_depth(message)


@pytest.mark.parametrize("lockstep", [False, True])
def test_joints_images_and_the_emergency_stop_are_heard(graph, hear_with, lockstep):
    driver = hear_with(observer(Need.MOMENTS, name="a"), observer(Need.CONTOUR, name="b"))
    cameras = {"a": {"features": "/fa"}, "b": {"namespace": "/nb"}}
    settings = ControllerSettings.from_mapping(
        {"namespace": "/two/", "cameras": cameras, "lockstep": lockstep})
    heard = inputs.LoopSubscribers(settings, driver, "/stop")
    assert set(graph.subscribers) == {"/two/joint_states", "/fa/moments", "/nb/camera_info",
                                      "/nb/image_raw", "/stop"}
    assert graph.heard["/two/joint_states"] == (
        JointState, {"tcp_nodelay": True, "queue_size": 10 if lockstep else 1})
    message = joint_states(1.5)
    graph.subscribers["/two/joint_states"](message)
    assert driver.told == [(message.name, message.position, message.velocity, 1.5)]
    assert graph.heard["/stop"][0] is Bool
    for pressed in (True, False):
        graph.subscribers["/stop"](Bool(pressed))
    assert driver.stops == [True, False]
    heard.close()
    assert not graph.subscribers
    inputs.LoopSubscribers(settings, driver)
    assert "/stop" not in graph.subscribers


def test_a_description_is_looked_for_now_and_then(graph, life, monkeypatch):
    watch = description.DescriptionWatch("robo")
    assert watch.find_new(None) == "" and watch.find_new(None) == ""
    assert graph.lines == ["waiting: no robot description on parameter robo yet"]
    graph.parameters["/robo"] = ARM
    life.now += 0.19
    assert watch.find_new(None) == ""
    life.now += 0.01001
    assert watch.find_new(None) == ARM
    life.now += 1.0
    assert watch.find_new(0) == ""  # nothing has begun since
    graph.parameters["/robo"] = "<another/>"
    assert watch.find_new(0) == ""
    assert watch.find_new(1) == "<another/>"
    life.now += 1.0
    assert watch.find_new(1) == "" and watch.find_new(1) == ""
    life.now += 1.0
    graph.parameters["/robo"] = ARM
    assert watch.find_new(1) == ""  # looked at for this beginning
    assert watch.find_new(2) == ARM

    def gone(*_):
        raise OSError

    monkeypatch.setattr(rospy, "get_param", gone)
    life.now += 1.0
    assert watch.find_new(3) == ""


@pytest.mark.parametrize(("text", "topic"), [
    ("/halt", "/halt"), (" halt\n", "/two/halt"), ("", ""), (None, "")])
def test_the_emergency_stop_s_topic(text, topic):
    plugin = "" if text is None else f"<plugin><eStopTopic>{text}</eStopTopic></plugin>"
    urdf = f"<robot><gazebo>{plugin}</gazebo></robot>"
    assert description.find_e_stop_topic(urdf, "/two/") == topic


def test_the_node_s_parameters_are_checked_before_anything_begins(graph, life):
    rospy.set_param("~scheme", "points")
    rospy.set_param("~gains/gain", 7.0)
    settings, mapping = node_settings.read_node_settings()
    assert mapping == {"scheme": "points", "lockstep": False}
    assert settings.scheme == "points" and not settings.lockstep
    assert (settings.package / "config" / "starts.yaml").is_file()
    graph.parameters["/gazebo/speed_mode"] = "lockstep"
    assert node_settings.read_node_settings()[0].lockstep
    rospy.set_param("~lockstep", False)
    assert not node_settings.read_node_settings()[0].lockstep
    rospy.set_param("~desired", "missing.yaml")
    with pytest.raises(ConfigurationError, match=r"missing\.yaml"):
        node_settings.read_node_settings()
    rospy.set_param("~desired", "auto")
    rospy.set_param("~scheme", "pints")
    with pytest.raises(ConfigurationError, match="pints"):
        node_settings.read_node_settings()
    with pytest.raises(ConfigurationError, match="no robot description on parameter robo: start"):
        node_settings.read_robot_settings({"description": "robo"})
    graph.parameters["/robo"] = ARM
    settings, arm = node_settings.read_robot_settings({"description": "robo", "gain": 3.5})
    assert arm.names == JOINTS and settings.gain == 3.5


def test_a_goal_is_announced(graph):
    topics = goal_topics.GoalPublishers("/two")
    assert {t: (told[1:]) for t, told in graph.told().items()} == {
        "/two/controller/goal": (1, True), "/two/controller/desired_outline": (1, True)}
    arm = copy.copy(Robot(RobotSpec()).make_arm())  # all tests of a process share the original
    servo = ControllerSettings.from_mapping({}, SOURCES
                                            / "aras_visual_servo_controller").make_servo(arm)
    topics.publish(servo)
    told, = graph.publishers["/two/controller/goal"].sent
    assert told.header.frame_id == arm.base_frame and not graph.lines
    place, turn, pose = told.pose.position, told.pose.orientation, servo.differential_ik.goal
    np.testing.assert_allclose((place.x, place.y, place.z), pose[:3, 3])
    turned = Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).as_matrix()
    np.testing.assert_allclose(turned, pose[:3, :3], atol=1e-9)
    outline, = graph.publishers["/two/controller/desired_outline"].sent
    assert outline.header.frame_id == "camera_optical_frame"
    points = [(p.x, p.y, p.z) for p in outline.polygon.points]
    expected = [(*row, 1.0) for row in servo.goal.compute_outline()]
    np.testing.assert_allclose(points, expected, atol=1e-7)
    arm.target_frame, servo.unreachable_reason = "hand", "too far"
    topics.publish(servo)
    assert graph.publishers["/two/controller/goal"].sent[-1].header.frame_id == "hand"
    assert graph.lines == ["too far; the arm goes as near as it can"]
    servo.differential_ik.goal = None
    topics.publish(servo)
    assert len(graph.publishers["/two/controller/goal"].sent) == 2
    assert len(graph.publishers["/two/controller/desired_outline"].sent) == 3


def test_a_controller_is_stopped_where_there_is_one(graph, life):
    assert stop_controller("/two") is False
    asked = []
    rospy.Service("/two/controller/stop", Trigger, lambda _: asked.append(1) or (
        Trigger._response_class(True, "")))
    assert stop_controller("/two") is True and asked == [1]
    assert life.waited == [("/two/controller/stop", 0.5)] * 2


@pytest.fixture
def end_threads(monkeypatch):
    """End the node, and wait for the threads that it has started."""
    before = set(threading.enumerate())
    yield
    monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
    for thread in set(threading.enumerate()) - before:
        if thread.name != "signals":  # which ends with the process
            thread.join(10.0)
            assert not thread.is_alive()


@pytest.fixture
def served(graph, start, face, hear_with, end_threads):
    """Controller node with a loop of the ARAS arm, whose services and action are offered."""
    owner = controller_node.ControllerNode(SETTINGS, {})
    owner.runner, owner.publisher = hear_with(observer(Need.MOMENTS)), face
    owner.runner.stop("not started")
    loop_services.LoopServices("/two", owner)
    return owner


class Client:
    def __init__(self, graph):
        self.graph = graph

    def send(self, key, timeout=0.0):
        self.graph.subscribers["/two/servo_to_target/goal"](ServoToTargetActionGoal(
            goal_id=GoalID(id=key), goal=ServoToTargetGoal(timeout=timeout)))

    def cancel(self, key):
        self.graph.subscribers["/two/servo_to_target/cancel"](GoalID(id=key))

    def feedback(self):
        return self.graph.publishers["/two/servo_to_target/feedback"].sent

    def result(self, key):
        ended = self.graph.publishers["/two/servo_to_target/result"].sent
        it, = until(lambda: [one for one in ended if one.status.goal_id.id == key])
        return it.status.status, it.result


@pytest.fixture
def client(graph, served):
    return Client(graph)


def test_services_and_status_of_the_loop(graph, served, hear_with):
    for name, phase in (("start", "waiting"), ("hold", "holding"), ("stop", "stopped")):
        answer = graph.call(f"/two/controller/{name}")
        assert answer.success and answer.message == f"{name}: {phase}"
        assert graph.types[f"/two/controller/{name}"] is Trigger
        assert served.runner.servo.phase == phase
    served.runner = hear_with(observer(Need.MOMENTS))  # of another robot
    served.runner.stop()
    assert graph.call("/two/controller/start").message == "start: waiting"
    status = graph.publishers["/two/servo_to_target/status"]
    for _ in range(2):  # while the clock stands still
        status.sent.clear()
        until(lambda: status.sent)
    status.unregister()
    time.sleep(0.3)
    assert "status" in [thread.name for thread in threading.enumerate()]


def test_an_action_succeeds_when_the_loop_has_converged(served, client):
    served.publisher.report(made_state(0.5, "converged"))  # of before
    client.send("a")
    until(lambda: served.runner.servo.phase != "stopped")
    state = made_state(1.0)
    served.publisher.report(state)
    until(client.feedback)
    served.publisher.report(made_state(2.0, "converged", outcome="converged"))
    status, result = client.result("a")
    assert (status, result.outcome, result.reason) == (GoalStatus.SUCCEEDED, "converged", "slow")
    last = made_state(2.0).scheme_output
    assert list(result.feature_names) == list(last.names)
    np.testing.assert_allclose(result.error, last.error)
    first = client.feedback()[0].feedback
    assert (first.phase, first.outcome, first.rank) == ("servoing", "running", 2)
    np.testing.assert_allclose(first.error, state.scheme_output.error)
    np.testing.assert_allclose(first.margins, state.ik_solution.margins)
    assert list(first.feature_names) == list(state.scheme_output.names)


def test_an_action_ends_as_the_loop_or_somebody_wants(served, client):
    servo = served.runner.servo
    client.send("cancelled")
    until(lambda: servo.phase != "stopped")
    client.cancel("cancelled")
    status, result = client.result("cancelled")
    assert (status, result.outcome, result.reason, result.remedy) == (
        GoalStatus.PREEMPTED, "stopped", "preempted", "")
    assert list(result.feature_names) == [] and servo.phase == "stopped"
    client.send("stopped")
    until(lambda: servo.phase != "stopped")
    served.runner.stop("by hand")
    status, result = client.result("stopped")
    assert (status, result.outcome, result.reason) == (
        GoalStatus.ABORTED, servo.outcome.kind, "by hand")
    assert not client.feedback()


@pytest.mark.parametrize("known", [False, True])
def test_an_action_has_its_time(graph, served, client, known):
    servo = served.runner.servo
    client.send("a", 0.2)
    until(lambda: servo.phase != "stopped")
    found = make_outcome("too_few_images", "a gap")
    if known:
        served.runner.apply_change(lambda loop: loop.hold("a gap", found))
    time.sleep(0.2)
    graph.wall_time += 0.19
    time.sleep(0.2)
    assert servo.phase != "stopped"
    graph.wall_time += 0.02
    status, result = client.result("a")
    expected = (("too_few_images", "a gap", found.remedy) if known else
                ("timed_out", "not converged within 0.2 s", ""))
    assert (status, result.outcome, result.reason, result.remedy) == (GoalStatus.ABORTED, *expected)
    assert (servo.phase, servo.reason) == ("stopped", "the timeout of the action goal has expired")


def test_the_controller_is_built_for_the_robot_and_anew_for_another(graph, life, end_threads):
    urdf = Robot(RobotSpec()).urdf
    stop = "<gazebo><plugin><eStopTopic>halt</eStopTopic></plugin></gazebo></robot>"
    urdf = urdf.replace("</robot>", stop)
    for key, value in {"namespace": "/two/", "command_topic": "both", "start": "none",
                       "output": "velocity"}.items():
        rospy.set_param(f"~{key}", value)
    graph.parameters["/robot_description"] = ""

    def appear():
        graph.parameters["/robot_description"] = urdf
        life.now += 1.0

    def heard():
        assert "/two/joint_states" in graph.subscribers and "/two/halt" in graph.subscribers
        assert "/unnamed/gains/set_parameters" in graph.services
        found.update(first=graph.publishers["/two/both"], services=dict(graph.services))

    def another():
        graph.parameters["/robot_description"] = urdf + " "
        names = Robot(RobotSpec()).make_arm().names
        message = JointState(name=list(names), position=[0.0] * 6)
        message.header.stamp = rospy.Time(11)
        graph.subscribers["/two/joint_states"](message)
        life.now += 1.0

    found = {}
    life.steps = [appear, heard, another, lambda: None, lambda: None]
    assert node.main() == 0
    assert life.begun == [("aras_visual_servo_controller", {"disable_signals": True})]
    assert graph.services == found["services"]
    assert len([line for line in graph.lines if line.startswith("scheme moments, start none")]) == 2
    assert "camera_optical_frame is moved by the joints gantry, J1" in "".join(graph.lines)
    assert found["first"].impl is None
    assert 0.02 in life.slept and len(graph.publishers["/two/controller/goal"].sent) == 2
    close, = life.ending
    close()
    assert graph.publishers["/two/both"].sent[-1].data == [0.0] * 6
    assert graph.call("/two/controller/stop").message == "stop: stopped"
    assert "/two/halt" not in graph.subscribers


@pytest.fixture
def camera(graph, life):
    it = camera_module.CameraNode(VisionParameters.from_mapping({"log_period": 2.0}))
    it.graph, it.life = graph, life
    it.hear = lambda name, message: graph.subscribers[f"/labrob/camera/{name}"](message)
    return it


def dark_square(stamp=STAMP):
    pixels = np.full((48, 64), 255, np.uint8)
    pixels[10:30, 20:40] = 0
    message = picture(stamp=stamp)
    message.data = pixels.tobytes()
    return message


def told(graph):
    return next(p for t, p in graph.publishers.items() if t.endswith("camera/moments")).sent


def test_the_camera_node_measures_what_it_hears(camera, graph):
    options = {"queue_size": 1, "tcp_nodelay": True, "buff_size": 2**24}
    assert graph.heard["/labrob/camera/camera_info"] == (CameraInfo, options)
    assert graph.heard["/labrob/camera/image_raw"] == (Image, options)
    camera.hear("image_raw", dark_square())
    assert not told(graph)[-1].valid
    assert "no camera_info on /labrob/camera/camera_info yet" in told(graph)[-1].reason
    camera.hear("camera_info", INFO)
    camera.hear("image_raw", dark_square())
    assert told(graph)[-1].valid and told(graph)[-1].pixel_count == 400
    assert told(graph)[-1].header.stamp == STAMP
    before, broken = len(told(graph)), dark_square()
    broken.encoding = "none"
    for wait in (0.0, 1.75, 0.25):  # said again after two seconds
        camera.life.now += wait
        camera.hear("image_raw", broken)
    assert len(told(graph)) == before
    skipped = [line for line in graph.lines if line.startswith("image skipped: ")]
    assert len(skipped) == 2
    camera.hear("camera_info", CameraInfo(width=64, height=48, K=[0.0] * 9))
    camera.hear("image_raw", dark_square())
    assert not told(graph)[-1].valid and "yet" not in told(graph)[-1].reason


def test_a_clock_that_goes_back_begins_the_pipeline_anew(graph, life):
    """Of two targets the one that is nearest to that of the image before, or else the larger."""
    camera_module.CameraNode(VisionParameters.from_mapping({"component": "nearest"}))
    graph.subscribers["/labrob/camera/camera_info"](INFO)
    small, both = np.full((2, 48, 64), 255, np.uint8)
    small[10:20, 5:15] = both[10:20, 5:15] = both[10:30, 35:55] = 0
    for stamp, pixels, count in ((3.0, small, 100), (3.0, both, 100), (4.0, both, 100),
                                 (2.0, both, 400), (3.0, both, 400)):  # fmt: skip
        message = picture(stamp=rospy.Time.from_sec(stamp))
        message.data = pixels.tobytes()
        graph.subscribers["/labrob/camera/image_raw"](message)
        assert told(graph)[-1].pixel_count == count


def test_the_camera_node_says_what_it_waits_for(camera, graph, life):
    life.steps = [lambda s=s: setattr(life, "now", life.now + s) for s in (1.7, 0.3, 0.0)]
    camera.spin()
    assert graph.lines == ["waiting for images on /labrob/camera/image_raw"]
    assert set(life.slept) == {0.2}


def test_the_camera_node_s_main(graph, life):
    assert camera_module.main() == 0
    assert life.begun == [
        ("aras_visual_servo_camera", {"disable_signals": True, "disable_rostime": True})]
    assert graph.lines[0].startswith("camera node ready, layout '")
    rospy.set_param("~segmentation", "label")
    rospy.set_param("~label", "box")
    life.down, life.now = False, life.now + 6.0
    life.steps = [lambda: setattr(life, "now", life.now + 6.0), lambda: None]
    camera_module.main()
    assert graph.lines[-1].endswith("image_raw and /labrob/camera/segmentation/image_raw")
    rospy.set_param("~segmentation", "lable")
    assert camera_module.main() == 1 and "lable" in graph.lines[-1]
