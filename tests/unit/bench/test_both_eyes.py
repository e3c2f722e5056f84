"""Eye-in-hand and eye-to-hand cameras at once, each with its own target.

The simulated arm does it by rendered pictures in docs/several_cameras.md.
"""

import contextlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from frames import take_frames

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_controller.kinematics import Arm

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
ASKED = yaml.safe_load((EXAMPLES / "both_eyes.yaml").read_text())
PORTAL = (EXAMPLES / "portal.urdf").read_text()
L = ASKED["cameras"]["left"]["target"]["shape"]
# Where the hand has room for it: it leans, off the hand's origin.
PLATE = {"shape": "l_shape", "size": [0.1, 0.07], "pose": [0.09, 0.1, 0.02, 0.1, -0.15, 0.3]}
BOTH, GOAL = ("palm", "left"), np.array(ASKED["goal"])


@pytest.fixture(autouse=True)
def _beside_the_examples(monkeypatch):
    monkeypatch.chdir(EXAMPLES)


def asked(order=BOTH, left=None, **changes):
    """The example, or with the cameras in another order, or with another left camera."""
    cameras = {**ASKED["cameras"], "left": {**ASKED["cameras"]["left"], **(left or {})}}
    changes.setdefault("cameras", {name: cameras[name] for name in order})
    return Experiment.from_mapping({**ASKED, "time_after_convergence": 0.0, **changes})


@pytest.mark.parametrize(("order", "scheme"), [
    (BOTH, "moments@left"), (BOTH, "points@palm+points@left"),
    (BOTH[::-1], "points@palm+points@left"), (BOTH[::-1], "points@left"),
])  # fmt: skip
def test_the_arm_comes_to_the_goal_by_either_and_by_both(order, scheme):
    result = run(asked(order, scheme=scheme, plant="chain", features="exact"))
    assert result.outcome == "converged" and result.verdict.is_reached, result.reason
    np.testing.assert_allclose(result.measured_positions[-1], GOAL, atol=2e-4)
    assert set(result.outcomes) == {"running", "converged"}


def test_poses_are_those_before_each_cameras_own_target():
    result = run(asked(plant="chain", features="exact", duration=0.5, time_after_convergence=0.1))
    at = 12  # the palm's picture is of the same stamp
    seen = result.cameras["left"]
    assert seen.stamp[at] == result.stamp[at]
    i = int(np.argmin(np.abs(result.joint_stamp - result.stamp[at])))
    q = result.measured_positions[i]
    world_T_hand = Arm.from_urdf(PORTAL, "hand").pose(q)
    stands = Arm.find_fixed_pose(PORTAL, "left_optical_frame")
    np.testing.assert_allclose(world_T_hand @ seen.pose[at], stands, atol=5e-3)
    parts = assemble(asked(plant="chain", features="exact"))
    pose = Arm.from_urdf(PORTAL, "palm_optical_frame").pose(q)
    np.testing.assert_allclose(
        world_T_hand @ parts.placements["left"].compute_pose(pose), stands, atol=1e-12
    )
    parts = assemble(asked(BOTH[::-1], plant="chain", features="exact", scheme="points@left"))
    np.testing.assert_allclose(
        parts.placements["palm"].compute_pose(np.linalg.inv(world_T_hand) @ stands),
        pose,
        atol=1e-12,
    )


@pytest.mark.parametrize("order", [("wall", "hand"), ("hand", "wall")])
def test_a_hand_camera_believed_elsewhere_beside_one_that_the_experiment_puts_somewhere(order):
    plate = {"shape": L, "pose": [-0.03, -0.09, 0.0, 0.0, -np.pi / 2, np.pi / 2]}
    cameras = {
        "wall": {"model": "calibrated", "pose": [0.55, 0.03, 0.88, -np.pi / 2, 0, np.pi / 2],
                 "target_frame": "camera_link", "target": plate},
        "hand": {"model": "wide", "calibration_offset": {"rpy": [0.0, 0.02, 0.03]}},
    }  # fmt: skip
    result = run(Experiment.from_mapping({
        "plant": "chain", "target": {"shape": L, "pose": [0, 0, 0.591, 0, 0, 0.2]}, "gain": 2.0,
        "cameras": {name: cameras[name] for name in order}, "start": "2016",
        "goal": [0.05, 0.1, 0.3, -0.35, 0.05, 0.1], "scheme": "points@hand+points@wall",
    }))  # fmt: skip
    assert result.verdict.is_reached, (result.outcome, result.reason)


def test_the_goal_has_the_plane_of_each_cameras_own_target():
    parts = assemble(asked(plant="chain", features="exact"))
    before = {
        "palm": parts.goal_pose,
        "left": parts.placements["left"].compute_pose(parts.goal_pose),
    }
    for name, goal in parts.goal.cameras.items():
        target = (parts.cameras[name].spec.target or asked().target).placed_target
        plane = target.shape.plane(target.target_T_camera(before[name]))
        np.testing.assert_allclose([*goal.plane], [*plane], atol=1e-9)
    depths = [goal.plane.C for goal in parts.goal.cameras.values()]
    assert abs(depths[0] - depths[1]) > 0.1


