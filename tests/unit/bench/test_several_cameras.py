"""Several cameras of one experiment on every plant: different lenses, delays, rates and errors."""

from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_base.poses import (
    exponential,
    matrix_from_xyz_rpy,
    pose_difference,
    xyz_rpy_from_matrix,
)
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble, check

SHAPE = [[-0.025, -0.03], [0.03, -0.025], [0.025, 0.02], [-0.015, 0.025]]
# fx and fy differ, and the principal points are off the middle.
LEFT = {"width": 320, "height": 240, "update_rate": 30.0,
        "camera_matrix": {"fx": 300.0, "fy": 280.0, "cx": 166.0, "cy": 115.0}}  # fmt: skip
RIGHT = {"width": 336, "height": 256, "update_rate": 30.0,
         "camera_matrix": {"fx": 260.0, "fy": 290.0, "cx": 150.0, "cy": 125.0}}  # fmt: skip
SEATS = {"left": {"xyz": [0.01, 0.02, 0.0]},
         "right": {"xyz": [0.02, -0.03, 0.0], "rpy": [0.1, -0.03, 0.12]}}  # fmt: skip
GOAL = matrix_from_xyz_rpy((0.01, -0.02, -0.2), (0.05, -0.08, 0.3))
FAR = GOAL @ exponential((0.04, 0.03, -0.1, 0.1, 0.1, 0.4))
JOINTS, START = [0.05, 0.0, -0.09, 0.045, 0.045, 0.0], [0.03, 0.0, -0.05, 0.03, 0.03, 0.15]
BOTH = "points@left+points@right"


def posed(pose):
    xyz, rpy = xyz_rpy_from_matrix(pose)
    return {"pose": [*xyz, *rpy]}


def two(left=None, right=None, **more):
    return {"left": {"model": LEFT, **SEATS["left"], **(left or {})},
            "right": {"model": RIGHT, **SEATS["right"], **(right or {})}, **more}  # fmt: skip


def flying(**changes):
    return Experiment.from_mapping({
        "plant": "free", "features": "exact", "target": {"shape": SHAPE}, "goal": posed(GOAL),
        "start": posed(GOAL @ exponential((0.01, 0.005, -0.03, 0.02, 0.03, 0.2))),
        "duration": 8.0, "time_after_convergence": 0.0, "gain": 4.0, "scheme": BOTH,
        "cameras": two(), **changes})  # fmt: skip


def armed(**changes):
    return flying(**{
        "plant": "chain", "goal": JOINTS, "start": START, "target": {}, "features": "auto",
        **changes})  # fmt: skip


@pytest.mark.parametrize("scheme", ["points+points@right", "moments@left+area@right"])
def test_two_cameras_of_a_flying_rig_reach_their_goal(scheme):
    result = run(flying(scheme=scheme, features="images"))
    assert result.converged and result.verdict.is_reached, (result.outcome, result.reason)
    assert set(result.outcomes) <= {"running", result.outcome}
    assert result.compute_settling_time() < 1.0


@pytest.mark.parametrize(("plant", "features"), [("chain", "images"), ("bullet", "exact")])
def test_two_cameras_of_an_arm_reach_their_goal(plant, features):
    result = run(armed(plant=plant, features=features))
    assert result.outcome == "converged" and result.verdict.is_reached, result.reason
    right = result.cameras["right"]
    assert len(right.stamp) >= len(result.stamp) > 40
    distance, angle = pose_difference(result.pose[0], right.pose[0])
    assert 0.04 < distance < 0.07 and 0.1 < angle < 0.25


@pytest.mark.parametrize("right", [{"rate": 47.0}, {"rate": 7.0, "delay": 0.07}, {"delay": 0.25}])
def test_other_rates_and_delays_are_made_up_for(right):
    experiment = flying(cameras=two(right=right), gain=2.0 if "rate" in right else 1.0)
    result = run(experiment)
    assert result.outcome == "converged" and result.verdict.is_reached, result.reason
    assert "wrong_camera_model" not in result.outcomes
    rate = right.get("rate", 30.0)
    period = np.median(np.diff(result.cameras["right"].stamp))
    assert period == pytest.approx(1.0 / rate, abs=1e-8)
    late = result.cameras["right"].arrival - result.cameras["right"].stamp
    np.testing.assert_allclose(late, right.get("delay", 0.0), atol=1e-9)


