"""Topics, settings and service of a camera; only images with subscribers are rendered."""

import math
from collections.abc import Callable
from threading import Event, Thread
from threading import enumerate as enumerate_threads
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rospy
import yaml
from dynamic_reconfigure import msg as reconfigure
from dynamic_reconfigure.msg import StrParameter as Text
from dynamic_reconfigure.srv import Reconfigure
from gazebo_msgs.srv import SpawnModelRequest
from genpy import Time
from graph_helpers import messages, until
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Empty, String
from tf2_msgs.msg import TFMessage

from aras_sim_bridge.camera import CameraConfig, CameraReading
from aras_sim_bridge.description import DepthDescription, parse_urdf
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.ros.camera import compressed, frame_broadcaster, settings
from aras_sim_bridge.ros.camera.image_topics import PointsTopic
from aras_sim_bridge.ros.camera.info import add_prefix, find_calibration_path
from aras_sim_bridge.ros.camera.topics import CameraTopics
from aras_sim_bridge.ros.runtime.device_interfaces import DeviceInterfaces

MS = 1_000_000

SETTINGS = {
    "parent": "world", "pose": [1.0, 2.0, 3.0, 0.0, 0.0, math.pi / 2], "width": 8, "height": 6,
    "update_rate": 100.0, "camera_matrix": [5.0, 6.0, 3.0, 2.0], "distortion_model": "plumb_bob",
    "distortion_coefficients": [0.01, 0.02, 0.03, 0.04, 0.05], "depth": True, "segmentation": True,
    "effects": {
        "row_time": 1e-6, "exposure_time": 2e-3, "exposure_samples": 1,
        "sensor": {"gain": 0.02, "full_well": 12e3, "read_noise": 7.0, "dark_current": 30.0}}}
SETTINGS_OF_A_PRESET = {k: v for k, v in SETTINGS.items() if k not in ("parent", "pose")}
DEFAULTS = {field.name: field.default for field in compressed.COMPRESSED_FIELDS}


@pytest.fixture(autouse=True)
def nothing_announced(graph):
    yield
    frame_broadcaster.close()
    assert "/tf_static" not in graph.publishers


