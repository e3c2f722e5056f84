"""Kinematics from the robot description, compared with Pinocchio's reading of the URDF.

Poses and Jacobians of arbitrary chains: test_kinematics.py.
"""

import numpy as np
import pinocchio
import pytest
from arms import NAMES, make, urdf, within

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_controller.errors import (
    ConfigurationError,
    MeasurementError,
    UnreachableError,
)
from aras_visual_servo_controller.kinematics import Arm

ARAS_JOINTS = ("gantry", "J1", "J2", "J3", "J5", "J6")


@pytest.fixture(scope="module", params=NAMES)
def arm(request):
    return make(request.param)


@pytest.mark.parametrize(("name", "frame"), [
    ("aras", "camera_optical_frame"), ("ur5", "tool0"), ("panda", "panda_hand_tcp"),
])  # fmt: skip
def test_pose_is_that_of_pinocchio_s_own_reader(name, frame):
    arm, text = make(name), urdf(name)
    model = pinocchio.buildModelFromXML(text)
    data, random = model.createData(), np.random.default_rng(3)
    for _ in range(10):
        q = within(arm, random)
        full = pinocchio.neutral(model)
        for joint, value in zip(arm.names, q, strict=True):
            full[model.joints[model.getJointId(joint)].idx_q] = value
        pinocchio.framesForwardKinematics(model, data, full)
        assert np.abs(data.oMf[model.getFrameId(frame)].homogeneous - arm.pose(q)).max() < 1e-12


def test_places_are_those_of_the_joints_from_the_base_on():
    q = np.array([[0.1, 0.2, 0.3, -0.4, 0.1, 0.5], [-0.2, 0.5, 1.0, 0.3, -0.6, 0.2]])
    turned = Arm.from_urdf(urdf("aras"), joints=ARAS_JOINTS[::-1])
    places = turned.joint_origins(q[:, ::-1])
    for found, posture in zip(places, q, strict=True):
        np.testing.assert_array_equal(found, make("aras").joint_frames(posture)[0])
    assert make("aras").joint_origins(q[:0]).shape == (0, 6, 3)


SENSOR = """<gazebo reference="{}"><sensor type="camera" name="c">{}<camera/></sensor></gazebo>"""
BODY = """<robot name="r"><link name="world"/><link name="camera_link"/>
<joint name="pan" type="continuous"><parent link="world"/><child link="camera_link"/>
<origin xyz="0 0 1"/></joint>{}</robot>"""
LOOKS_DOWN = "<pose>0.1 0 0 0 1.5707963267948966 0</pose>"


@pytest.mark.parametrize(("sensor", "frame", "axis"), [
    # A sensor looks along the +x of its pose, whatever the axes of its link are.
    (SENSOR.format("camera_link", ""), "camera_optical_frame", (1, 0, 0)),
    (SENSOR.format("camera_link", LOOKS_DOWN), "camera_optical_frame", (0, 0, -1)),
    (SENSOR.format("camera_link", LOOKS_DOWN), "camera_link", (0, 0, -1)),
    # Without one, what is named as the optical frame is it.
    ("", "camera_link", (0, 0, 1)), (SENSOR.format("world", ""), "camera_link", (0, 0, 1)),
    ("", "camera_optical_frame", None), (SENSOR.format("world", ""), "camera_optical_frame", None),
])  # fmt: skip
def test_a_camera_looks_where_its_sensor_or_its_optical_frame_does(sensor, frame, axis):
    if axis is None:
        words = "^[^\n]*link 'camera_link' carries no camera sensor[^\n]*set camera_frame[^\n]*$"
        with pytest.raises(ConfigurationError, match=words):
            Arm.from_urdf(BODY.format(sensor))
        return
    pose = Arm.from_urdf(BODY.format(sensor), frame).pose(np.zeros(1))
    np.testing.assert_allclose(pose[:3, 2], axis, atol=1e-12)
    np.testing.assert_allclose(pose[:3, 3], (0.1 if LOOKS_DOWN in sensor else 0, 0, 1), atol=1e-12)