def first_pictures(experiment):
    parts = assemble(experiment)
    with contextlib.closing(parts.plant) as plant:
        found = {one.name: one.image for one in take_frames(plant, 2)}
    assert len(found) == 2
    return parts, found


def dark(picture):
    """Middle (column, row) of the dark pixels, and how many they are."""
    rows, columns = np.nonzero(picture.max(axis=2) < 60)
    return np.array([columns.mean(), rows.mean()]), len(rows)


def test_a_target_is_drawn_on_the_link_that_carries_it():
    """Beside the L that the robot has itself, and where the exact features say."""
    alone, drawn = (
        first_pictures(asked(start=[0.02, 0.05, -0.05, 0.2], left=left))
        for left in (None, {"target": PLATE})
    )
    _, before = dark(alone[1]["left"])
    changed = np.abs(drawn[1]["left"].astype(int) - alone[1]["left"]).max(axis=2) > 100
    rows, columns = np.nonzero(changed)
    parts = drawn[0]
    place = parts.placements["left"].compute_pose(parts.plant.read_rest_pose())
    shape = asked(left={"target": PLATE}).cameras["left"].target.placed_target.shape
    hand_T_plate = matrix_from_xyz_rpy(PLATE["pose"][:3], PLATE["pose"][3:])
    rim = shape.outline(np.linalg.inv(hand_T_plate) @ place)
    camera = parts.cameras["left"].true_camera
    pixels = np.column_stack(camera.project(*rim.T)).astype(np.float32)
    mask = cv2.fillPoly(np.zeros((240, 320), np.uint8), [np.round(pixels).astype(int)], 255)
    there = np.array(np.nonzero(mask)).mean(axis=1)
    assert len(rows) > 0.3 * before
    np.testing.assert_allclose([rows.mean(), columns.mean()], there, atol=0.5)
    assert len(rows) == pytest.approx(int((mask > 0).sum()), rel=0.1)


def test_a_target_of_its_own_may_stand_too():
    """Two cameras of one hand, each before another target on the ground."""
    beside = {"shape": "l_shape", "size": [0.1, 0.1], "pose": [0.19, -0.22, 0.001, 0, 0, -0.2]}
    second = {"model": {"width": 320, "height": 240, "horizontal_fov": 0.5},
              "xyz": [0.0, -0.2, 0.0], "target": beside}  # fmt: skip
    robot = {**ASKED["robot"], "camera_frame": "palm_optical_frame", "camera": "palm"}
    cameras = {"palm": ASKED["cameras"]["palm"], "second": second}
    experiment = asked(cameras=cameras, robot=robot, scheme="points@palm+points@second",
                       start=[0.03, -0.01, 0.02, 0.25])  # fmt: skip
    result = run(experiment)
    assert result.outcome == "converged" and result.verdict.is_reached, result.reason
    _, pictures = first_pictures(experiment)
    assert min(dark(picture)[1] for picture in pictures.values()) > 100


def test_an_arm_carries_a_target_that_is_not_part_of_its_description():
    """One camera that stands; the plate is put onto the hand."""
    robot = {**ASKED["robot"], "target_frame": "hand", "camera_frame": "left_optical_frame",
             "camera": "left"}  # fmt: skip
    result = run(Experiment.from_mapping({
        "robot": robot, "target": PLATE, "camera": ASKED["cameras"]["left"]["model"],
        "goal": ASKED["goal"], "start": ASKED["start"], "scheme": "points",
        "controller_parameters": {"segmentation": {"component": "nearest"}},
    }))  # fmt: skip
    assert result.verdict.is_reached, result.reason


CARRIED, STANDS = {"target": PLATE}, {"target_frame": "", "target": PLATE}


@pytest.mark.parametrize(
    ("left", "changes", "words"),
    [
        ({"target": None}, {}, "cameras.left.target_frame needs a target on this link"),
        ({"target_frame": "hnd", "target": PLATE}, {}, "did you mean 'hand'"),

        ({"target_frame": "", "target": {**PLATE, "box": {"size": [0.1, 0.1, 0.1]}}}, {},
         "cameras.left.target may only have shape, size, pose and motion"),
        ({"target": {"shape": "marker"}}, {}, "needs the tracker 'marker'"),
        (CARRIED, {"plant": "free", "features": "exact"}, "cameras.left.target_frame is a link"),
        (STANDS, {}, "camera 'left' is fixed in the world"),
        ({"target_frame": "y"}, {}, "point them at a target that this link carries"),
        ({}, {"controller_parameters": {"segmentation": {"method": "label", "label": "target"}}},
         "camera 'left' has its own"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_line(left, changes, words):
    scheme = "points@left" if "fixed in" in words else ASKED["scheme"]
    with pytest.raises(ExperimentError) as error:
        assemble(asked(left=left, scheme=scheme, **changes))
    assert words in str(error.value) and "\n" not in str(error.value)
