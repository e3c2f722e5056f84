"""Eye-in-hand and eye-to-hand cameras at once, each with its own target."""

import contextlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from frames import take_frames

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench import Experiment, assemble, run
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_controller.kinematics import Arm

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
ASKED = yaml.safe_load((EXAMPLES / "both_eyes.yaml").read_text())
PORTAL = (EXAMPLES / "portal.urdf").read_text()
# it leans, off the hand's origin
PLATE = {"shape": "l_shape", "size": [0.1, 0.07], "pose": [0.09, 0.1, 0.02, 0.1, -0.15, 0.3]}
BOTH, GOAL = ("palm", "left"), np.array(ASKED["goal"])


@pytest.fixture(autouse=True)
def _next_to_the_examples(monkeypatch):
    monkeypatch.chdir(EXAMPLES)


def asked(order=BOTH, left=None, **changes):
    cameras = {**ASKED["cameras"], "left": {**ASKED["cameras"]["left"], **(left or {})}}
    changes.setdefault("cameras", {name: cameras[name] for name in order})
    return Experiment.from_mapping({**ASKED, "gain": 4.0, "time_after_convergence": 0.0, **changes})


@pytest.mark.parametrize(("order", "scheme"), [
    (BOTH, "moments@left"), (BOTH, "points@palm+points@left"),
    (BOTH[::-1], "points@palm+points@left"), (BOTH[::-1], "points@left"),
])  # fmt: skip
def test_the_arm_comes_to_the_goal_by_either_and_by_both(order, scheme):
    result = run(asked(order, scheme=scheme, plant="chain", features="exact"))
    assert result.outcome == "converged" and result.verdict.is_reached, result.reason
    np.testing.assert_allclose(result.measured_positions[-1], GOAL, atol=2e-4)
    assert set(result.outcomes) == {"running", "converged"}


def test_poses_and_planes_are_those_before_each_cameras_own_target():
    keys = {"plant": "chain", "features": "exact"}
    result = run(asked(duration=0.5, time_after_convergence=0.1, **keys))
    at = 12  # the palm's picture is of the same stamp
    seen = result.cameras["left"]
    assert seen.stamp[at] == result.stamp[at]
    q = result.measured_positions[np.argmin(np.abs(result.joint_stamp - result.stamp[at]))]
    world_T_hand = Arm.from_urdf(PORTAL, "hand").pose(q)
    stands = Arm.find_fixed_pose(PORTAL, "left_optical_frame")
    np.testing.assert_allclose(world_T_hand @ seen.pose[at], stands, atol=5e-3)
    parts = assemble(asked(**keys))
    pose = Arm.from_urdf(PORTAL, "palm_optical_frame").pose(q)
    left = parts.placements["left"].compute_pose(pose)
    np.testing.assert_allclose(world_T_hand @ left, stands, atol=1e-12)
    turned = assemble(asked(BOTH[::-1], scheme="points@left", **keys))
    palm = turned.placements["palm"].compute_pose(np.linalg.inv(world_T_hand) @ stands)
    np.testing.assert_allclose(palm, pose, atol=1e-12)
    before = {"palm": parts.goal_pose,
              "left": parts.placements["left"].compute_pose(parts.goal_pose)}  # fmt: skip
    for name, goal in parts.goal.cameras.items():
        target = (parts.cameras[name].spec.target or asked().target).placed_target
        plane = target.shape.plane(target.target_T_camera(before[name]))
        np.testing.assert_allclose([*goal.plane], [*plane], atol=1e-9)
    depths = [goal.plane.C for goal in parts.goal.cameras.values()]
    assert abs(depths[0] - depths[1]) > 0.1


def take_picture(experiment):
    parts = assemble(experiment)
    with contextlib.closing(parts.plant) as plant:
        (picture,) = (one.image for one in take_frames(plant, 2) if one.name == "left")
    return parts, picture


def test_a_target_is_drawn_on_the_link_that_carries_it():
    (_, alone), (parts, drawn) = (
        take_picture(asked(start=[0.02, 0.05, -0.05, 0.2], left=left))
        for left in (None, {"target": PLATE})
    )
    changed = np.abs(drawn.astype(int) - alone).max(axis=2) > 100
    place = parts.placements["left"].compute_pose(parts.plant.read_rest_pose())
    shape = asked(left={"target": PLATE}).cameras["left"].target.placed_target.shape
    hand_T_plate = matrix_from_xyz_rpy(PLATE["pose"][:3], PLATE["pose"][3:])
    rim = shape.outline(np.linalg.inv(hand_T_plate) @ place)
    pixels = np.column_stack(parts.cameras["left"].true_camera.project(*rim.T))
    mask = cv2.fillPoly(np.zeros((240, 320), np.uint8), [np.round(pixels).astype(np.int32)], 255)
    found, wanted = np.array(np.nonzero(changed)), np.array(np.nonzero(mask))
    np.testing.assert_allclose(found.mean(axis=1), wanted.mean(axis=1), atol=0.5)
    assert found.shape[1] == pytest.approx(wanted.shape[1], rel=0.1)
    assert found.shape[1] > 0.3 * (alone.max(axis=2) < 60).sum()


def test_a_target_of_its_own_may_stand_too():
    beside = {"shape": "l_shape", "size": [0.1, 0.1], "pose": [0.19, -0.22, 0.001, 0, 0, -0.2]}
    second = {"model": {"width": 320, "height": 240, "horizontal_fov": 0.5},
              "xyz": [0.0, -0.2, 0.0], "target": beside}  # fmt: skip
    result = run(asked(
        cameras={"palm": ASKED["cameras"]["palm"], "second": second},
        robot={**ASKED["robot"], "camera_frame": "palm_optical_frame", "camera": "palm"},
        scheme="points@palm+points@second", start=[0.03, -0.01, 0.02, 0.25],
    ))  # fmt: skip
    assert result.outcome == "converged" and result.verdict.is_reached, result.reason


@pytest.mark.parametrize(("left", "changes", "words"), [
    ({"target": None}, {}, "cameras.left.target_frame needs a target on this link"),
    ({"target_frame": "hnd", "target": PLATE}, {}, "did you mean 'hand'"),
    ({"target_frame": "", "target": {**PLATE, "box": {"size": [0.1, 0.1, 0.1]}}}, {},
     "cameras.left.target may only have shape, size, pose and motion"),
    ({"target": {"shape": "marker"}}, {}, "needs the tracker 'marker'"),
    ({"target": PLATE}, {"plant": "free", "features": "exact"}, "left.target_frame is a link"),
    ({"target_frame": "", "target": PLATE}, {"scheme": "points@left"}, "'left' is fixed in the"),
    ({"target_frame": "y"}, {}, "point them at a target that this link carries"),
    ({}, {"controller_parameters": {"segmentation": {"method": "label", "label": "target"}}},
     "camera 'left' has its own"),
])  # fmt: skip
def test_what_cannot_be_is_one_line(left, changes, words):
    with pytest.raises(ExperimentError) as error:
        assemble(asked(left=left, **changes))
    assert words in str(error.value) and "\n" not in str(error.value)
