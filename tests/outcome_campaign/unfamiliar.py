"""Kinds of trials with random targets, arms and lenses."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

import numpy as np

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.setup.assembly import assemble

from .kinds import changed, kind, on_one_axis, turned
from .scenes import ARMS, Changes, Draw, flying, lens, on_arm

SIX = ("points", "numbered_points", "segments", "lines", "pose", "points_3d", "two_and_half_d")
BY_IMAGES = ("points", "segments", "pose")
SCHEMES = "outcome_campaign.schemes:"
SPATIAL = ("offset_6r", "redundant_7r", "gantry_6")  # arms that turn the camera about any axis


def loop(random: Draw, keys: Changes, schemes: tuple[str, ...] = SIX) -> Changes:
    """Add a scheme, a gain that is stable with the delay and image rate, and a duration."""
    rate = keys["camera"].get("update_rate", 30.0)
    delay = float(random.uniform(0.0, 0.03))
    gain = float(random.uniform(0.8, min(3.0, 0.25 / (delay + 1.0 / rate))))
    return {**keys, "features": keys.get("features", "exact"), "delay": round(delay, 4),
            "scheme": str(random.choice(schemes)), "gain": round(gain, 3),
            "time_after_convergence": 0.3,
            "duration": round(8.0 + 14.0 / gain, 1)}  # fmt: skip


def any_arm(random: Draw, names: tuple[str, ...] = tuple(ARMS), schemes: tuple[str, ...] = SIX
            ) -> Changes:  # fmt: skip
    """Return a run of one of the arms without faults."""
    camera = lens(random)
    return loop(random, on_arm(random, str(random.choice(names)), camera), schemes)


def moving(random: Draw, keys: Changes, least: float, most: float) -> Changes:
    """Let the target move at a speed between these, m/s, in any direction."""
    velocity = random.normal(size=3)
    velocity *= random.uniform(least, most) / np.linalg.norm(velocity)
    keys["target"]["motion"] = {"velocity": [*velocity.tolist(), 0.0, 0.0, 0.0]}
    return keys


def either(random: Draw, schemes: tuple[str, ...] = SIX) -> Changes:
    """Return a run of a free camera or of an arm without faults."""
    if random.random() < 0.5:
        return loop(random, flying(random, lens(random)), schemes)
    return any_arm(random, schemes=schemes)


# -- no fault -------------------------------------------------------------------------------


changed("any_attitude", ("converged",), lambda random: loop(random, flying(random, lens(random))),
        "No fault; a free camera at random poses, exact features.", faults=0)


@kind("converged", faults=0)
def any_attitude_by_pictures(random: Draw) -> Changes:
    """No fault; a free camera at random poses, images."""
    keys = flying(random, lens(random), pixels=(70, 120))
    return loop(random, {**keys, "features": "images"}, BY_IMAGES)


changed("long_lens", ("converged", "ambiguous"),
        lambda random: loop(random, flying(random, lens(random, (0.16, 0.4)), lean=1.0)),
        "A field of view of 9 to 23 degrees, with which a flat target looks nearly the same from "
        "two poses.", faults=0)
changed("fisheye", ("converged",),
        lambda random: loop(random, flying(random, lens(random, (2.0, 3.0), fisheye=True))),
        "An equidistant lens with a field of view of 115 to 170 degrees.", faults=0)


@kind("converged", faults=0)
def slow_and_fast_images(random: Draw) -> Changes:
    """5 to 8 or 90 to 120 images per second."""
    camera = lens(random)
    fast = random.random() < 0.5
    camera.keys["update_rate"] = float(random.uniform(90, 120) if fast else random.uniform(5, 8))
    keys = flying(random, camera) if random.random() < 0.5 else on_arm(
        random, str(random.choice(list(ARMS))), camera)  # fmt: skip
    return loop(random, keys)


changed("triangle", ("converged", "ambiguous"), lambda random: loop(
            random, flying(random, lens(random), corners=3),
            ("points", "numbered_points", "lines")),
        "Three points or three lines, which have the same image from up to four poses.", faults=0)


@kind("converged", "ambiguous", faults=0)
def solid(random: Draw) -> Changes:
    """A box in images, tracked by the edges of its model; it looks the same after half a turn."""
    keys = flying(random, lens(random, (0.6, 1.1)), thickness=0.5, pixels=(80, 120), lean=0.6)
    return loop(random, {**keys, "features": "images"}, ("model",))


changed("unfamiliar_arm", ("converged",), any_arm,
        "No fault; an arm of four, six or seven joints, exact features.", faults=0)
changed("unfamiliar_arm_by_noisy_pictures", ("converged", "too_noisy"),
        lambda random: any_arm(random, schemes=BY_IMAGES),
        "An arm of four, six or seven joints, images with noise of 1 to 4 grey levels.", faults=0,
        features="images", noise=(1.0, 4.0))


# -- a target that moves -------------------------------------------------------------------------


@kind("target_moves", "converged")
def slow_target(random: Draw) -> Changes:
    """A target that moves at a constant 0.5 to 8 mm/s; `converged` is correct if the error is
    within the bound."""
    keys = moving(random, either(random), 0.5e-3, 8e-3)
    return {**keys, "duration": min(keys["duration"], 12.0)}


@kind("target_moves", "converged")
def slowly_swinging_target(random: Draw) -> Changes:
    """A target that oscillates with an amplitude of 2 to 8 mm at 0.1 to 0.3 Hz."""
    keys = either(random)
    keys["target"]["motion"] = {"amplitude": random.uniform(0.002, 0.008, 3).tolist(),
                                "frequency": float(random.uniform(0.1, 0.3))}  # fmt: skip
    return keys


@kind("target_moves", "converged")
def slowly_turning_target(random: Draw) -> Changes:
    """A target that rotates at 0.5 to 4 degrees per second."""
    keys = either(random)
    rate = float(np.radians(random.uniform(0.5, 4.0)))
    keys["target"]["motion"] = {"velocity": [0.0, 0.0, 0.0, 0.0, 0.0, rate]}
    return {**keys, "duration": min(keys["duration"], 12.0)}


# -- a camera that is not as believed ------------------------------------------------------------


@kind("wrong_camera_model", "refused")
def turned_mounting(random: Draw) -> Changes:
    """A hand-eye calibration that is wrong by 90 to 180 degrees; refused if the target would be
    behind the camera at the goal."""
    keys = any_arm(random, SPATIAL)
    turn = float(random.uniform(0.5, 1.0) * np.pi)
    return {**keys, "calibration_offset": {"rpy": on_one_axis(turn, random.choice(3))}}


@kind("converged", "wrong_camera_model")
def mounting_somewhat_off(random: Draw) -> Changes:
    """A taught goal; the hand-eye calibration is wrong by 2 to 30 degrees or 5 to 60 mm."""
    keys, axis = any_arm(random, SPATIAL), random.choice(3)
    if random.random() < 0.5:
        turn = float(np.radians(random.uniform(2.0, 30.0)))
        return {**keys, "calibration_offset": {"rpy": on_one_axis(turn, axis)}}
    offset = float(random.uniform(0.005, 0.06))
    return {**keys, "calibration_offset": {"xyz": on_one_axis(offset, axis)}}


@kind("wrong_camera_model", "converged")
def computed_goal_and_wrong_focal_length(random: Draw) -> Changes:
    """A goal computed for the true camera; the calibrated focal length is 1.3 to 1.8 times the true
    one. `converged` is correct if the error is within the bound."""
    keys = either(random)
    factor = float(random.uniform(1.3, 1.8) ** random.choice([-1, 1]))
    return {**keys, "goal": computed_goal(keys), "calibration_offset": {"focal": factor}}


def computed_goal(keys: Changes) -> str:
    """Path of a goal file, computed for an experiment's camera as it is."""
    parts = assemble(Experiment.from_mapping(keys))
    try:
        text = parts.goal.to_yaml("computed")
    finally:
        parts.plant.close()
    folder = Path(tempfile.gettempdir()) / "aras_outcome_goals"
    folder.mkdir(exist_ok=True)
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


