"""Cameras of the shipped robot and of a file on the graph, and a user's target below them."""

import math

import cv2
import numpy as np
import pytest
import rospy
import yaml
from gazebo_calls import call
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import GetModelProperties, GetModelState, SetModelState
from ros_graph import wait_for, wait_for_message
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

CAMERA = "/labrob/camera"
TABLE = 0.59
OUTLINE = '<svg><polygon points="0,0 60,0 60,20 20,20 20,60 0,60"/></svg>'
SIZE = 0.06  # m
DOWN = [0.09, 0.0, 0.75, 0.0, math.pi / 2, 0.0]  # beside the arm's camera, looking down
SMALL = {"parent": "world", "pose": DOWN, "width": 64, "height": 48, "horizontal_fov": 1.6,
         "near": 0.05}
WORLD = {"lab": {"deep": {**SMALL, "depth": True, "segmentation": True}},
         "fish": {**SMALL, "lens": "equidistant", "horizontal_fov": 3.5}}


@pytest.fixture(scope="module", autouse=True)
def machine(launch, ros_node, tmp_path_factory):
    """The shipped robot with its calibrated camera, moved in its link, cameras of the world, and
    an outline as a target."""
    folder = tmp_path_factory.mktemp("cameras")
    path, outline = folder / "world.yaml", folder / "mine.svg"
    outline.write_text(OUTLINE)
    moved = {"xyz": [0.02, 0.0, 0.0], "optical_frame_name": "camera_mounted_optical_frame"}
    others = {"labrob": {"camera": moved}, "typo": {"camera": {"width": 10}}}
    path.write_text(yaml.safe_dump({**WORLD, **others}))
    rospy.set_param("/lab/deep/tf_prefix", "robot_1")
    launched = launch("aras_visual_servo_gazebo", "aras_visual_servo_gazebo.launch",
                      nodes=["/gazebo"], camera="calibrated", world_cameras=path, target=outline,
                      target_size=f"{SIZE} {SIZE}", target_place="-x 0 -y 0 -z 0.591 -Y 0.5")
    wait_for(lambda: "belong to no camera" in launched.output(), 20.0, "the robot")
    wait_for(lambda: "spawned entity 'target'" in launched.output(), 20.0, "the target")
    return launched


def test_camera_info_tells_the_lens():
    fish = wait_for_message("/fish/camera_info", CameraInfo)
    assert (fish.distortion_model, len(fish.D)) == ("equidistant", 4)
    assert fish.K[0] == pytest.approx(64 / 3.5)
    calibrated = wait_for_message(f"{CAMERA}/camera_info", CameraInfo)
    assert calibrated.K[0] == 195.0507
    assert list(calibrated.D) == [-0.33060, 0.1170, 0, 0, 0]
    # hackBaseline 0.07 of the URDF
    assert calibrated.P[3] == pytest.approx(-195.0507 * 0.07)


def test_depth_and_segmentation():
    depth = wait_for_message("/lab/deep/depth/image_raw", Image)
    assert (depth.encoding, depth.step) == ("32FC1", 256)
    metres = np.frombuffer(depth.data, np.float32)
    assert metres[4 * 64 + 4] == pytest.approx(0.75 - TABLE, abs=1e-3)
    info = wait_for_message("/lab/deep/depth/camera_info", CameraInfo)
    assert info.header.frame_id == "robot_1/lab_deep_optical_frame"
    labelled = wait_for_message("/lab/deep/segmentation/image_raw", Image)
    assert labelled.encoding == "32SC1"
    names = yaml.safe_load(wait_for_message("/lab/deep/segmentation/labels", String).data)
    seen = {names[n] for n in np.unique(np.frombuffer(labelled.data, np.int32)).tolist() if n >= 0}
    assert {"aras_visual_servo::base_link", "target::target"} <= seen


def test_frames_of_cameras_without_urdf_are_on_tf_static():
    name = "camera_mounted_optical_frame"
    message = wait_for_message("/tf_static", TFMessage,
                               where=lambda m: name in [t.child_frame_id for t in m.transforms])
    frames = {t.child_frame_id: t for t in message.transforms}
    moved = frames[name]
    assert moved.header.frame_id == "camera_link"
    assert moved.transform.translation.x == pytest.approx(0.02)
    q = moved.transform.rotation
    assert [abs(v) for v in (q.x, q.y, q.z, q.w)] == pytest.approx([0.5] * 4)
    down = frames["fish_optical_frame"].transform
    assert down.translation.z == 0.75
    q = down.rotation  # z of the optical frame points down: x-y rotation by pi
    assert 1 - 2 * (q.x**2 + q.y**2) == pytest.approx(-1.0)
    image = wait_for_message(f"{CAMERA}/image_raw", Image)
    assert image.header.frame_id == "camera_mounted_optical_frame"


def look() -> tuple[np.ndarray, float]:
    """Return the centre (2,) and the area of what is dark on the table, without distortion, in a
    plane at a distance of 1 m."""
    info = wait_for_message(f"{CAMERA}/camera_info", CameraInfo)
    message = wait_for_message(f"{CAMERA}/image_raw", Image)
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, -1)
    pixels = np.argwhere(cv2.cvtColor(rows, cv2.COLOR_RGB2GRAY) < 100)[:, ::-1]
    K, D = np.reshape(info.K, (3, 3)), np.array(info.D)
    at, right, below = (cv2.undistortPoints((pixels + step)[:, None].astype(float), K, D)[:, 0]
                        for step in ((0, 0), (1, 0), (0, 1)))  # fmt: skip
    x, y = (right - at).T, (below - at).T
    return at.mean(axis=0), float((x[0] * y[1] - x[1] * y[0]).sum())


def test_an_outline_on_the_launch_line_lies_on_the_table_and_can_be_moved():
    robot = call("get_model_properties", GetModelProperties, "aras_visual_servo")
    assert not any("planar_object" in name for name in robot.body_names)
    # The L, which covers 5/9 of its square, is 0.191 m below the camera of the URDF.
    depth = 0.191 - 0.02
    before, area = look()
    assert area == pytest.approx(5 / 9 * (SIZE / depth) ** 2, rel=0.05)
    moved = ModelState(model_name="target", reference_frame="world")
    moved.pose = call("get_model_state", GetModelState, "target", "").pose
    assert abs(moved.pose.position.z - 0.591) < 1e-9
    moved.pose.position.x += 0.02
    assert call("set_model_state", SetModelState, moved).success
    way = np.linalg.norm(look()[0] - before)
    assert way == pytest.approx(0.02 / depth, abs=0.003)