EYE_TO_HAND = """<robot name="r"><link name="world"/><link name="camera_link"/><link name="stand"/>
<joint name="rail" type="prismatic"><parent link="world"/><child link="stand"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="pan" type="continuous"><parent link="stand"/><child link="camera_link"/>
  <origin xyz="0 0 1" rpy="0 1.2 0"/><axis xyz="0 0 2"/></joint>
<link name="arm"/><link name="hand"/>
<joint name="shoulder" type="revolute"><parent link="stand"/><child link="arm"/>
  <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="elbow" type="revolute"><parent link="arm"/><child link="hand"/>
  <origin xyz="0.4 0 0.1"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
""" + SENSOR.format("camera_link", "") + "</robot>"


def test_eye_to_hand_has_the_joints_between_camera_and_target():
    arm = Arm.from_urdf(EYE_TO_HAND, target_frame="hand")
    assert arm.names == ("rail", "pan", "shoulder", "elbow")
    assert arm.lower.tolist() == [-1.0, -np.inf, -2.0, -2.0]
    assert arm.upper.tolist() == [1.0, np.inf, 2.0, 2.0]
    assert arm.velocity.tolist() == arm.effort.tolist() == [1.0, np.inf, 1.0, 1.0]
    pan = EYE_TO_HAND.replace('0 0 2"/>', '0 0 2"/><limit lower="-1" upper="1" velocity="3"/>')
    endless = Arm.from_urdf(pan)
    assert (endless.lower[1], endless.upper[1]) == (-np.inf, np.inf)
    assert (endless.velocity[1], endless.effort[1]) == (3.0, np.inf)


