"""The table of plug-ins: which files are served, as what, and what is said of the others."""

import math

import pytest

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.description import DepthTopics, parse_sdf, parse_urdf
from aras_sim_bridge.errors import CameraError

EYES = """<camera name='left'><pose>0 0.02 0 0 0 0</pose><image><width>64</width></image></camera>
<camera name='right'><pose>0 -0.05 0 0 0 0.3</pose><image><width>64</width></image></camera>"""


def robot(inside):
    """A robot of one link 'a' with these tags."""
    return parse_urdf(f"<robot name='r'><link name='a'/>{inside}</robot>")


def sensor(filename, settings="", kind="camera", inside="<camera/>", before=""):
    """The description of a robot whose sensor has this plug-in."""
    return robot(f"<gazebo reference='a'><sensor type='{kind}' name='eye'>{before}{inside}"
                 f"<plugin name='p' filename='{filename}'>{settings}</plugin></sensor></gazebo>")


def config(*given, **named):
    """CameraConfig of the one camera of `sensor`."""
    (camera,) = sensor(*given, **named).cameras
    return CameraConfig.from_description(camera)


@pytest.mark.parametrize("filename", ["libgazebo_ros_camera.so", "gazebo_ros_camera",
                                      "/opt/lib/libgazebo_ros_camera.so"])
def test_files_are_known_with_and_without_lib_and_folder(filename):
    assert sensor(filename, "<cameraName>c</cameraName>").cameras[0].plugin.camera_name == "c"


def test_another_file_with_camera_in_its_name_is_no_camera_s_plugin():
    read = sensor("libmy_camera_noise.so", "<cameraName>c</cameraName>")
    assert read.cameras[0].plugin is None
    assert read.warnings == (
        "camera 'eye' on link 'a': plugin 'libmy_camera_noise.so' is not known; ignored",)


def test_each_unknown_plugin_is_named_once():
    block = "<gazebo><plugin name='{}' filename='{}'/></gazebo>"
    read = robot("".join(block.format(i, name) for i, name in enumerate(
        ["libx.so", "liby.so", "libx.so", "libgazebo_ros_camera.so"])))
    assert read.warnings == (
        "<gazebo>: plugin 'libx.so' is not known; ignored",
        "<gazebo>: plugin 'liby.so' is not known; ignored",
        "<gazebo>: plugin 'libgazebo_ros_camera.so' does not belong here; ignored")


def test_a_triggered_camera():
    assert config("libgazebo_ros_triggered_camera.so").trigger_topic == "image_trigger"
    named = config("libgazebo_ros_triggered_camera.so", "<triggerTopicName>t/u</triggerTopicName>")
    assert named.trigger_topic == "t/u"
    assert config("libgazebo_ros_camera.so").trigger_topic == ""


def test_a_trigger_on_a_camera_that_has_none():
    read = sensor("libgazebo_ros_camera.so", "<triggerTopicName>go</triggerTopicName>")
    (warning,) = read.warnings
    assert "camera 'eye'" in warning and "libgazebo_ros_triggered_camera.so" in warning
    assert read.cameras[0].plugin.trigger_topic == ""


def test_depth_cameras_as_upstream_names_and_bounds_them():
    plain = config("libgazebo_ros_depth_camera.so", kind="depth")
    assert plain.depth and plain.depth_topics == DepthTopics(
        "depth/image_raw", "depth/camera_info", "points", 0.4, math.inf, False, rows=False)
    assert (plain.image_topic, plain.info_topic) == ("ir/image_raw", "ir/camera_info")
    kinect = config("libgazebo_ros_openni_kinect.so", kind="depth")
    assert kinect.depth_topics == DepthTopics(
        "depth/image_raw", "depth/camera_info", "points", 0.4, 5.0, False, rows=True)
    full = config(
        "libgazebo_ros_openni_kinect.so",
        "<imageTopicName>rgb/i</imageTopicName><cameraInfoTopicName>rgb/c</cameraInfoTopicName>"
        "<depthImageTopicName>d/i</depthImageTopicName>"
        "<depthImageCameraInfoTopicName>d/c</depthImageCameraInfoTopicName>"
        "<pointCloudTopicName>d/p</pointCloudTopicName><pointCloudCutoff>.1</pointCloudCutoff>"
        "<pointCloudCutoffMax>3</pointCloudCutoffMax>"
        "<useDepth16UC1Format>true</useDepth16UC1Format>", kind="depth")
    assert full.depth_topics == DepthTopics("d/i", "d/c", "d/p", 0.1, 3.0, True)
    assert (full.image_topic, full.info_topic) == ("rgb/i", "rgb/c")
    near = config("libgazebo_ros_openni_kinect.so", "<pointCloudCutoff>0</pointCloudCutoff>"
                  "<pointCloudCutoffMax>.5</pointCloudCutoffMax>", kind="depth").depth_topics
    assert (near.nearest, near.farthest) == (0.0, 0.5)
    with pytest.raises(CameraError, match="depth_topics/points 'a b' is no name"):
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
    assert [eye.intrinsics().P[0, 3] for eye in made] == [
        0.0, pytest.approx(-0.07 * made[1].intrinsics().K[0, 0])]