# -- the view, the arm, the loop -----------------------------------------------------------------


@kind("target_lost", "wrong_object")
def covered_from_a_moment_on(random: Draw) -> Changes:
    """During the run, 20 to 70 % of the target is covered permanently."""
    keys = loop(random, flying(random, lens(random), pixels=(80, 120)), ("points", "moments"))
    corners = np.array(keys["target"]["shape"])
    low, high = corners.min(axis=0), corners.max(axis=0)
    edge = low[0] + random.uniform(0.2, 0.7) * (high[0] - low[0])
    begin = float(random.uniform(0.3, 1.0))
    keys["target"] |= {"occluder": [[float(low[0]) - 1e-3, float(low[1]) - 1e-3],
                                    [float(edge), float(high[1]) + 1e-3]],
                       "occluded": [[begin, 60.0]]}  # fmt: skip
    return {**keys, "features": "images"}


@kind("joint_limit", "converged", "singular")
def limit_of_an_unfamiliar_arm(random: Draw) -> Changes:
    """One joint has a limit between its start and its goal; the other joints may compensate."""
    keys = any_arm(random, ("scara", "offset_6r", "gantry_6"))
    start, goal = np.array(keys["start"]), np.array(keys["goal"])
    i = int(np.argmax(np.abs(goal - start)))
    limit = float(goal[i] - 0.3 * (goal[i] - start[i]))
    side = "upper" if goal[i] > start[i] else "lower"
    return {**keys, "controller_parameters": {side: {f"q{i + 1}": limit}}}