def test_plausible_is_a_span_beyond_the_limits_or_many_turns():
    velocities = EYE_TO_HAND.replace('upper="2" velocity="1"', 'upper="2" velocity="0.5"', 1)
    arm = Arm.from_urdf(velocities.replace('"-1" upper="1" velocity="1"',
                                           '"-1" upper="1" velocity="3"'), target_frame="hand")
    assert arm.plausible_bounds.tolist() == [
        [-3.0, -1e4, -6.0, -6.0], [3.0, 1e4, 6.0, 6.0], [300.0, 1e6, 100.0, 100.0]
    ]  # fmt: skip
    arm.check(np.array([-2.9, -9000.0, 5.9, -5.9]), np.array([-299.0, 9e5, -99.0, 99.0]))
    for joint, name in enumerate(arm.names):
        for row, sign in ((0, 1.0), (1, 1.0), (2, 1.0), (2, -1.0)):
            measured = np.zeros((2, 4))
            measured[row // 2, joint] = 1.001 * sign * arm.plausible_bounds[row, joint]
            with pytest.raises(MeasurementError, match=f" of {name} is impossible"):
                arm.check(*measured)


def test_inverse_comes_back_to_the_pose(arm):
    random = np.random.default_rng(5)
    for _ in range(10):
        q = within(arm, random, 0.8)
        found = arm.inverse_kinematics(arm.pose(q), q + random.uniform(-0.2, 0.2, len(q)))
        distance, angle = pose_difference(arm.pose(found), arm.pose(q))
        assert distance < 1e-8 and angle < 1e-7
        assert (found >= arm.lower).all() and (found <= arm.upper).all()


def test_inverse_tells_how_far_beyond_reach_a_pose_is():
    arm = make("ur5")
    far = arm.pose(np.full(6, 0.3)).copy()
    far[:3, 3] *= 2.0 / np.linalg.norm(far[:3, 3])
    with pytest.raises(UnreachableError, match="out of the arm's reach") as caught:
        arm.inverse_kinematics(far, np.full(6, 0.3))
    assert 0.7 < caught.value.distance < 1.4
    with pytest.raises(ValueError, match="rigid"):
        arm.inverse_kinematics(2.0 * far, np.full(6, 0.3))
    nowhere = far.copy()
    nowhere[1, 3] = np.nan
    with pytest.raises(ValueError, match="rigid"):
        arm.inverse_kinematics(nowhere, np.full(6, 0.3))


def test_of_several_postures_the_cheapest_counts():
    arm = make("ur5")
    q = np.array([0.05, -0.8, 1.1, -0.7, 0.9, 0.1])
    tried = []

    def cost(joints):
        tried.append((1.0 + round(abs(joints[2] - 0.4) + abs(joints[4]), 1), joints))
        return tried[-1][0]

    found = arm.inverse_kinematics(arm.pose(q), q, cost=cost)
    costs = [one[0] for one in tried]
    assert costs.count(min(costs)) > 1 and len(set(costs)) > 1
    # Of those that cost the same, the one found first.
    np.testing.assert_array_equal(found, min(tried, key=lambda one: one[0])[1])


def test_sample_finds_joints_by_name():
    arm = make("aras")
    names = sorted(ARAS_JOINTS) + ["gripper"]
    values = dict(zip(names, np.arange(7.0) / 10, strict=True))
    sample = arm.read_joints(names, list(values.values()), [0.5] * 7, 2.5)
    assert sample.names == ARAS_JOINTS and sample.stamp == 2.5
    assert sample.positions.tolist() == [values[name] for name in ARAS_JOINTS]
    assert sample.velocities.tolist() == [0.5] * 6
    assert arm.read_joints(names, list(values.values())).velocities.tolist() == [0.0] * 6


@pytest.mark.parametrize(("names", "positions", "velocities", "words"), [
    (ARAS_JOINTS[:5], [0.0] * 5, (), "lack J6"),
    (ARAS_JOINTS, [0.0] * 5, (), "6 joint names but 5 positions"),
    (ARAS_JOINTS, [0.0] * 6, [0.0] * 5, "6 joint names but 5 velocities"),
    (ARAS_JOINTS, [0, 0, np.nan, 0, 0, 0], (), "position nan of J2 is"),
    (ARAS_JOINTS, [0, 0, 0, -7, 0, 0], (), "position -7 of J3 is"),
    (ARAS_JOINTS, [0.0] * 6, [0, 0, 0, 0, 0, 1e308], "speed 1e.308 of J6 is"),
    (ARAS_JOINTS, [0.0] * 6, [0, np.nan, 0, 0, 0, 0], "speed nan of J1 is"),
])  # fmt: skip
def test_measurements_that_cannot_be_are_refused(names, positions, velocities, words):
    with pytest.raises(MeasurementError, match=words):
        make("aras").read_joints(names, positions, velocities)


CHANGES = [  # more of what is wrong with a description: unit/description/test_urdf.py
    ("<?xml", "<robot", "URDF: line 1, column"),
    ("camera_optical_frame", "lens", "no link camera_optical_frame; use one of base_link, slider"),
    ('name="J5" type="revolute"', 'name="J5" type="floating"', "'J5' on the path .*'floating'"),
    ('lower="-3000" upper="3000"', 'lower="2" upper="2"', "'J6': lower limit 2 must be below"),
    ('<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0"/><mimic joint="J3"/>', "'J5' mimics another"),
]


@pytest.mark.parametrize(("old", "new", "words"), CHANGES, ids=[c[2] for c in CHANGES])
def test_what_is_wrong_with_a_description_is_said_in_a_line(old, new, words):
    text = urdf("aras")
    assert old in text
    if words.startswith("no link"):
        text = text.replace("camera_link", "body")
    with pytest.raises(ConfigurationError, match=words) as caught:
        Arm.from_urdf(text.replace(old, new))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("options", "words"), [
    ({"camera_frame": "camera_lnk"}, "no link camera_lnk; did you mean 'camera_link'"),
    ({"base_frame": "lnk2"}, "lnk2 is not an ancestor of .*; did you mean 'link2'"),
    ({"target_frame": "slidr"}, "did you mean 'slider'"),
    ({"joints": ("gantry", "J4")}, "no joint J4 moves the camera"),
    ({"joints": ("J1", "J1")}, "named twice"), ({"joints": ()}, "no joint moves the camera"),
    ({"camera_frame": "base_link"}, "base_link is the base itself"),
])  # fmt: skip
def test_names_that_are_not_there(options, words):
    with pytest.raises(ConfigurationError, match=words):
        Arm.from_urdf(urdf("aras"), **options)