def test_a_dictionary_of_one_camera_is_that_camera():
    off = {"focal": 1.1, "rpy": [0.0, 0.05, 0.1]}
    named = run(armed(cameras={"only": {"model": LEFT, "calibration_offset": off}},
                      scheme="points", duration=0.5))  # fmt: skip
    plain = run(armed(cameras={}, camera=LEFT, calibration_offset=off, scheme="points",
                      duration=0.5))  # fmt: skip
    assert list(named.cameras) == ["only"] and list(plain.cameras) == ["camera"]
    for name in ("stamp", "pose", "measured_positions", "joint_commands", "error"):
        np.testing.assert_array_equal(getattr(named, name), getattr(plain, name))


@pytest.mark.parametrize("plant", ["free", "chain", "bullet"])
def test_a_camera_s_seat_is_the_same_on_every_plant(plant):
    """In camera_link: x forward, y left, z up; so 5 cm to the right of the left camera."""
    parts = assemble(flying() if plant == "free" else armed(plant=plant))
    place = parts.placements["right"].pose
    parts.plant.close()
    np.testing.assert_allclose(place[:3, 3], [0.05, 0.0, 0.01], atol=1e-6)
    link_R_optical = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    turned = matrix_from_xyz_rpy((0, 0, 0), SEATS["right"]["rpy"])[:3, :3]
    np.testing.assert_allclose(place[:3, :3], link_R_optical.T @ turned @ link_R_optical, atol=1e-9)


def test_the_control_camera_is_the_first_that_the_scheme_reads():
    left, right = (assemble(flying(scheme=f"points@{name}")) for name in ("left", "right"))
    assert left.plant.camera.K[0] == 300.0 and right.plant.camera.K[0] == 260.0
    for parts, name in ((left, "left"), (right, "right")):
        assert list(parts.rig.observers) == [name] and parts.goal.camera_name == name
        np.testing.assert_allclose(parts.goal_pose, GOAL, atol=1e-12)
    assert run(flying(scheme="partitioned@right")).verdict.is_reached


PORTAL = Path(__file__).parents[3] / "docs" / "examples" / "portal.urdf"
CARRIED = [[-0.05, -0.03], [0.05, -0.03], [0.03, 0.04], [-0.05, 0.01]]
BESIDE = {"model": RIGHT, "pose": [0.15, 0.0, 1.0, 3.141592653589793, 0.15, 0.4]}


@pytest.fixture
def portal():
    return Experiment.from_mapping({
        "plant": "chain", "target": {"shape": CARRIED}, "scheme": "points@above+points@beside",
        "robot": {"urdf": str(PORTAL), "target_frame": "hand"}, "goal": [0.02, -0.03, 0.1, 0.3],
        "start": [0.1, 0.05, -0.02, -0.4], "time_after_convergence": 0.0,
        "cameras": {"above": {"model": LEFT, "pose": [0, 0, 1.0, 3.141592653589793, 0, 0.4]},
                    "beside": BESIDE}})  # fmt: skip


@pytest.mark.parametrize(("scheme", "features", "interaction"), [
    ("points@beside", "exact", "estimated"), ("points@above+points@beside", "images", "current")])
def test_cameras_that_stand_servo_the_arm_that_moves_their_target(
    portal, scheme, features, interaction):
    result = run(portal.with_changes(
        scheme=scheme, features=features, controller_parameters={"interaction": interaction}))
    assert result.outcome == "converged" and result.verdict.is_reached, result.reason
    np.testing.assert_allclose(result.measured_positions[-1], [0.02, -0.03, 0.1, 0.3], atol=3e-4)
    assert set(result.outcomes) == {"running", "converged"}


OVERVIEW = {"model": RIGHT, "rate": 10.0, "pose": [0.1, 0.0, 0.95, 3.14, 0.0, 0.0]}


@pytest.mark.parametrize("plant", ["free", "bullet"])
def test_a_camera_that_watches_changes_nothing_and_is_recorded(plant):
    make = flying if plant == "free" else armed
    options = {"plant": plant, "features": "exact", "jitter": 0.2, "duration": 0.7}
    alone = run(make(**options))
    watched = run(make(**options, cameras=two(overview=OVERVIEW)))
    np.testing.assert_array_equal(alone.measured_positions, watched.measured_positions)
    np.testing.assert_array_equal(alone.error, watched.error)
    seen = watched.cameras["overview"]
    assert len(seen.stamp) == pytest.approx(10.0 * watched.stamp[-1], abs=1)
    true = matrix_from_xyz_rpy(OVERVIEW["pose"][:3], OVERVIEW["pose"][3:])
    np.testing.assert_allclose(seen.pose, np.broadcast_to(true, seen.pose.shape), atol=1e-9)
    assert "overview" not in alone.cameras


