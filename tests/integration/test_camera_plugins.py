"""Cameras of Gazebo's other camera plugins on the graph: triggers, depth, point clouds, stereo."""

from __future__ import annotations

import time

import numpy as np
import pytest
import rospy
import sensor_msgs.point_cloud2
from ros_graph import wait_for
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Empty

DOWN = "0 0 1.5 0 1.5707963267948966 0"
EYE = """<camera name="{name}"><pose>0 {y} 0 0 0 0</pose><horizontal_fov>1.2</horizontal_fov><image>
  <width>{width}</width><height>48</height><format>{format}</format></image>
  <clip><near>0.05</near><far>9</far></clip></camera>"""


def sensor(name, kind, filename, settings="", eyes=("eye",), width=64, pixels="R8G8B8"):
    """A model above the box whose one sensor looks down."""
    cameras = "".join(EYE.format(name=eye, y=0.05 - 0.1 * i, width=width, format=pixels)
                      for i, eye in enumerate(eyes))
    return f"""<model name="{name}"><static>1</static><pose>{DOWN}</pose><link name="link">
      <sensor name="{name}" type="{kind}"><update_rate>20</update_rate>{cameras}
      <plugin name="p" filename="{filename}"><cameraName>{name}</cameraName>
      <frameName>{name}_frame</frameName>{settings}</plugin></sensor></link></model>"""


WORLD = f"""<sdf version="1.6"><world name="w">
<model name="box"><static>1</static><pose>0 0.2 0.25 0 0 0</pose><link name="l">
  <visual name="v"><geometry><box><size>0.4 0.4 0.5</size></box></geometry><material>
  <diffuse>1 0 0 1</diffuse></material></visual></link></model>
<include><uri>model://ground_plane</uri></include><include><uri>model://sun</uri></include>
{sensor("shot", "camera", "libgazebo_ros_triggered_camera.so",
        "<triggerTopicName>go</triggerTopicName>")}
{sensor("deep", "depth", "libgazebo_ros_depth_camera.so",
        "<imageTopicName>image_raw</imageTopicName><pointCloudCutoff>1.2</pointCloudCutoff>"
        "<cameraInfoTopicName>camera_info</cameraInfoTopicName>", pixels="B8G8R8")}
{sensor("kinect", "depth", "libgazebo_ros_openni_kinect.so",
        "<pointCloudCutoffMax>1.2</pointCloudCutoffMax>"
        "<useDepth16UC1Format>1</useDepth16UC1Format>")}
{sensor("stereo/camera", "multicamera", "libgazebo_ros_multicamera.so",
        "<hackBaseline>0.1</hackBaseline>", ("my_left", "my_right"))}
{sensor("pair", "multicamera", "libgazebo_ros_triggered_multicamera.so", "", ("left", "right"))}
</world></sdf>"""


@pytest.fixture(scope="module", autouse=True)
def machine(launch, ros_node, tmp_path_factory):
    path = tmp_path_factory.mktemp("plugins") / "cameras.world"
    path.write_text(WORLD)
    rospy.set_param("/gazebo/cameras/deep/hack_baseline", 0.25)
    return launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], world_name=path)


def of_one_stamp(*collectors):
    """Return one message of each collector, all with the same stamp."""

    def found():
        stamps = set.intersection(*({m.header.stamp for m in c.messages} for c in collectors))
        return max(stamps) if stamps else None

    stamp = wait_for(found, 20.0, "messages of one stamp")
    return [next(m for m in c.messages if m.header.stamp == stamp) for c in collectors]


def test_a_triggered_camera_sends_one_picture_for_each_trigger(collect, machine):
    images, infos = collect("/shot/image_raw", Image), collect("/shot/camera_info", CameraInfo)
    trigger = rospy.Publisher("/shot/go", Empty, queue_size=10)
    wait_for(lambda: trigger.get_num_connections() and images.connected(), 10.0, "connections")
    time.sleep(1.0)
    assert not images.messages
    trigger.publish()
    wait_for(lambda: len(images.messages) == 1, 10.0, "a picture")
    for _ in range(2):
        trigger.publish()
    wait_for(lambda: len(images.messages) == 3, 10.0, "two more")
    time.sleep(0.5)
    stamps = [m.header.stamp for m in images.messages]
    assert len(set(stamps)) == 3 and [m.header.stamp for m in infos.messages] == stamps