@kind("gain_too_high", "converged")
def too_high_for_the_delay(random: Draw) -> Changes:
    """A delay of 0.1 to 0.4 s and a gain of 0.9 to 1.8 times its reciprocal."""
    keys = either(random)
    delay = float(random.uniform(0.1, 0.4))
    return {**keys, "delay": delay, "gain": float(random.uniform(0.9, 1.8)) / delay,
            "duration": 14.0}  # fmt: skip


changed("jitter_of_any_size", ("converged", "too_noisy"), either, "Exact features with noise of "
        "0.1 to 3 px.", jitter=lambda random: float(10.0 ** random.uniform(-1.0, 0.5)))


@kind("saturation", "converged")
def slow_joints(random: Draw) -> Changes:
    """An arm of four, six or seven joints with velocity limits of 2 to 40 mrad/s."""
    speed = float(10.0 ** random.uniform(-2.7, -1.4))
    return {**any_arm(random), "controller_parameters": {"max_velocity": speed}, "duration": 8.0}


# -- two faults at once --------------------------------------------------------------------------


changed("moving_target_and_high_gain", ("target_moves", "gain_too_high"),
        lambda random: moving(random, either(random), 0.01, 0.04),
        "A target that moves at 10 to 40 mm/s, and a gain that is too high for the delay.",
        faults=2, delay=0.25, gain=(5.0, 7.0), duration=6.0)
changed("mounting_off_and_jitter", ("wrong_camera_model", "too_noisy", "converged"),
        lambda random: any_arm(random, SPATIAL),
        "A hand-eye calibration that is wrong by 5 to 25 degrees, and noise of 0.3 to 2 px.",
        faults=2, calibration_offset=lambda random: turned(random, 5.0, 25.0), jitter=(0.3, 2.0))


@kind("target_moves", "wrong_camera_model", "converged", faults=2)
def moving_target_and_mounting_off(random: Draw) -> Changes:
    """A target that moves at 3 to 20 mm/s, and a hand-eye calibration that is wrong by 5 to 25
    degrees."""
    keys = moving(random, any_arm(random, SPATIAL), 0.003, 0.02)
    turn = float(np.radians(random.uniform(5.0, 25.0)))
    return {**keys, "calibration_offset": {"rpy": [turn, 0.0, 0.0]}}


