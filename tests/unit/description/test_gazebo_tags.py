"""The <gazebo> tags of a URDF: plugins, cameras, flags of links; what is not known warns."""

import math
from dataclasses import astuple

import pytest

from aras_sim_bridge.description import (
    CameraPlugin,
    ControlPlugin,
    LensDescription,
    Noise,
    parse_urdf,
)
from aras_sim_bridge.description.types import Light, SensorDescription
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.errors import DescriptionError


def robot(inside):
    """A robot of one link 'a' with these tags."""
    return parse_urdf(f"<robot name='r'><link name='a'/>{inside}</robot>")


def camera(inside="", sensor="", kind="camera"):
    """The camera of a sensor with this text in its <camera>, and beside it."""
    return robot(f"<gazebo reference='a'><sensor type='{kind}' name='eye'>{sensor}<camera>{inside}"
                 "</camera></sensor></gazebo>").cameras[0]


def test_a_camera_s_numbers():
    made = camera(
        "<horizontal_fov>2</horizontal_fov><image><width>640</width><height>480</height>"
        "<format>L8</format></image><clip><near>.02</near><far>50</far></clip>"
        "<noise><type>gaussian</type><mean>.1</mean><stddev>.2</stddev></noise>"
        "<distortion><k1>1</k1><k2>2</k2><k3>3</k3><p1>4</p1><p2>5</p2><center>.4 .6</center>"
        "</distortion>", "<pose>1 2 3 .1 .2 .3</pose><update_rate>30</update_rate>")
    assert (made.name, made.link, made.kind) == ("eye", "a", "camera")
    assert made.pose == ((1, 2, 3), (0.1, 0.2, 0.3))
    assert (made.horizontal_fov, made.width, made.height, made.format) == (2.0, 640, 480, "L8")
    assert (made.near, made.far, made.update_rate) == (0.02, 50.0, 30.0)
    assert made.noise == Noise("gaussian", 0.1, 0.2)
    assert (made.distortion, made.distortion_center) == ((1, 2, 3, 4, 5), (0.4, 0.6))
    assert made.plugin is None and made.lens is None


def test_what_a_camera_leaves_open():
    made = camera()
    assert (made.horizontal_fov, made.width, made.height) == (1.047, 320, 240)
    assert made.format == "R8G8B8"
    assert (made.near, made.far, made.update_rate) == (0.1, 100.0, 0.0)
    assert (made.noise, made.distortion, made.distortion_center) == (Noise(), None, (0.5, 0.5))
    assert made.pose == ((0, 0, 0), (0, 0, 0))
    for size in (1, 16384):  # the smallest and the largest picture there are
        image = f"<image><width>{size}</width><height>{size}</height></image>"
        assert (camera(image).width, camera(image).height) == (size, size)
    assert camera("<noise/>").noise == Noise("gaussian", 0.0, 0.0)
    made = camera("<distortion/>")
    assert (made.distortion, made.distortion_center) == ((0, 0, 0, 0, 0), (0.5, 0.5))


def test_what_gazebo_takes_where_a_file_says_nothing():
    world, lens, sensor = WorldFile(), LensDescription(), SensorDescription("wrench", "t")
    assert (world.time_step, world.gravity, world.update_rate) == (0.001, (0.0, 0.0, -9.8), 1000.0)
    assert (lens.kind, lens.scale_to_hfov) == ("gnomonical", True)
    assert lens.cutoff_angle == math.pi / 2
    assert (sensor.measured_in, sensor.on_child, sensor.rate) == ("child", False, 0.0)
    assert astuple(Light("l"))[1:12] == (
        "directional", (0.0, 0.0, 10.0), (0.0,) * 3, (0.8, 0.8, 0.8, 1.0), (0.2, 0.2, 0.2, 1.0),
        (-0.4834, 0.0967, -0.8701), 0.9, 0.01, 0.001, 1000.0, 0.6)