@pytest.mark.parametrize("name", ["deep", "kinect"])
def test_a_cloud_is_its_depth_picture_s(collect, name):
    topics = {"image_raw" if name == "deep" else "ir/image_raw": Image, "depth/image_raw": Image,
              "depth/camera_info": CameraInfo, "points": PointCloud2}
    image, depth, info, cloud = of_one_stamp(
        *(collect(f"/{name}/{topic}", kind) for topic, kind in topics.items()))
    assert {m.header.frame_id for m in (image, depth, info, cloud)} == {f"{name}_frame"}
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        ("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 16, 7, 1)]
    assert (cloud.point_step, cloud.is_bigendian, cloud.is_dense) == (32, False, False)
    rows, columns = (1, 64 * 48) if name == "deep" else (48, 64)
    assert (cloud.height, cloud.width, cloud.row_step) == (rows, columns, 32 * columns)
    if name == "deep":
        assert depth.encoding == "32FC1"
        metres = np.frombuffer(depth.data, np.float32).reshape(48, 64)
    else:
        assert depth.encoding == "16UC1"
        metres = np.frombuffer(depth.data, np.uint16).reshape(48, 64) / 1000.0
        metres = np.where(metres > 0, metres, np.nan)
    points = np.array(list(sensor_msgs.point_cloud2.read_points(
        cloud, ("x", "y", "z"), skip_nans=False))).reshape(48, 64, 3)
    # Beyond 1.2 m the one sees the ground, below it the other one sees the box.
    assert np.nanmedian(metres) == pytest.approx(1.5 if name == "deep" else 1.0, abs=1e-4)
    assert 100 < np.isnan(metres).sum() < 64 * 48 - 100
    K = np.array(info.K).reshape(3, 3)
    v, u = np.mgrid[:48, :64]
    expected = np.dstack([(u - K[0, 2]) / K[0, 0] * metres, (v - K[1, 2]) / K[1, 1] * metres,
                          metres])
    np.testing.assert_allclose(points, expected, atol=2e-6 if name == "deep" else 6e-4)
    colours = np.frombuffer(cloud.data, np.uint8).reshape(48, 64, 32)[..., 16:19]
    pixels = np.frombuffer(image.data, np.uint8).reshape(48, 64, 3)
    assert np.array_equal(colours, pixels if image.encoding == "bgr8" else pixels[..., ::-1])


def test_parameters_are_laid_over_the_cameras_of_a_world_file(collect):
    info = collect("/deep/camera_info", CameraInfo).wait(1, 20.0)
    assert info.P[3] == pytest.approx(-0.25 * info.P[0])


def test_both_eyes_see_one_instant(collect):
    root = "/stereo/camera"
    found = of_one_stamp(*(collect(f"{root}/{side}/{name}", kind) for side in ("left", "right")
                           for name, kind in (("image_raw", Image), ("camera_info", CameraInfo))))
    assert {m.header.frame_id for m in found} == {"stereo/camera_frame"}
    left, right = found[1], found[3]
    assert left.P[3] == 0.0 and right.P[3] == pytest.approx(-0.1 * right.P[0])


def test_one_trigger_is_for_both_eyes(collect):
    eyes = [collect(f"/pair/{side}/image_raw", Image) for side in ("left", "right")]
    trigger = rospy.Publisher("/pair/right/image_trigger", Empty, queue_size=10)
    wait_for(lambda: trigger.get_num_connections() and all(eye.connected() for eye in eyes), 10.0,
             "connections")
    time.sleep(0.5)
    assert not any(eye.messages for eye in eyes)
    trigger.publish()
    wait_for(lambda: all(eye.messages for eye in eyes), 10.0, "a picture of each eye")
    time.sleep(0.5)
    left, right = ([m.header.stamp for m in eye.messages] for eye in eyes)
    assert left == right and len(left) == 1


def test_nothing_waits_for_triggers_but_the_cameras_that_have_one():
    subscribed = [topic for topic, _ in rospy.get_master().getSystemState()[2][1]]
    assert {topic for topic in subscribed if "trigger" in topic or topic.endswith("/go")} == {
        "/shot/go", "/pair/left/image_trigger", "/pair/right/image_trigger"}
