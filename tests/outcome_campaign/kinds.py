"""Kinds of injected faults, each with the correct outcomes, defined before the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Draw = np.random.Generator
Changes = dict[str, Any]

# Position of the target: on the table of the Bullet arm, and the same for the other plants.
TABLE = (0.0, 0.0, 0.591)
PLANTS = ("chain", "chain", "free", "bullet")
DOWN = np.pi  # roll of a camera that looks at the table
# Corners of outlines without symmetry, relative to their size. Below a width of 17 px only three
# corners of the last outline are detected, which look the same from several poses.
OUTLINES = (
    ((-0.5, -0.4), (0.5, -0.5), (0.35, 0.45), (-0.3, 0.3)),
    ((-0.5, -0.3), (0.4, -0.5), (0.5, 0.5), (-0.15, 0.2)),
    ((-0.5, -0.5), (0.5, -0.45), (0.1, -0.1), (-0.2, 0.5)),
)  # fmt: skip


@dataclass(frozen=True)
class Event:
    """Event during a run, `at` s after its first image: "hold", "stop", "joints_end" (joint states
    end), "images_end" or "joints_stick"."""

    what: str
    at: float


@dataclass(frozen=True)
class Trial:
    """One run, and its correct outcomes; 'converged' includes 'converged up to ...'."""

    kind: str
    number: int
    keys: Mapping[str, Any]
    right: tuple[str, ...]
    event: Event | None = None


@dataclass(frozen=True)
class Kind:
    """Kind of fault: random experiments and their correct outcomes.

    faults: number of faults injected in one run. alike: True if the target looks the same from
    several poses, so that images cannot distinguish them.
    """

    name: str
    draw: Callable[[Draw], Changes]
    right: tuple[str, ...]
    event: Callable[[Draw], Event] | None = None
    faults: int = 1
    alike: bool = False
    text: str = field(default="", compare=False)

    def trial(self, seed: int, number: int) -> Trial:
        """Return the trial with a number; equal seeds give equal trials."""
        random = np.random.default_rng([seed, number, *self.name.encode()])
        keys = {"seed": int(random.integers(2**31)), **self.draw(random)}
        event = None if self.event is None else self.event(random)
        return Trial(self.name, number, keys, self.right, event)


KINDS: dict[str, Kind] = {}


def kind(
    *right: str, event: Callable[[Draw], Event] | None = None, faults: int = 1, alike: bool = False
) -> Callable[[Callable[[Draw], Changes]], Callable[[Draw], Changes]]:
    """Register a function that draws the keys of an experiment as a kind."""

    def register(draw: Callable[[Draw], Changes]) -> Callable[[Draw], Changes]:
        name = draw.__name__
        KINDS[name] = Kind(name, draw, right, event, faults, alike, (draw.__doc__ or "").strip())
        return draw

    return register


def changed(name: str, right: tuple[str, ...], base: tuple[str, ...] | Callable[[Draw], Changes],
            text: str, event: tuple[str, float, float] | None = None, faults: int = 1,
            alike: bool = False, **keys: Any) -> None:  # fmt: skip
    """Register a kind whose runs are those of `base` (plants of `healthy` runs, or a function) with
    other keys: values, functions of the generator, or the ends of a range to draw from.

    event: what happens, and the range of its time.
    """
    def draw(random: Draw) -> Changes:
        made = base(random) if callable(base) else healthy(random, base)
        for key, value in keys.items():
            ends = isinstance(value, tuple)
            made[key] = float(random.uniform(*value)) if ends else (
                value(random) if callable(value) else value)  # fmt: skip
        return made

    draw.__name__, draw.__doc__ = name, text
    happens = event and (lambda random: Event(event[0], random.uniform(*event[1:])))
    kind(*right, event=happens, faults=faults, alike=alike)(draw)


# -- parts of experiments -----------------------------------------------------------


def sampler(random: Draw, height: tuple[float, float] = (0.2, 0.32)) -> Changes:
    """Return random starts from which the target is visible."""
    return {"height": list(height), "side": random.uniform(0.02, 0.05),
            "turn": random.uniform(0.2, 0.8)}  # fmt: skip


def placed(
    random: Draw, shape: Any = None, size: float | None = None, outlines: int = len(OUTLINES)
) -> Changes:
    """Return a target at a random pose on the table; without `shape` it has no symmetry."""
    size = float(random.uniform(0.05, 0.08)) if size is None else size
    if shape is None:
        outline = OUTLINES[random.integers(outlines)]
        shape = [[size * x, size * y] for x, y in outline]
    x, y = random.uniform(-0.02, 0.02, 2)
    return {"shape": shape, "size": [size, size],
            "pose": [float(x), float(y), TABLE[2], 0.0, 0.0, float(random.uniform(-0.5, 0.5))]}


def goal_above(random: Draw, leans: bool = False) -> Changes:
    """Return a camera pose above the centre of the table, at which the goal is taught.

    leans: tilt the optical axis by 8 to 16 degrees. Poses with a vertical optical axis are singular
        for the arm: its first and last joint rotate the camera about the same axis, and no joint
        about its y axis (the smallest singular value of the Jacobian is 0.003).
    """
    x, y = random.uniform(-0.01, 0.01, 2)
    height = random.uniform(0.24, 0.3)
    lean = float(np.radians(random.uniform(8.0, 16.0)) * random.choice([-1, 1])) if leans else 0.0
    return {"pose": [float(x), float(y - height * np.tan(lean)), float(TABLE[2] + height),
                     DOWN + lean, 0.0, 0.0]}  # fmt: skip


def healthy(random: Draw, plants: tuple[str, ...] = PLANTS,
            schemes: tuple[str, ...] = ("points", "moments", "segments", "pose"),
            own: bool = False) -> Changes:  # fmt: skip
    """Return a run without faults; with `own`, its target is not the default one.

    If an arm controls all six directions, the goal is tilted and the target is large enough to
    measure the tilt.
    """
    plant, scheme = str(random.choice(plants)), str(random.choice(schemes))
    keys: Changes = {"plant": plant, "scheme": scheme, "start": sampler(random), "duration": 12.0,
                     "time_after_convergence": 0.3, "gain": float(random.uniform(1.5, 3.0))}
    leans = plant != "free" and scheme != "moments"
    if own or leans or scheme not in ("points", "moments") or random.random() < 0.5:
        size = float(random.uniform(0.09, 0.12)) if leans else None
        keys |= {"target": placed(random, size=size), "goal": goal_above(random, leans)}
    return keys


def on_one_axis(value: float, axis: int) -> list[float]:
    """Return x, y, z of a vector along one axis."""
    return [value if i == axis else 0.0 for i in range(3)]


def turned(random: Draw, least: float, most: float) -> Changes:
    """Return a hand-eye calibration that is wrong by so many degrees about a random axis."""
    turn = float(np.radians(random.uniform(least, most)))
    return {"rpy": on_one_axis(turn, random.choice(3))}


def pictured(random: Draw, **given: Any) -> Changes:
    """Return a run without faults that uses images, by default without the scheme `pose`."""
    given.setdefault("schemes", ("points", "moments", "segments"))
    return {**healthy(random, **given), "features": "images"}


# -- no fault -----------------------------------------------------------------------------


changed("exact_features", ("converged",), lambda random: healthy(
            random, ("chain", "free"), ("points", "moments", "segments", "lines", "pose")),
        "No fault; exact features of any scheme.", faults=0, features="exact")  # fmt: skip
changed("pictures", ("converged",), pictured, "No fault; images.", faults=0)
changed("noisy_pictures", ("converged", "too_noisy"), pictured, "Images with noise of 1 to 5 grey "
        "levels, which is too much for six directions on some targets.", faults=0, noise=(1.0, 5.0))
changed("jittered_features", ("converged", "too_noisy"), ("chain", "free"),
        "Exact features with noise of 0.05 to 0.3 px, which is too much for the pose of a small "
        "target.", faults=0, features="exact", jitter=(0.05, 0.3))


@kind("converged", "too_noisy", faults=0)
def small_target(random: Draw) -> Changes:
    """A target of 25 to 45 mm in images, ten to twenty pixels wide, with errors from its few
    pixels."""
    keys = pictured(random, plants=("free",))
    if random.random() < 0.5:
        keys |= {"plant": str(random.choice(["chain", "bullet"])), "scheme": "moments"}
    return {**keys, "goal": goal_above(random),
            "target": placed(random, size=float(random.uniform(0.025, 0.045)), outlines=2)}


@kind("converged", faults=0)
def marker_target(random: Draw) -> Changes:
    """Schemes of points or pose, a marker of 7 to 10 cm, images with little noise."""
    keys = pictured(random, schemes=("points", "pose"), own=True)
    return {**keys, "target": placed(random, "marker", float(random.uniform(0.07, 0.1))),
            "noise": float(random.uniform(0.0, 2.0))}  # fmt: skip


changed("wrong_depth", ("converged",), ("chain", "free"),
        "A calibrated depth of 0.6 to 1.6 times the true depth.",
        calibration_offset=lambda random: {"depth": float(random.choice([0.6, 0.75, 1.3, 1.6]))})


@kind("converged", faults=0)
def rate_known(random: Draw) -> Changes:
    """A target that moves at 30 mm/s, and a scheme that compensates this motion."""
    return {
        "plant": str(random.choice(["chain", "free"])), "features": "exact",
        "scheme": "outcome_campaign.schemes:Following",
        "target": {**placed(random), "motion": {"velocity": [0.03, 0, 0, 0, 0, 0]}},
        "goal": goal_above(random), "start": sampler(random), "duration": 6.0,
        "time_after_convergence": 0.5, "gain": 3.0,
    }  # fmt: skip


# -- calibration errors of the camera ----------------------------------------------------------


@kind("converged")
def goal_shown_by_wrong_focal(random: Draw) -> Changes:
    """A taught goal; the calibrated focal length is wrong by 5 to 30 %."""
    focal = float(random.choice([0.8, 0.95, 1.05, 1.15, 1.3]))
    return {**pictured(random, own=True), "calibration_offset": {"focal": focal}}


changed("goal_shown_by_wrong_centre", ("converged",), lambda random: pictured(random, own=True),
        "A taught goal; the calibrated principal point is wrong by 10 px.",
        calibration_offset=lambda random: {"centre": [float(random.choice([-10, 10])), 6.0]})
changed("goal_shown_by_wrong_mounting", ("converged", "wrong_camera_model"), ("chain", "bullet"),
        "A taught goal; the hand-eye calibration is wrong by 3 to 8 degrees.",
        calibration_offset=lambda random: turned(random, 3.0, 8.0))


@kind("wrong_camera_model")
def goal_of_another_camera(random: Draw) -> Changes:
    """A goal computed for the true camera; the calibrated focal length is 1.5 to 1.7 times the true
    one."""
    return {"plant": "chain", "features": "images", "scheme": "moments", "duration": 8.0,
            "goal": "2016", "start": sampler(random), "time_after_convergence": 0.3,
            "calibration_offset": {"focal": float(random.uniform(1.5, 1.7))}}  # fmt: skip


@kind("converged", "wrong_camera_model")
def camera_turned_in_its_mount(random: Draw) -> Changes:
    """A taught goal; the hand-eye calibration is wrong by 35 to 50 degrees about the optical
    axis."""
    keys = healthy(random, ("chain",), ("points",))
    turn = float(np.radians(random.uniform(35.0, 50.0)) * random.choice([-1, 1]))
    return {**keys, "features": "exact", "duration": 14.0,
            "calibration_offset": {"rpy": [turn, 0.0, 0.0]}}  # fmt: skip


# -- the target --------------------------------------------------------------------------------


@kind("target_lost")
def target_leaves(random: Draw) -> Changes:
    """The target leaves the image faster than the camera can follow."""
    v = random.uniform(1.2, 1.8)
    a = random.uniform(0, 2 * np.pi)
    motion = {"velocity": [v * np.cos(a), v * np.sin(a), 0, 0, 0, 0],
              "begin": float(random.uniform(0.3, 0.6))}  # fmt: skip
    return {**healthy(random, ("chain",)), "goal": "2016", "target": {"motion": motion}}


@kind("target_lost")
def target_covered(random: Draw) -> Changes:
    """The whole target is covered during servoing, so that it is not visible in any later image."""
    keys = pictured(random, plants=("chain",), own=True)
    keys["target"]["motion"] = {"step": [3.0, 0.0, 0.0], "begin": float(random.uniform(0.3, 0.8))}
    return keys


@kind("target_moves")
def target_drifts(random: Draw) -> Changes:
    """The target moves at a constant 10 to 40 mm/s; the scheme does not compensate this motion."""
    v, a = random.uniform(0.01, 0.04), random.uniform(0, 2 * np.pi)
    keys = healthy(random, ("chain", "free"), own=True)
    keys["target"]["motion"] = {"velocity": [v * np.cos(a), v * np.sin(a), 0, 0, 0, 0]}
    return {**keys, "duration": float(random.uniform(4.0, 12.0))}


@kind("target_moves")
def target_swings(random: Draw) -> Changes:
    """The target oscillates with an amplitude of 5 to 20 mm at 0.2 to 0.6 Hz."""
    a, b = random.uniform(0.005, 0.02, 2)
    keys = healthy(random, ("chain", "free"), own=True)
    frequency = float(random.uniform(0.2, 0.6))
    keys["target"]["motion"] = {"amplitude": [a, b, 0.0], "frequency": frequency}
    return {**keys, "duration": 8.0}


@kind("converged")
def target_pushed_once(random: Draw) -> Changes:
    """The target is displaced once by 1 to 2 cm during servoing."""
    keys = healthy(random, ("chain", "free"), own=True)
    a = random.uniform(0, 2 * np.pi)
    keys["target"]["motion"] = {"step": [0.015 * np.cos(a), 0.015 * np.sin(a), 0.0],
                                "begin": float(random.uniform(0.3, 0.6))}  # fmt: skip
    return keys


@kind("wrong_object")
def other_object(random: Draw) -> Changes:
    """A long strip replaces the target with which the goal was taught."""
    width = random.uniform(0.05, 0.07)
    strip = [[-width, -0.008], [width, -0.008], [width, 0.008], [-width, 0.02]]
    return {"plant": "chain", "scheme": "moments", "start": sampler(random), "duration": 8.0,
            "time_after_convergence": 0.3, "goal": "2016",
            "target": {"shape": strip, "pose": [0.0, 0.0, 0.59, 0.0, 0.0, 0.0]}}  # fmt: skip


changed("same_from_four_sides", ("converged",),
        lambda random: healthy(random, ("chain", "free"), ("points",)),
        "Points of a square, from a start rotated by 60 to 120 degrees: all four orientations look "
        "like the goal.", faults=0, alike=True, features="exact",
        target=lambda random: placed(random, "square"), goal=goal_above)


# -- the arm -----------------------------------------------------------------------------------


@kind("out_of_reach")
def goal_below_reach(random: Draw) -> Changes:
    """A goal pose that the arm cannot reach, too low above the table."""
    z = float(random.uniform(0.66, 0.71))
    return {**healthy(random, ("chain",), ("moments",)), "target": {},
            "goal": {"pose": [0.0, 0.0, z, DOWN, 0.0, 0.0]}}  # fmt: skip


changed("goal_at_a_singular_posture", ("converged", "singular"),
        lambda random: healthy(random, ("chain", "bullet"), ("points", "segments")),
        "A goal of points or segments with a vertical optical axis, in images: the arm cannot "
        "rotate the camera about its y axis there.", features="images", goal=goal_above)


@kind("joint_limit")
def limit_in_the_way(random: Draw) -> Changes:
    """The gantry reaches its limit before the goal."""
    upper = float(random.uniform(-0.12, -0.08))
    return {"plant": "chain", "scheme": str(random.choice(["moments", "points"])),
            "controller_parameters": {"upper": {"gantry": upper}}, "goal": "2016",
            "start": {"height": [0.2, 0.32], "side": 0.02, "turn": 0.8},
            "duration": 8.0, "time_after_convergence": 0.3}  # fmt: skip


changed("joints_too_slow", ("saturation",), ("chain",),
        "Joints whose velocity limit is only 5 to 12 mrad/s.", duration=8.0,
        controller_parameters=lambda random: {"max_velocity": float(random.uniform(0.005, 0.012))})
changed("joints_stay_behind", ("joints_do_not_follow",), ("chain",),
        "Joints that follow their commands with a time constant of 3 to 8 s.", lag=(3.0, 8.0))
changed("joints_stick", ("joints_do_not_follow",), ("chain",),
        "All joints stop during the run and ignore commands: a blocked arm.",
        ("joints_stick", 0.2, 0.5))


# -- the loop ----------------------------------------------------------------------------------


changed("gain_far_too_high", ("gain_too_high",), ("chain",),
        "A gain of 42 to 50 1/s at 30 images per second.", gain=(42.0, 50.0))


@kind("gain_too_high")
def delay_too_long(random: Draw) -> Changes:
    """A delay of 0.25 to 0.4 s, and a gain that causes oscillations with this delay."""
    delay = float(random.uniform(0.25, 0.4))
    return {**healthy(random, ("chain", "free")), "delay": delay,
            "gain": float(random.uniform(1.3, 1.7) / delay)}  # fmt: skip


@kind("converged", "too_few_images")
def images_seldom(random: Draw) -> Changes:
    """1.5 to 2.5 images per second."""
    rate = float(random.uniform(1.5, 2.5))
    return {**healthy(random, ("chain", "free")), "features": "exact", "duration": 12.0,
            "camera": {"horizontal_fov": 2.0, "update_rate": rate}}  # fmt: skip


changed("gain_too_low", ("timed_out",), ("chain", "free"),
        "A gain of 0.1 to 0.2 1/s and a duration of four seconds.", gain=(0.1, 0.2), duration=4.0)


@kind("too_few_images", "converged")
def images_dropped(random: Draw) -> Changes:
    """The camera loses 95 to 97 % of its images."""
    drop = float(random.uniform(0.95, 0.97))
    return {**healthy(random, ("chain",)), "gain": 1.0,
            "camera": {"horizontal_fov": 2.0, "effects": {"drop_probability": drop}}}  # fmt: skip


changed("camera_dies", ("too_few_images",), PLANTS, "The images end during the run.",
        ("images_end", 0.3, 0.7), gain=1.0)
changed("joint_states_end", ("no_joint_states",), ("chain", "bullet"),
        "The joint states end during the run.", ("joints_end", 0.3, 0.7), gain=1.0)
changed("held_by_service", ("held",), PLANTS, "The service `hold` is called during servoing.",
        ("hold", 0.2, 0.6), gain=1.0)
changed("stopped_by_service", ("stopped",), PLANTS, "The service `stop` is called during servoing.",
        ("stop", 0.2, 0.6), gain=1.0)


# -- the scheme --------------------------------------------------------------------------------


changed("scheme_raises", ("scheme_fault",), ("chain", "free"),
        "A scheme that raises an exception.", scheme="outcome_campaign.schemes:Broken")
changed("scheme_not_finite", ("scheme_fault",), ("chain", "free"), "A feature that is NaN.",
        scheme="outcome_campaign.schemes:NotFinite")
changed("features_contradict", ("local_minimum",), ("chain",),
        "Features that cannot all reach their goals.", goal=goal_above,
        scheme="outcome_campaign.schemes:Contrary")
changed("directions_unseen", ("singular",), ("chain",),
        "A scheme that controls six directions with only two independent features.",
        scheme="outcome_campaign.schemes:Dependent")


@kind("camera_retreat", "target_lost")
def half_turn_by_points(random: Draw) -> Changes:
    """Points with the current L, from a start rotated by 174 to 180 degrees about the optical
    axis."""
    goal = goal_above(random)
    turn = float(np.radians(random.uniform(174.0, 180.0)))
    return {"plant": "free", "features": "exact", "scheme": "points", "goal": goal,
            "controller_parameters": {"interaction": "current"}, "target": placed(random),
            "start": {"pose": [*goal["pose"][:3], DOWN, 0.0, turn]}, "duration": 10.0,
            "time_after_convergence": 0.3, "gain": 2.0}  # fmt: skip