@kind("saturation", "joint_limit", "converged", "singular", faults=2)
def slow_joints_and_a_limit(random: Draw) -> Changes:
    """Slow joints, one of which cannot reach its goal."""
    keys = limit_of_an_unfamiliar_arm(random)
    limits = {**keys["controller_parameters"],
              "max_velocity": float(10.0 ** random.uniform(-2.5, -1.2))}  # fmt: skip
    return {**keys, "controller_parameters": limits, "duration": 10.0}


# -- schemes that a start is too far for -------------------------------------------------------


@kind("target_lost", "camera_retreat", "local_minimum", "no_progress", "timed_out", "ambiguous",
      "gain_too_high", "converged")
def scheme_leads_astray(random: Draw) -> Changes:
    """A turn of 80 to 180 degrees, which a scheme of points or moments, or L at the goal, is not
    made for: the camera goes far aside or away, and neither it nor the target is at fault."""
    scheme = str(random.choice(["numbered_points", "partitioned", "moments_six", "points_3d"]))
    kinds = ("current",) if scheme == "partitioned" else ("current", "desired", "mean")
    interaction = str(random.choice(kinds))
    plants = [{"plant": "free", "features": "images"}, {"plant": "ideal", "features": "exact",
              "ideal": {"speed": [1.0, 1.5], "unbounded": True}}]  # fmt: skip
    options = {} if interaction == "current" else {"interaction": interaction}
    return {
        **plants[int(random.integers(2))], "scheme": scheme, "controller_parameters": options,
        "camera": {"width": 320, "height": 240, "horizontal_fov": 0.761, "update_rate": 25.0},
        "target": {"shape": [[-0.1, -0.1], [0.1, -0.08], [0.08, 0.1], [-0.06, 0.06]]},
        "goal": {"pose": [0.0, 0.0, -0.6, 0.0, 0.0, 0.0]}, "gain": 2.0, "duration": 6.0,
        "start": {"kind": "turned", "angle": float(random.uniform(80.0, 180.0)),
                  "scatter": [0.01, 2.0]},
    }  # fmt: skip


# -- schemes of users ----------------------------------------------------------------------------


@kind("scheme_fault", "converged")
def scheme_fails_now_and_then(random: Draw) -> Changes:
    """A feature that is NaN, raises an exception or changes its length in one of five images;
    `converged` with a reason that counts these images is correct, too."""
    name = random.choice(["NowAndThenNotFinite", "NowAndThenRaises", "NowAndThenShorter"])
    return {**either(random), "scheme": f"{SCHEMES}{name}"}


@kind("scheme_fault")
def scheme_hangs(random: Draw) -> Changes:
    """A scheme that never finishes an image: it computes, sleeps or waits."""
    keys = either(random)
    name = random.choice(["Hanging", "Sleeping", "Waiting"])
    options = {**keys.get("options", {}), "scheme_timeout": 0.5}
    return {**keys, "scheme": f"{SCHEMES}{name}", "controller_parameters": options}


changed("wrong_sign_of_L", ("scheme_fault",), either, "Points whose interaction matrix has the "
        "wrong sign, so that the camera moves away from its goal.", scheme=f"{SCHEMES}WrongSign")
changed("constant_feature", ("scheme_fault",), either, "An error that never changes, regardless of "
        "the motion of the camera.", scheme=f"{SCHEMES}Constant")
changed("jumping_feature", ("scheme_fault",), either, "Points to which 0.3 is added or not, in "
        "rapid alternation.", scheme=f"{SCHEMES}Jumping")


@kind("scheme_fault", "ambiguous", "wrong_object", "wrong_camera_model")
def goal_read_wrongly(random: Draw) -> Changes:
    """The target's centre and size, one of which is compared with a wrong value of the goal."""
    name = random.choice(["SwappedGoal", "CentredGoal", "SizeGoal"])
    return {**either(random), "scheme": f"{SCHEMES}{name}"}
