"""A camera in the hand and a fixed camera in front of the hand: effect of the arm on both."""

from dataclasses import replace

import numpy as np
import pytest
from loop_rig import the_goal

from aras_visual_servo_base.poses import logarithm, relative_pose
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import Arm, CameraModel, FeatureObserver, Goal, JointSample, Need
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.observation import camera_rig
from aras_visual_servo_controller.settings import ControllerSettings

# A slide, two unlike turns, and frames that lean: the wall camera stands, the palm's is in the
# hand, and the plate is on the hand beside it.
ROBOT = """<robot name="both"><link name="world"/>
<link name="a"/><link name="b"/><link name="hand"/><link name="plate"/>
<link name="palm_optical_frame"/><link name="wall_optical_frame"/>
<link name="elbow_optical_frame"/>
<joint name="slide" type="prismatic"><parent link="world"/><child link="a"/><axis xyz="0 1 0"/>
  <origin xyz="0.1 0 0.3" rpy="0.2 0 0"/>
  <limit lower="-1" upper="1" velocity="1" effort="9"/></joint>
<joint name="turn" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
  <origin xyz="0 0.1 0.2"/><limit lower="-3" upper="3" velocity="1" effort="9"/></joint>
<joint name="lean" type="revolute"><parent link="b"/><child link="hand"/><axis xyz="1 0 0"/>
  <origin xyz="0.2 0 0" rpy="0 0.1 0"/><limit lower="-3" upper="3" velocity="1" effort="9"/></joint>
<joint name="p" type="fixed"><parent link="hand"/><child link="plate"/>
  <origin xyz="0.02 -0.03 0.05" rpy="0.3 -0.2 0.1"/></joint>
<joint name="e" type="fixed"><parent link="hand"/><child link="palm_optical_frame"/>
  <origin xyz="0 0.04 -0.02" rpy="3.0 0.1 0.4"/></joint>
<joint name="w" type="fixed"><parent link="world"/><child link="wall_optical_frame"/>
  <origin xyz="1.1 0.3 0.7" rpy="-1.4 0.1 1.3"/></joint>
<joint name="o" type="fixed"><parent link="b"/><child link="elbow_optical_frame"/>
  <origin xyz="0.1 0 0.1" rpy="0.1 0.2 0.3"/></joint>
</robot>"""
PALM, WALL = Arm.from_urdf(ROBOT, "palm_optical_frame"), Arm.from_urdf(
    ROBOT, "wall_optical_frame", target_frame="plate")  # fmt: skip
Q = np.array([0.13, -0.4, 0.25])
K = (300.0, 0.0, 150.0, 0.0, 280.0, 130.0, 0.0, 0.0, 1.0)
CAMERA = CameraModel(320, 240, K, (), "plumb_bob")
SQUARE = np.array([[-0.1, -0.05], [0.1, -0.06], [0.08, 0.07], [-0.1, 0.1]])
FAR = Plane(0.1, -0.2, 2.0)


def rig(control, other, moved_by):
    return camera_rig.CameraRig([FeatureObserver(control, frozenset({Need.CORNERS}), name="first"),
                FeatureObserver(moved_by, frozenset({Need.CORNERS}), name="second",
                         compute_plane=lambda pose: FAR)])  # fmt: skip


def together(control, other, q):
    moved_by = camera_rig.make_camera_kinematics(ROBOT, control, other, "second")
    made, joints = rig(control, other, moved_by), JointSample.from_values(1.0, PALM.names, q)
    first, second = (observer.observe_exact_features(1.0, CAMERA, joints, contour=SQUARE)
                     for observer in made.observers.values())  # fmt: skip
    return made.merge_observations(first, {"second": second})


@pytest.mark.parametrize(("control", "other"), [(PALM, WALL), (WALL, PALM)], ids=["palm", "wall"])
def test_its_pose_is_before_its_own_target_and_it_stands_before_the_controls(control, other):
    seen = together(control, other, Q).other_cameras["second"]
    twist, own = control.jacobian(Q), other.jacobian(Q)
    np.testing.assert_allclose(seen.twist_from_control @ twist, own, atol=1e-12)
    assert np.abs(own).max() > 0.3  # there is a motion to speak of
    moved_by = camera_rig.make_camera_kinematics(ROBOT, control, other, "second")
    assert isinstance(moved_by, camera_rig.InverseCameraKinematics)
    for q in (Q, -2.0 * Q):
        np.testing.assert_allclose(moved_by.pose(q), other.pose(q), atol=1e-12)
        world_T_plate = Arm.from_urdf(ROBOT, "plate").pose(q)
        world_T_second = other.pose(q) if other is PALM else world_T_plate @ other.pose(q)
        there = world_T_second if control is PALM else relative_pose(world_T_plate, world_T_second)
        np.testing.assert_allclose(moved_by.fixed_pose, there, atol=1e-12)


