"""Large rotations: a scheme converges, or reports the cause and a remedy, and nothing untrue."""

import numpy as np
import pytest

from aras_visual_servo_bench import Experiment, run
from aras_visual_servo_controller.features.base import wrap_together
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.schemes import SCHEMES, create_scheme

CORNERS = [[-0.1, -0.1], [-0.1, 0.09], [0.1, 0.1], [0.07, -0.1]]
PICTURED = {Need.IMAGE, Need.KERNEL}
EXACT = [name for name in SCHEMES if name not in ("model", "stereo_points", "stereo_pose")
         and not create_scheme(name).needs & PICTURED]  # fmt: skip
STRAIGHT = ("pose", "two_and_half_d", "polar_points", "lines", "segments", "theta_u")


def turned(scheme, angle, corners=CORNERS, **options):
    return run(Experiment.from_mapping({
        "plant": "free", "features": "exact", "scheme": scheme, "gain": 4.0, "duration": 2.5,
        "camera": {"width": 640, "height": 480, "horizontal_fov": 1.2},
        "target": {"shape": corners}, "goal": {"pose": [0, 0, 0.6, np.pi, 0, 0]},
        "start": {"pose": [0, 0, 0.6, np.pi, 0, angle]},
        "controller_parameters": {"hold": 0.25, **options},
    }))  # fmt: skip


@pytest.mark.parametrize(("scheme", "angle"), [
    *((name, np.pi) for name in EXACT),
    *zip(STRAIGHT, (-np.pi, np.pi - 1e-9) * 3, strict=True),
])  # fmt: skip
def test_a_half_turn_is_a_turn_or_what_is_said_of_it_is_true(scheme, angle):
    result = turned(scheme, angle)
    if angle != np.pi:
        assert result.verdict.angle < 0.005, (result.outcome, result.reason)
    elif result.outcome == "converged":
        modelled = create_scheme(scheme).feature.directions
        assert result.verdict.angle < 0.01 or not all(modelled[3:])
    elif result.outcome in ("camera_retreat", "local_minimum", "singular"):
        assert any(name in result.remedy for name in ("polar_points", "pose"))


@pytest.mark.parametrize(("angle", "corners"), [
    (np.pi, CORNERS), (np.pi, [[-0.1, -0.1], [-0.1, 0.1], [0.1, 0.1], [0.1, -0.1]]),
    (3.0, CORNERS), (np.pi - 1e-6, CORNERS),
])  # fmt: skip
def test_l_mean_turns_by_no_more_than_the_gain_asks_or_says_that_it_loses_the_turn(angle, corners):
    result = turned("numbered_points", angle, corners=corners, interaction="mean")
    lost = result.outcome == "target_lost" and "interaction to mean" not in result.remedy
    if angle == np.pi:
        assert result.verdict.is_reached or lost or "two_and_half_d" in result.remedy
    else:
        assert result.verdict.angle < 0.005, (result.outcome, result.reason)
        speeds = [np.linalg.norm(state.desired_twist[3:]) for state in result.states]
        assert max(speeds) < 4.0 * np.pi + 1e-6


@pytest.mark.parametrize("period", [2.0 * np.pi, np.pi])
def test_angles_of_one_turn_are_wrapped_to_one_side(period):
    half = 0.5 * period
    for turn in (half, -half, half - 1e-9, 1e-9 - half, 0.9 * half, 0.0):
        spread = turn + np.array([0.1, -0.1, 0.02, 0.0])
        found = wrap_together((spread + half) % period - half, period)
        np.testing.assert_allclose(found - found[3], spread - turn, atol=1e-12)
        assert np.abs(found).max() <= half + 0.1 + 2e-6


@pytest.mark.parametrize("degrees", [177.5, 179.9])
def test_a_retreat_without_end_is_not_taken_for_an_occlusion(degrees):
    result = run(Experiment.from_mapping({
        "plant": "free", "features": "exact", "scheme": "points", "gain": 2.0, "duration": 10.0,
        "target": {"shape": [[-0.03, -0.024], [0.03, -0.03], [0.021, 0.027], [-0.018, 0.018]],
                   "pose": [0, 0, 0.59, 0, 0, 0]},
        "goal": {"pose": [0, 0, 0.86, np.pi, 0, 0]}, "time_after_convergence": 0.3,
        "start": {"pose": [0, 0, 0.86, np.pi, 0, np.radians(degrees)]},
    }))  # fmt: skip
    assert result.verdict.distance > 1e4, "the camera did not retreat far enough for this test"
    assert result.outcome in ("camera_retreat", "target_lost"), (result.outcome, result.reason)
    assert "covered" not in result.reason


TASK = {
    "camera": {"width": 320, "height": 240, "horizontal_fov": 0.761, "update_rate": 25.0},
    "target": {"shape": [[-0.1, -0.1], [0.1, -0.08], [0.08, 0.1], [-0.06, 0.06]]},
    "goal": {"pose": [0, 0, -0.6, 0, 0, 0]}, "gain": 2.0, "duration": 2.0,
}  # fmt: skip
PICTURES = {"plant": "free", "features": "images"}
FLOWN = {"plant": "ideal", "features": "exact",
         "ideal": {"speed": [1.0, 1.5], "unbounded": True}}  # fmt: skip


@pytest.mark.parametrize(("scheme", "interaction", "turn", "seed", "plant"), [
    ("numbered_points", "desired", 180.0, 7, PICTURES),
    ("partitioned", "current", 90.0, 0, PICTURES),
    ("moments_six", "desired", 180.0, 1, PICTURES),
    ("moments_six", "mean", 180.0, 3, PICTURES),
    ("moments_six", "current", 180.0, 3, FLOWN),
    ("moments_six", "desired", 180.0, 11, FLOWN),
])  # fmt: skip
def test_nothing_untrue_is_said_of_camera_and_target(scheme, interaction, turn, seed, plant):
    options = {"hold": 0.4} | ({} if interaction == "current" else {"interaction": interaction})
    result = run(Experiment.from_mapping({
        **TASK, **plant, "scheme": scheme, "controller_parameters": options, "seed": seed,
        "start": {"kind": "turned", "angle": turn, "scatter": [0.01, 2.0]},
    }))  # fmt: skip
    said = " ".join([result.outcome, result.reason, *(state.reason for state in result.states)])
    for untrue in ("wrong_camera_model", "wrong_object", "covered the target", "the target moved",
                   "is not the goal's target", "do not move as L"):  # fmt: skip
        assert untrue not in said, said
