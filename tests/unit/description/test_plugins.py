"""Table of plugins: supported files, their functions, and messages about others."""

import math
from dataclasses import astuple, replace

import pytest

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.description import DepthDescription, SensorDescription, parse_sdf, parse_urdf
from aras_sim_bridge.description.plugins import PLUGINS
from aras_sim_bridge.errors import CameraError, DescriptionError

EYES = """<camera name='left'><pose>0 0.02 0 0 0 0</pose><image><width>64</width></image></camera>
<camera name='right'><pose>0 -0.05 0 0 0 0.3</pose><image><width>64</width></image></camera>"""


def robot(inside):
    return parse_urdf(f"<robot name='r'><link name='a'/>{inside}</robot>")


def sensor(filename, settings="", kind="camera", inside="<camera/>", before=""):
    return robot(f"<gazebo reference='a'><sensor type='{kind}' name='eye'>{before}{inside}"
                 f"<plugin name='p' filename='{filename}'>{settings}</plugin></sensor></gazebo>")


def config(*given, **named):
    return CameraConfig.from_description(sensor(*given, **named).cameras[0])


@pytest.mark.parametrize("filename", ["libgazebo_ros_camera.so", "gazebo_ros_camera",
                                      "/opt/lib/libgazebo_ros_camera.so"])
def test_files_are_known_with_and_without_lib_and_folder(filename):
    assert sensor(filename, "<cameraName>c</cameraName>").cameras[0].plugin.camera_name == "c"


def test_plugins_of_a_camera_that_are_ignored():
    read = sensor("libmy_camera_noise.so", "<cameraName>c</cameraName>")
    assert read.cameras[0].plugin is None
    assert read.warnings == (
        "camera 'eye' on link 'a': plugin 'libmy_camera_noise.so' is ignored, because it is "
        "not known",)
    block = "<gazebo><plugin name='{}' filename='{}'/></gazebo>"
    read = robot("".join(block.format(i, name) for i, name in enumerate(
        ["libx.so", "liby.so", "libx.so", "libgazebo_ros_camera.so"])))
    assert read.warnings == (
        "<gazebo>: plugin 'libx.so' is ignored, because it is not known",
        "<gazebo>: plugin 'liby.so' is ignored, because it is not known",
        "<gazebo>: plugin 'libgazebo_ros_camera.so' is ignored, because it does not belong here")
    read = sensor("libgazebo_ros_camera.so", "<cameraName>second</cameraName>", before=(
        "<plugin filename='libgazebo_ros_camera.so'><cameraName>first</cameraName></plugin>"))
    assert read.cameras[0].plugin.camera_name == "first"
    assert read.warnings == ("camera 'eye' on link 'a': plug-in 'second' is ignored, because only "
                             "one plug-in can publish the camera's images; remove one",)
    named = config("libgazebo_ros_triggered_camera.so", "<triggerTopicName>t/u</triggerTopicName>")
    assert named.trigger_topic == "t/u"
    read = sensor("libgazebo_ros_camera.so", "<triggerTopicName>go</triggerTopicName>")
    (warning,) = read.warnings
    assert "camera 'eye'" in warning and "libgazebo_ros_triggered_camera.so" in warning
    assert read.cameras[0].plugin.trigger_topic == ""


@pytest.mark.parametrize("mimic, words", [
    ("<mimic joint='a'/>", "is not needed: <mimic> already works"),
    ("", "is not supported: give joint 'b' a <mimic joint='a'/>, which works"),
])
def test_what_becomes_of_a_mimic_plugin_is_said_once(mimic, words):
    name = "libroboticsgroup_upatras_gazebo_mimic_joint_plugin.so"
    block = f"<gazebo><plugin name='m' filename='{name}'><joint>a</joint>" \
            "<mimicJoint>b</mimicJoint></plugin></gazebo>"
    turn = "<joint name='{0}' type='continuous'><parent link='a'/><child link='{0}'/>{1}</joint>"
    read = parse_urdf("<robot name='r'><link name='a'/><link name='b'/><link name='c'/>"
                      "<joint name='a' type='continuous'><parent link='a'/><child link='c'/>"
                      "</joint>" + turn.format("b", mimic) + block * 2 + "</robot>")
    assert [one for one in read.warnings if name in one] == [f"<gazebo>: plugin '{name}' {words}"]