@pytest.fixture
def eye(graph, thread, tmp_path, monkeypatch):
    """Camera fixed in the world, on the graph below /eye; `calls` counts its updates."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    thread.call(lambda: thread.simulation.add_camera("eye", SETTINGS))
    (mounted,) = thread.simulation.cameras
    it = SimpleNamespace(graph=graph, thread=thread, mounted=mounted, home=tmp_path, rounds=0)

    def begins() -> None:
        it.rounds += 1

    it.topics = CameraTopics(mounted, thread, begins)
    it.step = lambda count=1: thread.step(count, 120.0)
    it.step()
    yield it
    it.topics.shutdown()
    it.step()


def test_nothing_is_drawn_while_nobody_listens(eye):
    sensor = eye.mounted.sensor
    assert not eye.mounted.enabled
    for topic, wanted in (
        ("/eye/image_raw", (True, False, False)), ("/eye/camera_info", (True, False, False)),
        ("/eye/image_raw/compressed", (True, False, False)),
        ("/eye/depth/image_raw", (True, True, False)),
        ("/eye/depth/camera_info", (True, False, False)),
        ("/eye/segmentation/image_raw", (True, False, True)),
        ("/eye/segmentation/labels", (True, False, False))):
        for count in (1, 0):
            eye.graph.listen(topic, count)
            eye.thread.call(lambda: None)
            found = eye.mounted.enabled, sensor.depth, sensor.segmentation
            assert found == (wanted if count else (False, False, False)), topic


def test_image_and_info_of_one_instant(eye):
    (image,) = eye.graph.listen("/eye/image_raw")
    (info,) = eye.graph.listen("/eye/camera_info")
    (depth,) = eye.graph.listen("/eye/depth/image_raw")
    (depth_info,) = eye.graph.listen("/eye/depth/camera_info")
    (labels,) = eye.graph.listen("/eye/segmentation/image_raw")
    (names,) = eye.graph.listen("/eye/segmentation/labels")
    eye.step(20)
    pictures, infos = messages(image, Image), messages(info, CameraInfo)
    assert [m.header.stamp.to_nsec() for m in pictures] == [10_000_000, 20_000_000]
    assert [m.header.seq for m in pictures] == [1, 2]
    assert [m.header.stamp for m in infos] == [m.header.stamp for m in pictures]
    assert eye.rounds == 2
    first = pictures[0]
    assert (first.width, first.height, first.step, first.encoding) == (8, 6, 24, "rgb8")
    assert len(first.data) == 8 * 6 * 3 and first.is_bigendian == 0
    assert first.header.frame_id == infos[0].header.frame_id == "eye_optical_frame"
    assert infos[0].K == (5, 0, 3, 0, 6, 2, 0, 0, 1) and infos[0].P[:4] == (5, 0, 3, 0)
    assert infos[0].R == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    assert (infos[0].width, infos[0].height) == (8, 6)
    assert infos[0].D == (0.01, 0.02, 0.03, 0.04, 0.05)
    assert infos[0].distortion_model == "plumb_bob"
    far, near = messages(depth, Image), messages(depth_info, CameraInfo)
    assert far[0].encoding == "32FC1" and far[0].step == 32
    assert near[0].header.stamp == far[0].header.stamp == first.header.stamp
    numbers = messages(labels, Image)
    assert numbers[0].encoding == "32SC1"
    (told,) = messages(names, String)
    named = yaml.safe_load(told.data)
    seen = np.frombuffer(numbers[0].data, np.int32)
    assert {named[n] for n in np.unique(seen[seen >= 0]).tolist()} == {"ground_plane::link"}


@pytest.mark.parametrize(("given", "at"), [("", "/a/eye"), ("/", ""), ("/b/", "/b")])
def test_topics_are_gazebo_s(graph, thread, given, at):
    names = {"image": f"{given}far/image", "info": f"{given}far/info",
             "points": f"{given}far/points"}
    given = {**SETTINGS, "camera_name": "a/eye", "image_topic": f"{given}picture",
             "info_topic": f"{given}lens", "trigger_topic": f"{given}go",
             "depth_topics": {**names, "millimetres": True}}
    thread.call(lambda: thread.simulation.add_camera("eye", given))
    on_graph = CameraTopics(thread.simulation.cameras[0], thread)
    settings_topics = {f"{place}/parameter_{what}": (kind, 10, True)
                       for place in ("/a/eye", f"{at}/picture/compressed")
                       for what, kind in (("descriptions", reconfigure.ConfigDescription),
                                          ("updates", reconfigure.Config))}
    assert graph.told() == settings_topics | {
        "/tf_static": (TFMessage, 10, True),
        f"{at}/picture": (Image, 2, True), f"{at}/lens": (CameraInfo, 2, False),
        f"{at}/picture/compressed": (CompressedImage, 30, True),
        f"{at}/far/image": (Image, 2, True), f"{at}/far/info": (CameraInfo, 2, False),
        f"{at}/far/points": (PointCloud2, 1, False),
        "/a/eye/segmentation/image_raw": (Image, 2, True),
        "/a/eye/segmentation/labels": (String, 2, True), "/a/eye/sensor_info": (String, 1, True)}
    no_delay = [one.options.get("tcp_nodelay") for one in graph.publishers.values()
                if one.kind in (Image, CompressedImage, CameraInfo, PointCloud2)]
    assert no_delay == 7 * [True]
    assert graph.heard == {f"{at}/go": (Empty, {"queue_size": 10})}
    assert graph.types == {
        "/a/eye/set_camera_info": SetCameraInfo, "/a/eye/set_parameters": Reconfigure,
        f"{at}/picture/compressed/set_parameters": Reconfigure}
    (depth,) = graph.listen(f"{at}/far/image")
    (points,) = graph.listen(f"{at}/far/points")
    thread.step(20, 120.0)
    assert not messages(depth, Image)  # it exposes when it is told to
    graph.subscribers[f"{at}/go"](Empty())
    thread.step(3, 120.0)
    (picture,) = messages(depth, Image)
    assert (picture.encoding, picture.step) == ("16UC1", 16)
    (cloud,) = messages(points, PointCloud2)
    assert (cloud.header.stamp, cloud.header.frame_id) == (
        picture.header.stamp, picture.header.frame_id)
    assert 20_000_000 <= picture.header.stamp.to_nsec() <= 23_000_000
    on_graph.shutdown()
    thread.call(lambda: None)
    (mounted,) = thread.simulation.cameras
    assert not mounted.enabled and mounted.on_frame is None
    assert set(graph.publishers) == {"/tf_static"} and not graph.subscribers | graph.services


@pytest.mark.parametrize(("rows", "encoding", "hole"), [
    (True, "rgb8", False), (False, "bgr8", True), (True, "bgr8", False)])
def test_a_cloud_is_its_depths_along_the_pixels_rays_in_their_colours(graph, rows, encoding, hole):
    random = np.random.default_rng(2)
    rays, depth = random.random((3, 5, 3), np.float32), 1.0 + random.random((3, 5), np.float32)
    image = random.integers(0, 255, (3, 5, 3), np.uint8)
    if hole:
        depth[1, 2] = np.inf
    topic = PointsTopic("/points", rays, DepthDescription(rows=rows, farthest=9.0), lambda: None)
    frame = CameraReading(5, image, encoding, depth=depth)
    topic.send(Time(3, 4), "lens", frame)  # nobody listens
    (listener,) = graph.listen("/points")
    topic.send(Time(3, 4), "lens", frame)
    (cloud,) = messages(listener, PointCloud2)
    assert (cloud.header.stamp, cloud.header.frame_id) == (Time(3, 4), "lens")
    assert (cloud.height, cloud.width) == ((3, 5) if rows else (1, 15))
    assert (cloud.point_step, cloud.row_step) == (32, 32 * cloud.width)
    assert cloud.is_dense is not hole and not cloud.is_bigendian
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        ("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 16, 7, 1)]
    points = np.frombuffer(cloud.data, np.float32).reshape(15, 8)
    expected = (rays * np.where(np.isinf(depth), np.nan, depth)[..., None]).reshape(15, 3)
    np.testing.assert_array_equal(points[:, :3], expected)
    colours = np.frombuffer(cloud.data, np.uint8).reshape(15, 32)[:, 16:20]
    bgr = image if encoding == "bgr8" else image[..., ::-1]
    np.testing.assert_array_equal(colours, np.pad(bgr.reshape(15, 3), ((0, 0), (0, 1))))


def test_a_calibration_is_published_and_kept_with_the_figures_of_the_sensor(eye):
    info = CameraInfo(width=8, height=6, distortion_model="plumb_bob", D=[1.0, 2.0])
    info.K, info.R, info.P = range(9), range(10, 19), range(20, 32)
    for _ in range(2):
        assert eye.graph.call("/eye/set_camera_info", info).success

    def matrix(rows: int, *values: float) -> dict:
        return {"rows": rows, "cols": len(values) // rows, "data": list(map(float, values))}

    kept = yaml.safe_load((eye.home / "camera_info" / "eye.yaml").read_text())
    assert list(kept)[:4] == ["image_width", "image_height", "camera_name", "camera_matrix"]
    assert list(kept["camera_matrix"]) == ["rows", "cols", "data"]
    assert kept == {
        "image_width": 8, "image_height": 6, "camera_name": "eye",
        "distortion_model": "plumb_bob", "distortion_coefficients": matrix(1, 1, 2),
        "camera_matrix": matrix(3, *range(9)), "rectification_matrix": matrix(3, *range(10, 19)),
        "projection_matrix": matrix(3, *range(20, 32))}
    (listener,) = eye.graph.listen("/eye/camera_info")
    eye.step(10)
    (told,) = messages(listener, CameraInfo)
    assert tuple(range(9)) == told.K and told.header.frame_id == "eye_optical_frame"
    kept = (eye.home / "camera_info" / "eye_sensor.yaml").read_text()
    told = eye.graph.publishers["/eye/sensor_info"].sent[-1]
    assert told.data == kept
    figures = yaml.safe_load(kept)
    assert list(figures) == ["effects"]
    assert figures["effects"]["sensor"] == SETTINGS["effects"]["sensor"]
    assert figures["effects"]["row_time"] == 1e-6
    again = CameraConfig.from_mapping({**SETTINGS_OF_A_PRESET, **figures})
    assert again.effects == eye.mounted.sensor.config.effects


def test_a_calibration_that_cannot_be_kept_is_published_all_the_same(eye):
    (eye.home / "camera_info").write_text("a file")
    info = CameraInfo(width=8)
    info.header.frame_id = "mine"
    answer = eye.graph.call("/eye/set_camera_info", info)
    assert not answer.success
    assert answer.status_message.startswith("Error storing camera calibration: ")
    (listener,) = eye.graph.listen("/eye/camera_info")
    eye.step(10)
    assert messages(listener, CameraInfo)[0].header.frame_id == "mine"


def test_where_calibrations_are_kept(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    assert find_calibration_path("a/b") == tmp_path / "camera_info" / "a" / "b.yaml"
    for name in ("", "..", "a/../../b", "/"):
        with pytest.raises(CameraError, match="cannot be used as a file name"):
            find_calibration_path(name)
    monkeypatch.setenv("ROS_HOME", "")
    monkeypatch.setenv("HOME", "/home/me")
    assert str(find_calibration_path("a")) == "/home/me/.ros/camera_info/a.yaml"


def test_a_name_of_its_own_gives_the_rate_s_settings(graph, thread):
    thread.call(lambda: thread.simulation.add_camera("eye", {**SETTINGS, "camera_name": "eye"}))
    (mounted,) = thread.simulation.cameras
    topics_of_eye = CameraTopics(mounted, thread)
    service = "/eye/set_parameters"
    config = reconfigure.Config(doubles=[reconfigure.DoubleParameter("imager_rate", 50.0)])
    graph.call(service, config)
    assert mounted.sensor.rate == 50.0
    config.doubles[0].value = 500.0
    graph.call(service, config)
    assert mounted.sensor.rate == 100.0  # the limit: as it was launched
    (described,) = graph.publishers["/eye/parameter_descriptions"].sent
    assert (described.min.doubles[0].value, described.max.doubles[0].value) == (1.0, 100.0)
    (parameter,) = described.groups[0].parameters
    assert (described.dflt.doubles[0].value, parameter.level) == (2.0, 3)
    topics_of_eye.shutdown()
    assert service not in graph.services
    thread.call(lambda: mounted.sensor.set_rate(0.5, 0, MS))
    CameraTopics(mounted, thread)
    (described,) = graph.publishers["/eye/parameter_descriptions"].sent
    assert (described.min.doubles[0].value, described.max.doubles[0].value) == (0.5, 50.0)


def test_frames_that_nobody_else_knows_are_told(graph, thread):
    given = {**SETTINGS, "optical_frame_name": "eye_optical"}
    graph.parameters["/tf_prefix"] = "here"
    thread.call(lambda: thread.simulation.add_camera("eye", given))
    (mounted,) = thread.simulation.cameras
    on_graph = CameraTopics(mounted, thread)
    ((frame,),) = (m.transforms for m in graph.publishers["/tf_static"].sent)
    assert (frame.header.frame_id, frame.child_frame_id) == ("here/world", "here/eye_optical")
    where, turned = frame.transform.translation, frame.transform.rotation
    assert (where.x, where.y, where.z) == (1.0, 2.0, 3.0)
    # Looking along the world's y: z forward, x right, y down.
    assert (turned.x, turned.y, turned.z, turned.w) == pytest.approx(
        (math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5)), abs=1e-12)
    (listener,) = graph.listen("/eye/image_raw")
    thread.step(20, 120.0)
    assert messages(listener, Image)[0].header.frame_id == "here/eye_optical"
    on_graph.shutdown()
    assert graph.publishers["/tf_static"].sent[-1].transforms == []


@pytest.mark.parametrize(("given", "found"), [
    ({}, "lens"), ({"/tf_prefix": "a"}, "a/lens"), ({"/x/tf_prefix": "/b/"}, "b/lens"),
    ({"/tf_prefix": "a", "/x/y/tf_prefix": "c"}, "c/lens"), ({"/z/tf_prefix": "d"}, "lens")])
def test_frames_are_below_the_nearest_prefix(graph, given, found):
    graph.parameters.update(given)
    assert add_prefix("/lens", "/x/y") == found


def test_settings_of_the_world_s_cameras(graph, thread):
    name = rospy.resolve_name("~cameras")
    assert settings.read_cameras() == {}
    graph.parameters[name] = 3
    assert settings.read_cameras() == {}
    assert "must be a mapping of camera names to settings" in graph.lines[-1]
    del graph.parameters[name]
    for key, value in SETTINGS.items():
        graph.parameters[f"{name}/good/{key}"] = value
        graph.parameters[f"{name}/bad/{key}"] = value
    graph.parameters[f"{name}/bad/width"] = -1
    settings.mount_world_cameras(thread)
    assert thread.limits == [60.0, 60.0]  # the first sets up the renderer
    assert [c.sensor.config.name for c in thread.simulation.cameras] == ["good"]
    assert f"{name}/bad is not simulated" in graph.lines[-1]
    new = parse_urdf(
        '<robot name="r"><link name="l"/><gazebo reference="l"><sensor type="camera" name="on">'
        "<camera/>"
        '<plugin name="p" filename="libgazebo_ros_camera.so"><cameraName>own</cameraName></plugin>'
        "</sensor></gazebo></robot>")
    settings.check_unused_names({"on": {}, "of": {"width": 3}, "own": {"width": 3}}, thread, new)
    told = (f"settings {name}/of belong to no camera; use the name of an existing camera: "
            "good, on, own")
    assert told in graph.lines[-1]
    assert not any("/own" in line for line in graph.lines)
    count = len(graph.lines)
    settings.check_unused_names({"of": {"width": 3}}, thread, new)
    without = parse_urdf('<robot name="r"><link name="l"/></robot>')
    settings.check_unused_names({"if": {"width": 3}}, thread, without)
    assert len(graph.lines) == count


NOISE = np.random.default_rng(1).integers(0, 255, (40, 24, 3), np.uint8)
WIDE = NOISE.astype(np.uint16) * 257
BGR = np.ascontiguousarray(NOISE[..., ::-1])
RED = np.full((4, 6, 3), (200, 0, 0), np.uint8)


@pytest.mark.parametrize(("image", "encoding", "kind", "text", "expected"), [
    (NOISE, "rgb8", "jpeg", "rgb8; jpeg compressed bgr8", BGR),
    (BGR, "bgr8", "png", "bgr8; png compressed bgr8", BGR),
    (NOISE, "rgb8", "png", "rgb8; png compressed bgr8", BGR),
    (WIDE, "rgb16", "jpeg", "rgb16; jpeg compressed bgr8", BGR),
    (WIDE, "rgb16", "png", "rgb16; png compressed bgr16", WIDE[..., ::-1]),
    (NOISE[..., 0], "mono8", "png", "mono8; png compressed ", NOISE[..., 0]),
    (WIDE[..., 0], "mono16", "jpeg", "mono16; jpeg compressed ", NOISE[..., 0])])
def test_pictures_are_compressed_as_image_transport_does(image, encoding, kind, text, expected):
    told, data = compressed.encode(image, encoding, {**DEFAULTS, "format": kind})
    assert told == text
    if kind == "png":
        back = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert back.dtype == expected.dtype and np.array_equal(back, expected)
    else:
        options = [cv2.IMWRITE_JPEG_QUALITY, 80]
        assert data == cv2.imencode(".jpg", expected, options)[1].tobytes()


@pytest.mark.parametrize(("settings", "option", "value"), [
    ({"jpeg_quality": 31}, cv2.IMWRITE_JPEG_QUALITY, 31),
    ({"jpeg_progressive": True}, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    ({"jpeg_optimize": True}, cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    ({"jpeg_restart_interval": 2}, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
    ({"format": "png"}, cv2.IMWRITE_PNG_COMPRESSION, 9),
    ({"format": "png", "png_level": 2}, cv2.IMWRITE_PNG_COMPRESSION, 2)])
def test_compression_follows_its_settings(settings, option, value):
    image = NOISE // 64  # few colours, so that levels of compression differ
    data = compressed.encode(image, "bgr8", {**DEFAULTS, **settings})[1]
    options = [option, value]
    if "jpeg_quality" not in settings and "format" not in settings:
        options += [cv2.IMWRITE_JPEG_QUALITY, 80]
    kind = settings.get("format", "jpg")
    assert data == cv2.imencode(f".{kind}", image, options)[1].tobytes()
    assert data != cv2.imencode(f".{kind}", image)[1].tobytes()


def test_settings_and_failure_of_compression(monkeypatch):
    limits = {field.name: (field.type, field.default, field.minimum, field.maximum)
              for field in compressed.COMPRESSED_FIELDS}
    assert limits == {
        "format": ("str", "jpeg", "", ""), "jpeg_quality": ("int", 80, 1, 100),
        "jpeg_progressive": ("bool", False, False, True),
        "jpeg_optimize": ("bool", False, False, True),
        "jpeg_restart_interval": ("int", 0, 0, 65535), "png_level": ("int", 9, 1, 9)}
    monkeypatch.setattr(cv2, "imencode", lambda *_: (False, None))
    with pytest.raises(CameraError, match=r"cannot write a \(4, 6, 3\) rgb8 image as jpeg"):
        compressed.encode(RED, "rgb8", DEFAULTS)


def served(graph):
    answer = graph.call("/c/image/compressed/set_parameters", reconfigure.Config()).config
    kinds = answer.strs, answer.ints, answer.bools, answer.doubles
    return {one.name: one.value for kind in kinds for one in kind}


def test_of_pictures_that_wait_for_the_encoder_the_newest_stay():
    go_on, begun, done = Event(), Event(), []

    def work(item: int) -> None:
        begun.set()
        assert go_on.wait(30.0)
        done.append(item)

    encoder = compressed.BackgroundWorker(work, 3, "encoder")
    encoder.put(0)
    assert begun.wait(30.0)
    for item in range(1, 8):
        encoder.put(item)
    go_on.set()
    until(lambda: done == [0, 5, 6, 7])
    go_on.clear()
    begun.clear()
    encoder.put(8)
    assert begun.wait(30.0)
    encoder.put(9)
    encoder.stop()
    go_on.set()
    until(lambda: all(thread.name != "encoder" for thread in enumerate_threads()))
    assert done == [0, 5, 6, 7, 8]


def test_the_encoder_ends_with_its_topic(graph):
    topic = compressed.CompressedTopic("/c/image", None)
    graph.publishers["/c/image/compressed"].unregister()  # as rospy does at the end
    topic.publish(Time(1, 2), "lens", CameraReading(0, RED, "rgb8"))
    until(lambda: all("compress /c" not in thread.name for thread in enumerate_threads()))


def test_a_compressed_topic_reads_its_parameters_and_sends(graph):
    place = "/c/image/compressed"
    for given, found, said in (
        ({"jpeg_quality": 7, "format": "gif", "png_level": "x", "jpeg_optimize": True,
          "jpeg_restart_interval": 70000},
         {"jpeg_quality": 7, "jpeg_optimize": True, "jpeg_restart_interval": 65535},
         ["format is invalid: 'gif'; using the default 'jpeg'",
          "png_level is invalid: 'x'; using the default 9"]),
        ({"jpeg_quality": [1], "format": "png", "png_level": 3}, {"format": "png", "png_level": 3},
         ["jpeg_quality is invalid: [1]; using the default 80"]),
    ):
        graph.parameters = {f"{place}/{name}": value for name, value in given.items()}
        graph.lines.clear()
        topic = compressed.CompressedTopic("/c/image", None)
        assert served(graph) == {**DEFAULTS, **found}
        assert graph.lines == [f"{place}/{line}" for line in said]
    topic.publish(Time(1, 2), "lens", CameraReading(0, RED, "rgb8"))
    sent = graph.publishers["/c/image/compressed"].sent
    until(lambda: sent)
    (message,) = sent
    assert isinstance(message, CompressedImage)
    assert (message.header.stamp, message.header.frame_id) == (Time(1, 2), "lens")
    assert message.format == "rgb8; png compressed bgr8" and message.data[1:4] == b"PNG"
    service = "/c/image/compressed/set_parameters"
    graph.call(service, reconfigure.Config(strs=[Text("format", "gif")],
                                           ints=[reconfigure.IntParameter("png_level", 9)]))
    assert served(graph)["format"] == "png"
    assert "neither jpeg nor png" in graph.lines[-1]
    graph.call(service, reconfigure.Config(strs=[Text("format", "jpeg")],
                               bools=[reconfigure.BoolParameter("jpeg_optimize", True)],
                               ints=[reconfigure.IntParameter("jpeg_quality", 500)]))
    assert served(graph)["jpeg_quality"] == 100
    topic.publish(Time(1, 3), "lens", CameraReading(0, np.zeros((0, 0)), "rgb8"))
    until(lambda: "image/compressed: " in graph.lines[-1])
    assert graph.periods == [5.0] and compressed.CompressedTopic.BACKLOG == 4
    topic.unregister()
    until(lambda: not graph.publishers and not graph.services)


def test_a_compressed_topic_does_not_go_while_it_sends(graph):
    """rospy's publish takes its publisher's inside again after sending."""
    topic = compressed.CompressedTopic("/c/image", None)
    publisher, begun, go_on, seen = (graph.publishers["/c/image/compressed"], Event(), Event(), [])

    def publish(message: object) -> None:
        begun.set()
        assert go_on.wait(30.0)
        seen.append(publisher.impl)

    publisher.publish = publish
    topic.publish(Time(1, 2), "lens", CameraReading(0, RED, "rgb8"))
    assert begun.wait(30.0)
    leaving = Thread(target=topic.unregister)
    leaving.start()
    leaving.join(0.1)
    go_on.set()
    leaving.join(30.0)
    assert seen[0] is not None and publisher.impl is None


RIG = """<robot name="rig"><link name="world"/>
  <joint name="cart" type="prismatic"><parent link="world"/><child link="box"/><axis xyz="1 0 0"/>
    <limit lower="-5" upper="5" effort="100" velocity="20"/></joint>
  <link name="box"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <gazebo><plugin name="p" filename="libgazebo_ros_p3d.so"><bodyName>box</bodyName>
    <topicName>/pose</topicName></plugin></gazebo>
  <gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo></robot>"""


def take_names(monkeypatch, start: str) -> None:
    for name in ("Publisher", "Service"):
        make = getattr(rospy, name)

        def advertise(topic: str, *given: object, make: Callable = make, **more: object) -> object:
            if topic.startswith(start):
                raise rospy.ROSException("taken")
            return make(topic, *given, **more)

        monkeypatch.setattr(rospy, name, advertise)


@pytest.mark.parametrize(("taken", "told"), [
    ("/rig/controller_manager", "robot 'rig'"), ("/pose", "sensor '/pose'"),
    ("/eye", "camera 'eye'"), ("/nothing", "")])
def test_all_there_is_has_its_topics_and_services_each_for_itself(
    graph, thread, monkeypatch, taken, told
):
    rounds = []
    simulation = thread.simulation
    thread.call(lambda: simulation.spawn(parse_urdf(RIG), "rig", namespace="/rig"))
    thread.call(lambda: simulation.add_camera("eye", SETTINGS))
    take_names(monkeypatch, taken)
    on_graph = DeviceInterfaces(thread, lambda: rounds.append(1))
    assert on_graph.restart_record is not None and not graph.parameters
    thread.limits.clear()
    on_graph.sync()
    on_graph.sync()
    assert thread.limits == [60.0, 60.0]  # a spawn may be under way
    here = {"robot 'rig'": "/rig/controller_manager/list_controllers" in graph.services,
            "sensor '/pose'": "/pose" in graph.publishers,
            "camera 'eye'": "/eye/image_raw" in graph.publishers}
    assert here == {name: name != told for name in here}
    assert [line.partition(" is simulated, but has no topics and services: taken;")[0]
            for line in graph.lines] == [told] * bool(told)
    if told != "camera 'eye'":
        graph.listen("/eye/image_raw")
        thread.step(20, 120.0)
        assert rounds
    thread.call(lambda: simulation.delete("rig"))
    thread.call(simulation.cameras.clear)
    on_graph.sync()
    assert not graph.services and set(graph.publishers) <= {"/tf_static"}
    on_graph.restart_record.add_model("spawn_urdf_model", SpawnModelRequest(model_name="m"))
    assert rospy.resolve_name("~spawned") not in graph.parameters  # unless it is told to


def test_a_camera_that_cannot_be_put_on_the_graph_leaves_nothing(graph, thread, monkeypatch):
    thread.call(lambda: thread.simulation.add_camera("eye", SETTINGS))
    with monkeypatch.context() as patch:
        take_names(patch, "/eye/segmentation/labels")
        with pytest.raises(rospy.ROSException):
            CameraTopics(thread.simulation.cameras[0], thread)
    assert not graph.publishers and not graph.services
    # Nor does it take away a frame that another camera has told.
    given = {**SETTINGS, "optical_frame_name": "lens", "segmentation": False}
    thread.call(lambda: thread.simulation.add_camera("first", given))
    thread.call(lambda: thread.simulation.add_camera("second", {**given, "segmentation": True}))
    CameraTopics(thread.simulation.cameras[1], thread)
    take_names(monkeypatch, "/second/segmentation/labels")
    with pytest.raises(rospy.ROSException):
        CameraTopics(thread.simulation.cameras[2], thread)
    told = graph.publishers["/tf_static"].sent[-1].transforms
    assert [one.child_frame_id for one in told] == ["lens"]
