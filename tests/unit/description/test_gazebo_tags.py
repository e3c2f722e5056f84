"""<gazebo> tags of a URDF: plugins, cameras, flags of links; unknown tags cause a warning."""

import pytest

from aras_sim_bridge.description import (
    CameraPlugin,
    ControlPlugin,
    LensDescription,
    PixelNoise,
    parse_urdf,
)
from aras_sim_bridge.errors import DescriptionError


def robot(inside):
    return parse_urdf(f"<robot name='r'><link name='a'/>{inside}</robot>")


def camera(inside="", sensor="", kind="camera"):
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
    assert made.noise == PixelNoise("gaussian", 0.1, 0.2)
    assert (made.distortion, made.distortion_center) == ((1, 2, 3, 4, 5), (0.4, 0.6))
    assert made.plugin is None and made.lens is None


@pytest.mark.parametrize(("kind", "widest"), [
    ("camera", 3.14159), ("wideanglecamera", 6.283185307179587)])
def test_a_camera_s_numbers_at_their_bounds(kind, widest):
    """As wide as can be, with nothing between near and far, at no rate."""
    made = camera(f"<horizontal_fov>{widest}</horizontal_fov><clip><near>1e-9</near><far>2e-9</far>"
                  "</clip><noise><stddev>0</stddev></noise><image><width>1</width><height>16384"
                  "</height></image>", "<update_rate>0</update_rate>", kind)
    assert (made.horizontal_fov, made.near, made.far) == (widest, 1e-9, 2e-9)
    assert (made.width, made.height) == (1, 16384)
    with pytest.raises(DescriptionError, match="horizontal_fov is"):
        camera(f"<horizontal_fov>{widest + 1e-5}</horizontal_fov>", kind=kind)
    with pytest.raises(DescriptionError, match="need 0 < near < far"):
        camera("<clip><near>2</near><far>2</far></clip>", kind=kind)


def test_the_plugin_and_the_lens_of_a_camera():
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
    made = camera("<lens><type>equidistant</type><scale_to_hfov>false</scale_to_hfov>"
                  "<cutoff_angle>1.2</cutoff_angle></lens>", kind="wideanglecamera")
    assert made.lens == LensDescription("equidistant", False, 1.2)
    plain = camera("<horizontal_fov>6</horizontal_fov><lens/>", kind="wideanglecamera")
    assert plain.lens == LensDescription("gnomonical", True, pytest.approx(1.5707963))
    assert plain.horizontal_fov == 6.0


@pytest.mark.parametrize("inside, reason", [
    ("<image><width>0</width></image>", "image is 0 × 240 pixels; each side must be 1 … 16384"),
    ("<image><width>1.5</width></image>", "image width: 1.5 is not a whole number"),
    ("<clip><near>0</near></clip>", "clip near 0.0"),
    ("<horizontal_fov>0</horizontal_fov>", r"horizontal_fov is 0.0 rad; it must be in \(0, 3.1416"),
    ("<horizontal_fov>wide</horizontal_fov>", "'wide' is not a number"),
    ("<noise><stddev>-1</stddev></noise>", "noise stddev is -1.0; it must not be negative"),
    ("<lens><type>magic</type></lens>", "lens type 'magic' is unknown; use one of gnomonical"),
    ("<lens><intrinsics><fx>0</fx></intrinsics></lens>", "fx 0.0 and fy 277.0 are focal lengths"),
    ("<distortion><k1>nan</k1></distortion>", "distortion k1: nan is not finite"),
    ("</camera><update_rate>-1</update_rate><camera>", "update_rate is -1.0 Hz")])
def test_a_camera_that_cannot_be_is_named(inside, reason):
    with pytest.raises(DescriptionError, match=reason) as refused:
        camera(inside)
    assert "camera 'eye' on link 'a'" in str(refused.value)


def test_sensors_of_joints_and_sensors_that_are_none():
    with pytest.raises(DescriptionError, match="link 'a': a camera sensor has no name"):
        robot("<gazebo reference='a'><sensor type='camera'><camera/></sensor></gazebo>")
    with pytest.raises(DescriptionError, match="<camera> is missing"):
        robot("<gazebo reference='a'><sensor type='depth' name='e'/></gazebo>")
    twins = robot("<gazebo reference='a'>" + 2 * (
        "<sensor type='camera' name='e'><camera/></sensor>") + "</gazebo>")
    assert [one.name for one in twins.cameras] == ["e"]
    assert sum("two cameras are named 'e'" in one for one in twins.warnings) == 1
    made = parse_urdf(
        "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='fixed'><parent "
        "link='a'/><child link='b'/></joint><gazebo reference='j'><sensor type='force_torque' "
        "name='s'><plugin filename='libgazebo_ros_ft_sensor.so'><topicName>t</topicName></plugin>"
        "<plugin filename='libnone.so'/></sensor></gazebo></robot>")
    assert [(one.kind, one.joint, one.topic) for one in made.sensors] == [("wrench", "j", "t")]
    assert len(made.warnings) == 1 and "sensor 's' on joint 'j'" in made.warnings[0]