def test_a_joint_state_publisher():
    """Topic and namespace as upstream's: that of the model where it names none."""
    def made(inside):
        return robot("<link name='b'/><joint name='j' type='continuous'><parent link='a'/><child "
                     "link='b'/></joint><gazebo><plugin filename="
                     f"'libgazebo_ros_joint_state_publisher.so'>{inside}</plugin></gazebo>")

    (bare,) = made("<jointName>j</jointName>").sensors
    assert (bare.kind, bare.topic, bare.namespace, bare.rate, bare.joints) == (
        "joint_states", "joint_states", None, 100.0, ("j",))
    read = made("<jointName>k, j</jointName><robotNamespace>arm</robotNamespace>"
                "<updateRate>7</updateRate>")
    assert [(one.namespace, one.rate, one.joints) for one in read.sensors] == [("arm", 7.0, ("j",))]
    assert sum("joint 'k' is ignored, because it does not" in one for one in read.warnings) == 1
    empty = made("")
    assert not empty.sensors and sum("no <jointName>" in one for one in empty.warnings) == 1


def test_depth_cameras_as_upstream_names_and_bounds_them():
    """What they leave open: test_left_open.py."""
    plain = config("libgazebo_ros_depth_camera.so", kind="depth")
    assert plain.depth and (plain.image_topic, plain.info_topic) == (
        "ir/image_raw", "ir/camera_info")
    full = config(
        "libgazebo_ros_openni_kinect.so",
        "<imageTopicName>rgb/i</imageTopicName><cameraInfoTopicName>rgb/c</cameraInfoTopicName>"
        "<depthImageTopicName>d/i</depthImageTopicName>"
        "<depthImageCameraInfoTopicName>d/c</depthImageCameraInfoTopicName>"
        "<pointCloudTopicName>d/p</pointCloudTopicName><pointCloudCutoff>.1</pointCloudCutoff>"
        "<pointCloudCutoffMax>3</pointCloudCutoffMax>"
        "<useDepth16UC1Format>true</useDepth16UC1Format>", kind="depth")
    assert full.depth_topics == DepthDescription("d/i", "d/c", "d/p", 0.1, 3.0, True)
    assert (full.image_topic, full.info_topic) == ("rgb/i", "rgb/c")
    near = config("libgazebo_ros_openni_kinect.so", "<pointCloudCutoff>0</pointCloudCutoff>"
                  "<pointCloudCutoffMax>.5</pointCloudCutoffMax>", kind="depth").depth_topics
    assert (near.nearest, near.farthest) == (0.0, 0.5)
    with pytest.raises(CameraError, match="depth_topics/points 'a b' is not a valid ROS name"):
        config("libgazebo_ros_depth_camera.so", "<pointCloudTopicName>a b</pointCloudTopicName>")


@pytest.mark.parametrize("read", [
    lambda inside: robot(f"<gazebo reference='a'>{inside}</gazebo>"),
    lambda inside: parse_sdf("<sdf version='1.6'><model name='r'><static>1</static>"
                             f"<link name='a'>{inside}</link></model></sdf>"),
])
def test_the_eyes_of_a_multicamera(read):
    left, right = read(
        "<sensor type='multicamera' name='stereo'><pose>1 0 0 0 0 1.5707963267948966</pose>"
        f"<update_rate>7</update_rate>{EYES}<plugin filename='libgazebo_ros_multicamera.so'>"
        "<cameraName>head/camera</cameraName><hackBaseline>.07</hackBaseline>"
        "<frameName>f</frameName></plugin></sensor>").cameras
    assert left.pose == (pytest.approx((0.98, 0, 0)), pytest.approx((0, 0, math.pi / 2)))
    assert right.pose == (pytest.approx((1.05, 0, 0)), pytest.approx((0, 0, math.pi / 2 + 0.3)))
    made = [CameraConfig.from_description(eye) for eye in (left, right)]
    assert [eye.topic_root for eye in made] == ["/head/camera/left", "/head/camera/right"]
    assert [eye.update_rate for eye in made] == [7.0, 7.0]
    assert [eye.shutter for eye in made] == ["stereo", "stereo"]
    assert [eye.make_intrinsics().P[0, 3] for eye in made] == [
        0.0, pytest.approx(-0.07 * made[1].make_intrinsics().K[0, 0])]


CONTACT = "<contact><collision>c</collision></contact>"


