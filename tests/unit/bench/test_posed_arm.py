"""Arm at a given posture: collisions to the millimetre, and occlusion of the target."""

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.world_file import WorldFile
from aras_visual_servo_base.poses import matrix_from_xyz_rpy, relative_pose
from aras_visual_servo_bench.plants.static_arm import StaticArm
from aras_visual_servo_bench.targets.geometry import PlacedTarget, PolygonTarget
from aras_visual_servo_bench.targets.target_factory import make_target

BODY = ('<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" '
        'iyz="0"/></inertial>')
# Three slides carry a cube of 0.1 m, and below its middle a plate that is only seen.
TOOL = ('<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
        '<visual><origin xyz="0 0 -0.03"/><geometry><box size="0.1 0.1 0.01"/></geometry></visual>')
BLOCK = parse_urdf(
    '<robot name="block"><link name="b"><collision><origin xyz="2 0 0.5"/><geometry>'
    '<box size="0.4 0.4 1"/></geometry></collision><visual><origin xyz="0.55 0.25 0.7"/><geometry>'
    '<box size="0.4 0.4 0.01"/></geometry></visual></link></robot>')
FLAT = PolygonTarget(((-0.1, -0.05), (0.3, -0.05), (0.3, 0.15), (-0.1, 0.15)))
AT = matrix_from_xyz_rpy((0.5, 0.2, 0.6), (0.0, 0.0, 0.0))  # x 0.4 to 0.8, y 0.15 to 0.35


def slides():
    text, parent = '<robot name="g"><link name="world"/>', "world"
    for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")):
        text += (f'<link name="{name}_l">{BODY}{TOOL * (name == "z")}</link><joint name="{name}" '
                 f'type="prismatic"><parent link="{parent}"/><child link="{name}_l"/><axis '
                 f'xyz="{axis}"/><limit lower="-9" upper="9" velocity="1" effort="9"/></joint>')
        parent = f"{name}_l"
    return parse_urdf(f"{text}</robot>")


@pytest.fixture(scope="module")
def arm():
    around = WorldFile(ground_plane=True, models=(BLOCK,))
    return StaticArm(slides(), surroundings=around, target=PlacedTarget(FLAT, AT))


def placed(x, y, z):
    return {"x": x, "y": y, "z": z}


# A millimetre, of Bullet's margin, is none: 0.1 mm less and more than that.
@pytest.mark.parametrize(("free", "way", "other"), [
    ((0.6, 0.25, 0.6491), (0, 0, -1), "target"),  # from above: the top is at 0.6
    ((0.6, 0.25, 0.5499), (0, 0, 1), "target"),  # from below: it is a millimetre thick
    ((0.3509, 0.25, 0.6), (1, 0, 0), "target"), ((0.8491, 0.25, 0.6), (-1, 0, 0), "target"),
    ((0.6, 0.1009, 0.6), (0, 1, 0), "target"), ((0.6, 0.3991, 0.6), (0, -1, 0), "target"),
    ((0.3, 0.2, 0.0491), (0, 0, -1), "ground_plane"), ((1.7509, 0.1, 0.5), (1, 0, 0), "block")])
def test_what_it_runs_into_is_said_from_a_millimetre_on(arm, free, way, other):
    assert arm.find_collision(placed(*free)) == ""
    hit = np.array(free) + 2e-4 * np.array(way)
    assert arm.find_collision(placed(*hit)) == f"link 'z_l' of the arm is in '{other}'"


def test_a_solid_is_run_into_as_it_is_and_what_is_not_there_is_not():
    solid = PlacedTarget(make_target("cylinder", (0.2, 0.2, 0.3)),
                         matrix_from_xyz_rpy((0, 0, 1), (0, 0.2, 0)))  # fmt: skip
    alone = StaticArm(slides(), target=solid)
    assert alone.find_collision(placed(0.0, 0.0, 1.1))
    sky = StaticArm(slides(), surroundings=WorldFile(ground_plane=False))
    for arm, joints in ((alone, (0.14, 0.14, 1.0)), (alone, (0.3, 0.2, 0.0)),
                        (sky, (0.3, 0.2, 0.0)), (sky, (2.0, 0.0, 0.5))):  # no ground
        assert not arm.find_collision(placed(*joints))


def test_it_hides_the_share_that_the_shadow_of_its_plate_covers(arm):
    """The plate is 0.1 m wide, the eye 0.5 m above the target and askew beside it; what else is
    seen of the world, a sheet between them, hides nothing."""
    eye = matrix_from_xyz_rpy((0.45, 0.3, 1.1), (np.pi - 0.3, 0.1, 0.4))
    top, low = 0.9, 0.89  # of the plate, m; the eye sees its top and two of its sides
    part = arm.compute_occlusion(placed(0.5, 0.27, top + 0.025), eye, FLAT, AT)
    corners = [np.array([0.45, 0.3]) + (np.array([x, y]) - [0.45, 0.3]) * 0.5 / (1.1 - z)
               for z in (top, low) for x in (0.45, 0.55) for y in (0.22, 0.32)]
    low_x, low_y = np.maximum(np.min(corners, axis=0), [0.4, 0.15])
    high_x, high_y = np.minimum(np.max(corners, axis=0), [0.8, 0.35])
    flat = np.array([(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)])
    whole = np.array([(0.4, 0.15), (0.8, 0.15), (0.8, 0.35), (0.4, 0.35)])

    def area(rim):
        seen = (np.column_stack([rim, np.full(4, 0.6)]) - eye[:3, 3]) @ eye[:3, :3]
        x, y = (seen[:, :2] / seen[:, 2:]).T
        return abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))

    assert 0.2 < part == pytest.approx(area(flat) / area(whole), abs=0.05)
    behind = matrix_from_xyz_rpy((0.45, 0.3, 1.1), (0.0, 0.0, 0.0))
    assert arm.compute_occlusion(placed(0.5, 0.27, 0.9), behind, FLAT, AT) == 0.0


@pytest.mark.parametrize(("before", "near", "hides"), [
    (0.085, None, False), (0.105, None, True), (0.105, 0.13, False), (0.05, 0.01, True),
    # What lies within five millimetres of the target, 0.5 m before the camera, is the target.
    (0.4955, None, False), (0.4945, None, True)])
def test_what_is_nearer_than_the_camera_sees_is_not_drawn(arm, before, near, hides):
    eye = matrix_from_xyz_rpy((0.6, 0.25, 1.1), (np.pi, 0.0, 0.0))
    part = arm.compute_occlusion(placed(0.6, 0.25, 1.1 - before + 0.025), eye, FLAT, AT, near)
    assert (part > (0.05 if before > 0.4 else 0.3)) is hides


def test_a_target_that_the_arm_carries_is_seen_where_it_is():
    eye, link = (matrix_from_xyz_rpy((0.6, 0.25, 1.1), (np.pi, 0.1, 0.3)),
                 matrix_from_xyz_rpy((0.5, 0, 0), (0, 0, 0)))  # fmt: skip
    joints = placed(0.5, 0.22, 0.9)
    part = StaticArm(slides(), "x_l").compute_occlusion(
        joints, relative_pose(link, eye), FLAT, relative_pose(link, AT))
    alone = StaticArm(slides()).compute_occlusion(joints, eye, FLAT, AT)
    assert 0.1 < part == pytest.approx(alone, abs=1e-9)