def test_a_joint_s_own_sensor_needs_no_name_of_it():
    made = parse_urdf(
        "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='fixed'><parent "
        "link='a'/><child link='b'/></joint><gazebo reference='j'><sensor type='force_torque' "
        "name='s'><plugin filename='libgazebo_ros_ft_sensor.so'><topicName>t</topicName></plugin>"
        "<plugin filename='libnone.so'/></sensor></gazebo></robot>")
    assert [(one.kind, one.joint, one.topic) for one in made.sensors] == [("wrench", "j", "t")]
    assert len(made.warnings) == 1 and "sensor 's' on joint 'j'" in made.warnings[0]


@pytest.mark.parametrize(("kind", "widest"), [
    ("camera", 3.14159), ("wideanglecamera", 6.283185307179587)])
def test_a_camera_s_numbers_at_their_bounds(kind, widest):
    """As wide as can be, with nothing between near and far, at no rate; and placed twice."""
    made = camera(f"<horizontal_fov>{widest}</horizontal_fov><clip><near>1e-9</near><far>2e-9</far>"
                  "</clip><noise><stddev>0</stddev></noise><pose>1 0 0 0 0 0.5</pose>",
                  "<update_rate>0</update_rate><pose>0 2 0 0 0 1.5707963267948966</pose>", kind)
    assert (made.horizontal_fov, made.near, made.far) == (widest, 1e-9, 2e-9)
    assert made.pose == (pytest.approx((0, 3, 0)), pytest.approx((0, 0, math.pi / 2 + 0.5)))
    with pytest.raises(DescriptionError, match="horizontal_fov is"):
        camera(f"<horizontal_fov>{widest + 1e-5}</horizontal_fov>", kind=kind)
    with pytest.raises(DescriptionError, match="need 0 < near < far"):
        camera("<clip><near>2</near><far>2</far></clip>", kind=kind)


def test_a_camera_s_plugin():
    names = {"robotNamespace": "/n", "cameraName": "c", "imageTopicName": "i",
             "cameraInfoTopicName": "j", "frameName": "f", "updateRate": "1",
             "hackBaseline": ".07", "Cx": "2", "Cy": "3", "focalLength": "4",
             "distortionK1": "5", "distortionK2": "6", "distortionK3": "7", "distortionT1": "8",
             "distortionT2": "9", "autoDistortion": "true"}
    text = "".join(f"<{tag}>{value}</{tag}>" for tag, value in names.items())
    plugin = "<plugin name='p' filename='libgazebo_ros_camera.so'>{}</plugin>"
    assert camera(sensor=plugin.format(text)).plugin == CameraPlugin(
        "/n", "c", "i", "j", "f", 1.0, 0.07, 2.0, 3.0, 4.0, (5, 6, 7, 8, 9), True)
    assert camera(sensor=plugin.format("")).plugin == CameraPlugin()
    assert CameraPlugin().image_topic == "image_raw" and CameraPlugin().info_topic == "camera_info"
    assert camera(sensor="<plugin filename='libother.so'/>").plugin is None
    assert camera(sensor="<plugin filename='libgazebo_ros_openni_kinect.so'/>").plugin is not None


def test_a_lens():
    made = camera("<lens><type>equidistant</type><scale_to_hfov>false</scale_to_hfov>"
                  "<cutoff_angle>1.2</cutoff_angle></lens>", kind="wideanglecamera")
    assert made.lens == LensDescription("equidistant", False, 1.2)
    plain = camera("<horizontal_fov>6</horizontal_fov><lens/>", kind="wideanglecamera")
    assert plain.lens == LensDescription("gnomonical", True, pytest.approx(1.5707963))
    assert plain.horizontal_fov == 6.0