def measured(file, settings="", kind="", inside=None):
    """A model with this plug-in, in a <sensor> of a kind or in the model itself."""
    own = f"<plugin filename='libgazebo_ros_{file}.so'>{settings}</plugin>"
    inside = CONTACT if kind == "contact" and inside is None else inside or ""
    sensor = f"<sensor name='s' type='{kind}'>{inside}{own}</sensor>" if kind else ""
    return parse_sdf(
        "<sdf><model name='m'><link name='a'><collision name='c'><geometry><box><size>1 1 1</size>"
        f"</box></geometry></collision>{sensor if kind != 'force_torque' else ''}</link>"
        "<link name='b'/><joint name='j' type='fixed'><parent>a</parent><child>b</child>"
        f"{sensor if kind == 'force_torque' else ''}</joint>{own if not kind else ''}"
        "</model></sdf>")


NAMES = ("<topicName>t</topicName><robotNamespace>n</robotNamespace><frameName>b</frameName>"
         "<updateRate>5</updateRate>")
SETTINGS = (NAMES + "<gaussianNoise>0.5</gaussianNoise><xyzOffset>1 2 3</xyzOffset><rpyOffset>"
            ".1 .2 .3</rpyOffset><bodyName>a</bodyName>")
FULL = SensorDescription("pose", "t", "n", "b", 5.0, "a", noise=0.5,
                         offset=((1, 2, 3), (0.1, 0.2, 0.3)))


@pytest.mark.parametrize(("file", "kind", "settings", "expected"), [
    ("p3d", "", SETTINGS, FULL),
    ("p3d", "", "<bodyName>a</bodyName><topicName>t</topicName>",
     SensorDescription("pose", "t", "", "world", link="a")),
    ("imu", "", SETTINGS, replace(FULL, kind="body_imu")),
    ("imu", "", "<bodyName>a</bodyName>", SensorDescription("body_imu", "/default_imu", link="a")),
    ("imu_sensor", "imu", SETTINGS + "<updateRateHZ>7</updateRateHZ>"
     "<initialOrientationAsReference>1</initialOrientationAsReference>",
     replace(FULL, kind="imu", rate=7.0, from_start=True)),
    ("imu_sensor", "imu", "<frameName>f</frameName>",
     SensorDescription("imu", "imu_data", None, "f", 1.0, "a")),
    ("ft_sensor", "", NAMES + "<gaussianNoise>0.5</gaussianNoise><jointName>j</jointName>",
     SensorDescription("wrench", "t", "n", rate=5.0, noise=0.5, link="b", joint="j")),
    ("ft_sensor", "force_torque", "<topicName>t</topicName>",
     SensorDescription("wrench", "t", link="b", joint="j")),
    ("bumper", "contact", NAMES + "<bumperTopicName>u</bumperTopicName>",
     SensorDescription("contact", "u", "n", "b", link="a", collisions=("c",))),
    ("bumper", "contact", "",
     SensorDescription("contact", "bumper_states", "", "world", link="a", collisions=("c",)))])
def test_a_sensor_and_its_plugin_in_full(file, kind, settings, expected):
    made = measured(file, settings, kind)
    assert made.warnings == ()
    assert [astuple(one) for one in made.sensors] == [astuple(expected)]


@pytest.mark.parametrize(("file", "kind"), [
    ("p3d", ""), ("imu", ""), ("ft_sensor", ""), ("imu_sensor", "imu")])
def test_noise_and_rate_of_a_plugin_are_not_negative(file, kind):
    rate = "updateRateHZ" if kind else "updateRate"
    known = SETTINGS.replace("<updateRate>5</updateRate>", "").replace("0.5</gauss", "0</gauss")
    known += "<jointName>j</jointName>"
    (made,) = measured(file, f"{known}<{rate}>0</{rate}>", kind).sensors
    assert (made.rate, made.noise) == (0.0, 0.0)
    for tag, what in ((rate, "rate"), ("gaussianNoise", "noise")):
        with pytest.raises(DescriptionError, match=f"the {what} is -0.5; it must not be negative"):
            measured(file, f"<{tag}>-0.5</{tag}>{known}", kind)


def channels(kind, first, second):
    """Noise on the y axis of the first quantity and the z axis of the second, all else without."""
    quiet = (0.0,) * 4
    a, b = {"imu": ("angular_velocity", "linear_acceleration"),
            "force_torque": ("force", "torque")}[kind]
    noise = ("<noise><mean>{}</mean><stddev>{}</stddev><bias_mean>{}</bias_mean>"
             "<bias_stddev>{}</bias_stddev></noise>")
    text = (f"<{a}><y>{noise.format(*first)}</y></{a}>"
            f"<{b}><z>{noise.format(*second)}</z></{b}>")
    return f"<{kind}>{text}</{kind}>", [quiet, first, quiet, quiet, quiet, second]