@pytest.mark.parametrize(("name", "wrong"), [
    ("left", None), ("left", {"focal": 0.8}), ("left", {"xyz": [0.0, 0.05, 0.0]}),
    ("right", {"rpy": [0.0, 0.15, 0.0]})])
def test_the_camera_that_is_not_as_believed_is_named(name, wrong):
    cameras = two(**{name: {"calibration_offset": wrong or {}}})
    result = run(flying(start=posed(FAR), cameras=cameras, time_after_convergence=0.5))
    if wrong is None:
        assert set(result.outcomes) == {"running", "converged"}
        return
    assert "wrong_camera_model" in result.outcomes
    assert result.verdict.is_reached  # a goal that was shown is
    assert "but camera " in result.reason
    if "focal" in wrong or name == "right":
        assert f"but camera {name}: " in result.reason


@pytest.mark.parametrize(("changes", "words"), [
    ({"scheme": "points@rihgt"}, "reads the unknown camera 'rihgt': did you mean 'right'"),
    ({"cameras": two(right={"rpy": [0.0, 0.0, -0.9]})},
     "the target is in view of camera 'left', but not of camera 'right'; turn or move "
     "camera 'right'"),
    ({"goal": posed(GOAL @ exponential((0.5, 0.0, 0.0, 0.0, 0.0, 0.0)))},
     "the target is not in view of camera 'left'"),
    ({"cameras": two(right={"delay": 0.3})},
     "images of cameras 'left' and 'right' are never available together, because those of "
     "'right' arrive 0.3 s later"),
    ({"cameras": two(left={"delay": 0.5, "rate": 20}, right={"delay": 0.2})},
     "together, because those of 'left' arrive 0.3 s later, and only the last 8 images of "
     r"'right' \(0.267 s\) are stored"),
    ({"cameras": two(right={"rate": 0.12})},
     "camera 'right' delivers its first image after 8.33 s, but the run lasts only 8 s"),
    ({"cameras": two(right={"rpy": [0.0, 3.1, 0.0]})}, r"behind the camera.*\(camera 'right'\)"),
    ({"camera": "wide"}, "camera, hand_eye and calibration_offset cannot be combined"),
    ({"plant": "ideal"}, "plant 'ideal' has only one camera"),
    ({"cameras": two(right={"model": "wdie"})}, "'wdie' is no preset: did you mean 'wide'"),
    ({"cameras": two(right={"pose": [0.0] * 6})}, r"only one of pose \(in the world\), xyz"),
    ({"cameras": {"a b": {}}, "scheme": "points"}, "cameras: 'a b' is no valid name"),
    ({"cameras": {"wall": {"pose": [0, 0, 1, 3.14, 0, 0]}}, "scheme": "points"},
     "camera 'wall' is fixed in the world, and the arm does not move its target"),
    ({"cameras": two(wall={"pose": [0, 0, -0.5, 0, 0, 0]}), "scheme": f"{BOTH}+points@wall"},
     "camera 'wall' is fixed, and the arm does not move the camera's target"),
    ({"scheme": "kernel@left+points@right"}, "needs images: set features"),
    *(({"scheme": scheme}, "reads 2 cameras: name them, for example stereo_points@l")
      for scheme in ("stereo_points", "stereo_points@left")),
    ({"scheme": "stereo_pose@left,right",
      "cameras": {"left": {"model": LEFT}, "right": {"model": RIGHT}}},
     "cameras left and right are 0.0 mm apart, too close to measure depth")])  # fmt: skip
def test_what_cannot_be_is_refused_before_the_first_run(changes, words):
    with pytest.raises(ExperimentError, match=words) as told:
        experiment = flying(**changes)
        check(experiment)
        assemble(experiment)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(("scheme", "changes"), [
    ("stereo_points@left,right", {"cameras": two(left={"calibration_offset": {"depth": 1.6}})}),
    ("stereo_pose@right,left", {"features": "images", "cameras": two(right={"delay": 0.03})})])
def test_two_cameras_tell_the_depth(scheme, changes):
    result = run(flying(scheme=scheme, **changes))
    assert result.outcome.startswith("converged") and result.verdict.is_reached, result.reason
    assert "wrong_camera_model" not in result.outcomes
    assert result.compute_settling_time() < 1.0