def test_what_it_has_moved_since_its_exposure_is_its_own_motion():
    bound = rig(PALM, WALL, camera_rig.make_camera_kinematics(ROBOT, PALM, WALL, "second"))
    then = Q - [0.01, 0.02, -0.03]
    second, first = (
        observer.observe_exact_features(
            stamp, CAMERA, JointSample.from_values(stamp, PALM.names, q), contour=SQUARE)
        for observer, stamp, q in ((bound.observers["second"], 0.98, then), (bound.control, 1.0, Q))
    )  # fmt: skip
    moved = bound.merge_observations(first, {"second": second}).other_cameras["second"]
    np.testing.assert_allclose(
        moved.motion_since_exposure, logarithm(relative_pose(WALL.pose(then), WALL.pose(Q))))


def test_a_goal_keeps_each_cameras_own_plane():
    observation = together(PALM, WALL, Q)
    goal = Goal.teach(None, observation, depth=0.5)
    assert goal.other_cameras["second"].plane == FAR
    known = replace(goal, target=the_goal("2016").target)
    for control, other, names in ((PALM, WALL, ["first", "second"]),
                                  (WALL, PALM, ["second", "first"])):  # fmt: skip
        moved_by = camera_rig.make_camera_kinematics(ROBOT, control, other, names[1])
        fitted = known.for_cameras(dict(zip(names, (control, moved_by), strict=True)))
        assert list(fitted.cameras) == names and fitted.target is known.target
        np.testing.assert_allclose(fitted.world_T_camera, control.pose(Q), atol=1e-12)
        there = fitted.other_cameras[names[1]].world_T_camera
        np.testing.assert_allclose(there, other.pose(Q), atol=1e-12)
    assert fitted.plane == FAR and fitted.other_cameras["first"].plane == goal.for_arm(PALM).plane
    np.testing.assert_allclose(
        goal.other_cameras["second"].world_T_camera, WALL.pose(Q), atol=1e-12)
    second = replace(observation.other_cameras["second"], plane=None)  # which nothing tells
    with pytest.raises(ConfigurationError, match="camera second has its own target"):
        Goal.teach(None, replace(observation, other_cameras={"second": second}), depth=0.5)


# -- as the node's parameters say it -----------------------------------------------------------
def settings(first):
    cameras = {"palm": {"namespace": "/palm"}, "wall": {"target_frame": "plate"}}
    order = [first, *(name for name in cameras if name != first)]
    return ControllerSettings.from_mapping({
        "scheme": "points@palm+points@wall", "cameras": {name: cameras[name] for name in order},
    })  # fmt: skip


@pytest.mark.parametrize("first", ["palm", "wall"])
def test_a_nodes_cameras_say_which_link_carries_what_they_look_at(first):
    asked = settings(first)
    arm = asked.make_arm(ROBOT)
    links = {"palm": "", "wall": "plate"}
    assert arm.target_frame == links[first]
    ((name, moved_by),) = asked.make_other_cameras(ROBOT, arm).items()
    assert name == {"palm": "wall", "wall": "palm"}[first]
    assert isinstance(moved_by, camera_rig.InverseCameraKinematics)
    np.testing.assert_allclose(moved_by.pose(Q), {"palm": PALM, "wall": WALL}[name].pose(Q))
    # A camera without a link of its own has that of all.
    assert {name: asked.get_camera(name).target_frame for name in links} == links
    one = ControllerSettings.from_mapping({"scheme": "points", "target_frame": "plate"})
    assert one.get_camera("camera").target_frame == "plate"


@pytest.mark.parametrize(("control", "frame", "link", "words"), [
    (PALM, "wall_optical_frame", "b", "is moved by slide, turn and the control camera by"),
    (PALM, "elbow_optical_frame", "plate", "elbow_optical_frame and its target plate"),
    (WALL, "wall_optical_frame", "hand", "is on hand and that of the control camera on plate"),
])  # fmt: skip
def test_what_cannot_be_is_said(control, frame, link, words):
    other = Arm.from_urdf(ROBOT, frame, target_frame=link)
    with pytest.raises(ConfigurationError, match=words):
        camera_rig.make_camera_kinematics(ROBOT, control, other, "second")