@pytest.mark.parametrize(("file", "kind", "settings"), [
    ("imu_sensor", "imu", "<frameName>f</frameName>"),
    ("ft_sensor", "force_torque", "<topicName>t</topicName>")])
def test_a_sensor_s_noise_is_of_the_axis_that_it_is_written_for(file, kind, settings):
    text, expected = channels(kind, (0.1, 0.2, 0.3, 0.4), (-0.5, 0.6, -0.7, 0.8))
    place = "<pose>1 2 3 .1 .2 .3</pose><update_rate>9</update_rate>"
    (made,) = measured(file, settings, kind, place + text).sensors
    assert [astuple(one) for one in made.channels] == expected
    assert made.pose == ((1, 2, 3), pytest.approx((0.1, 0.2, 0.3)))
    assert made.sample_rate == (9.0 if kind == "imu" else 0.0)
    text, _ = channels(kind, (0.0,) * 4, (0.0,) * 4)
    assert measured(file, settings, kind, text).sensors[0].channels == ()


@pytest.mark.parametrize(("named", "name", "known"), [
    ("> c\n<", "c", True), (" name='d'>c<", "c", True), (" name='c'><", "c", True),
    (">a_fixed_joint_lump__c<", "a_fixed_joint_lump__c", True),
    (">b_fixed_joint_lump__c_1<", "b_fixed_joint_lump__c_1", False), (">xc<", "xc", False),
    ("><", "", False)])
def test_a_bumper_s_collisions_exist(named, name, known):
    """By their own name, or by Gazebo's of what is lumped together."""
    both = f"<contact><collision>c</collision><collision{named}/collision></contact>"
    made = measured("bumper", "", "contact", both)
    if known:
        assert made.sensors[0].collisions == ("c", name) and not made.warnings
    else:
        (warning,) = made.warnings
        assert made.sensors and f"collision '{name}' does not exist" in warning


@pytest.mark.parametrize(("names", "sides"), [
    (("left", "right"), ("left", "right")), (("my_left_eye", "the_right"), ("left", "right")),
    (("up", "down"), ("up", "down")), (("", ""), ("0", "1"))])
def test_an_eye_is_named_after_its_side_or_itself(names, sides):
    """The baseline is that of the right one."""
    inside = "".join(f"<camera{f' name={name!r}' if name else ''}/>" for name in names)
    read = sensor("gazebo_ros_multicamera", "<cameraName>head</cameraName><hackBaseline>.07"
                  "</hackBaseline>", kind="multicamera", inside=inside)
    own = [name or str(k) for k, name in enumerate(names)]
    assert [eye.name for eye in read.cameras] == [f"eye_{name}" for name in own]
    assert [eye.plugin.camera_name for eye in read.cameras] == [f"head/{side}" for side in sides]
    assert [eye.plugin.hack_baseline for eye in read.cameras] == [
        0.07 if side == "right" else 0.0 for side in sides]
    bare = robot(f"<gazebo reference='a'><sensor type='multicamera' name='eye'>{inside}</sensor>"
                 "</gazebo>").cameras
    assert [(eye.plugin, eye.shutter, eye.kind) for eye in bare] == [
        (None, "eye", "multicamera")] * 2


@pytest.mark.parametrize("name", [one for one in PLUGINS if one != "gazebo_ros_link_attacher"])
def test_a_setting_that_a_plugin_does_not_serve_is_named(name):
    """Each one of a served plug-in, in the place that it belongs to."""
    plugin = f"<plugin filename='lib{name}.so'><jointName>j</jointName><wheels>3</wheels></plugin>"
    kind = ("multicamera" if "multicamera" in name else "depth" if "depth" in name or "kinect" in (
        name) else "camera" if "camera" in name else {
            "gazebo_ros_imu_sensor": "imu", "gazebo_ros_bumper": "contact"}.get(name, ""))
    sensor = f"<sensor name='s' type='{kind}'><camera name='left'/>{plugin}</sensor>"
    text = ("<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='fixed'><parent "
            "link='a'/><child link='b'/></joint>" + (
                f"<gazebo reference='a'>{sensor}</gazebo>" if kind else f"<gazebo>{plugin}</gazebo>"
            ) + "</robot>")
    lines = [line for line in parse_urdf(text).warnings if "<wheels>" in line]
    assert len(lines) == 1 and f"plugin 'lib{name}.so': " in lines[0]
    assert lines[0].endswith("not supported")