def test_the_control_plugin_and_flags():
    text = "<gazebo><plugin filename='libgazebo_ros_control.so'>{}</plugin></gazebo>"
    assert robot(text.format("")).control_plugins == (ControlPlugin(),)
    (full,) = robot(text.format(
        "<robotNamespace>/n</robotNamespace><controlPeriod>.002</controlPeriod><robotParam>p"
        "</robotParam><eStopTopic>e</eStopTopic>")).control_plugins
    assert full == ControlPlugin("/n", 0.002, "e")
    with pytest.raises(DescriptionError, match="controlPeriod is 0.0 s; it must be positive"):
        robot(text.format("<controlPeriod>0</controlPeriod>"))
    text = "<gazebo reference='a'>{}</gazebo>"
    assert robot("<gazebo><static>true</static></gazebo>").static
    assert not robot("<gazebo/>").static
    with pytest.raises(DescriptionError, match="kinematic: 'maybe' is neither true nor false"):
        robot(text.format("<kinematic>maybe</kinematic>"))


@pytest.mark.parametrize("inside, warning", [
    ("<gazebo reference='b'/>", "<gazebo reference='b'> is ignored, because it names no link"),
    ("<gazebo><plugin filename='x.so'/></gazebo>", "plugin 'x.so' is ignored, because "
                                                   "it is not known"),
    ("<gazebo reference='a'><sensor type='ray'/></gazebo>", "its type 'ray' is not supported"),
    *((f"<gazebo reference='a'><sensor name='s' type='{kind}'><camera><lens>{inside}</lens>"
       "</camera></sensor></gazebo>", says) for kind, inside, says in (
        ("wideanglecamera", "<intrinsics/>", "<intrinsics> is ignored, because a wideanglecamera"),
        ("camera", "<type>equidistant</type>", "needs a wideanglecamera; this camera is drawn")))])
def test_what_is_not_known_warns(inside, warning):
    (said,) = robot(inside).warnings
    assert warning in said


FLAGS = {"gravity": True, "kinematic": False, "mu": None, "bounce": None}
BOUNCE = ("<collision><surface><bounce><restitution_coefficient>{}</restitution_coefficient>"
          "</bounce></surface></collision>")


@pytest.mark.parametrize(("tags", "changes"), [
    ("", {}), ("<mu1>0</mu1>", {"mu": 0.0}), ("<mu1 value='.4'/>", {"mu": 0.4}),
    ("<mu1>.4</mu1><mu2>.4</mu2>", {"mu": 0.4}), ("<gravity value='0'/>", {"gravity": False}),
    ("<gravity>1</gravity>", {}), ("<kinematic value='true'/>", {"kinematic": True}),
    ("<turnGravityOff>true</turnGravityOff><gravity>true</gravity>", {"gravity": False}),
    ("<turnGravityOff>false</turnGravityOff><gravity>false</gravity>", {"gravity": False}),
    ("<collision/>" + BOUNCE.format(0.5) + BOUNCE.format(0.7), {"bounce": (0.5, 0.0)})])
def test_what_a_tag_says_of_a_link_and_what_it_leaves(tags, changes):
    """A second tag of the same link changes what it names alone; other links keep all."""
    text = "<robot name='r'><link name='a'/><link name='b'/>" \
           "<joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint>{}</robot>"
    def flags(link):
        return {name: getattr(link, name) for name in FLAGS}

    block = f"<gazebo reference='b'>{tags}</gazebo>"
    made = parse_urdf(text.format(block + "<gazebo reference='b'/>"))
    assert flags(made.links["b"]) == FLAGS | changes and flags(made.links["a"]) == FLAGS
    assert made.warnings == ()
    all_set = {"gravity": False, "kinematic": True, "mu": 0.25, "bounce": (0.75, 0.0)}
    first = ("<gazebo reference='b'><gravity>0</gravity><kinematic>1</kinematic><mu1>.25</mu1>"
             f"{BOUNCE.format(0.75)}</gazebo>")
    made = parse_urdf(text.format(first + block))
    kept = {name: value for name, value in all_set.items()
            if name not in changes and f"<{name}>" not in tags}
    assert {name: flags(made.links["b"])[name] for name in kept} == kept


def test_a_robot_s_tags_come_in_the_order_of_the_file():
    """Control plug-ins and sensors of the robot beside those of its links and joints."""
    imu = ("<sensor type='imu' name='i'><plugin filename='libgazebo_ros_imu_sensor.so'><frameName>f"
           "</frameName></plugin></sensor>")
    pose = ("<plugin filename='libgazebo_ros_p3d.so'><bodyName>{}</bodyName><topicName>{}"
            "</topicName></plugin>")
    control = "<plugin filename='libgazebo_ros_control.so'><robotNamespace>{}</robotNamespace>" \
              "</plugin>"
    eye = "<sensor type='camera' name='{}'><camera/></sensor>"
    made = robot(f"<gazebo>{pose.format('a', 't')}{control.format('one')}</gazebo>"
                 f"<gazebo reference='a'>{eye.format('e')}{imu}{eye.format('f')}</gazebo>"
                 f"<gazebo>{control.format('two')}<static>1</static>{pose.format('a', 'u')}"
                 "</gazebo><gazebo/>")
    assert made.warnings == () and made.static
    assert [one.robot_namespace for one in made.control_plugins] == ["one", "two"]
    assert [(one.kind, one.topic) for one in made.sensors] == [
        ("imu", "imu_data"), ("pose", "t"), ("pose", "u")]
    assert [one.name for one in made.cameras] == ["e", "f"]


@pytest.mark.parametrize(("noise", "kind"), [
    ("<noise><type>none</type></noise>", "none"), ("<noise type='other'/>", "other"),
    ("<noise type='other'><type>gaussian</type></noise>", "gaussian"),
    ("<noise><mean>-1</mean></noise>", "gaussian")])
def test_a_noise_s_type_is_an_element_or_an_attribute(noise, kind):
    assert camera(noise).noise == PixelNoise(kind, -1.0 if "-1" in noise else 0.0, 0.0)