@pytest.mark.parametrize("inside, reason", [
    ("<image><width>0</width></image>", "image is 0 × 240 pixels; 1 … 16384 are possible"),
    ("<image><height>16385</height></image>", "320 × 16385"),
    ("<image><height>0</height></image>", "320 × 0"),
    ("<image><width>16385</width></image>", "16385 × 240"),
    ("<image><width>1.5</width></image>", "image width: 1.5 is not a whole number"),
    ("<clip><near>2</near><far>1</far></clip>", "clip near 2.0 and far 1.0 need 0 < near < far"),
    ("<clip><near>0</near></clip>", "clip near 0.0"),
    ("<horizontal_fov>0</horizontal_fov>", r"horizontal_fov is 0.0 rad; it must be in \(0, 3.1416"),
    ("<horizontal_fov>3.2</horizontal_fov>", "horizontal_fov is 3.2 rad"),
    ("<horizontal_fov>wide</horizontal_fov>", "'wide' is not a number"),
    ("<noise><stddev>-1</stddev></noise>", "noise stddev is -1.0; it must not be negative"),
    ("<lens><type>magic</type></lens>", "lens type 'magic' is unknown; use one of gnomonical"),
    ("<distortion><k1>nan</k1></distortion>", "distortion k1: nan is not finite"),
    ("</camera><update_rate>-1</update_rate><camera>", "update_rate is -1.0 Hz"),
])
def test_a_camera_that_cannot_be_is_named(inside, reason):
    with pytest.raises(DescriptionError, match=reason) as refused:
        camera(inside)
    assert "camera 'eye' on link 'a'" in str(refused.value)


def test_sensors_that_are_none():
    with pytest.raises(DescriptionError, match="link 'a': a camera sensor has no name"):
        robot("<gazebo reference='a'><sensor type='camera'><camera/></sensor></gazebo>")
    with pytest.raises(DescriptionError, match="has no <camera> element"):
        robot("<gazebo reference='a'><sensor type='depth' name='e'/></gazebo>")
    with pytest.raises(DescriptionError, match="two cameras are named 'e'; rename one"):
        robot("<gazebo reference='a'>" + 2 * (
            "<sensor type='camera' name='e'><camera/></sensor>") + "</gazebo>")


def test_the_control_plugin():
    text = "<gazebo><plugin filename='libgazebo_ros_control.so'>{}</plugin></gazebo>"
    assert robot(text.format("")).control_plugins == (ControlPlugin(),)
    (full,) = robot(text.format(
        "<robotNamespace>/n</robotNamespace><controlPeriod>.002</controlPeriod><robotParam>p"
        "</robotParam><eStopTopic>e</eStopTopic>")).control_plugins
    assert full == ControlPlugin("/n", 0.002, "e")
    with pytest.raises(DescriptionError, match="controlPeriod is 0.0 s; it must be positive"):
        robot(text.format("<controlPeriod>0</controlPeriod>"))


def test_flags_of_links():
    text = "<gazebo reference='a'>{}</gazebo>"
    assert not robot(text.format("<gravity>false</gravity>")).links["a"].gravity
    assert not robot(text.format("<turnGravityOff>1</turnGravityOff>")).links["a"].gravity
    assert robot(text.format("<turnGravityOff>0</turnGravityOff>")).links["a"].gravity
    assert robot(text.format("<kinematic value='true'/>")).links["a"].kinematic
    assert robot(text.format("<mu1>.4</mu1>")).links["a"].mu == 0.4
    assert robot("<gazebo><static>true</static></gazebo>").static
    assert not robot("<gazebo/>").static
    with pytest.raises(DescriptionError, match="mu1 is -1.0; it must not be negative"):
        robot(text.format("<mu1>-1</mu1>"))
    with pytest.raises(DescriptionError, match="kinematic: 'maybe' is neither true nor false"):
        robot(text.format("<kinematic>maybe</kinematic>"))


@pytest.mark.parametrize("inside, warning", [
    ("<gazebo reference='b'/>", "<gazebo reference='b'> names no link or joint; ignored"),
    ("<gazebo><plugin filename='x.so'/></gazebo>", "plugin 'x.so' is not known; ignored"),
    ("<gazebo reference='a'><sensor type='ray'/></gazebo>", "sensor type 'ray' is not known"),
])
def test_what_is_not_known_warns(inside, warning):
    (said,) = robot(inside).warnings
    assert warning in said
