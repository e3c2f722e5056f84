"""What is provoked, by kinds; for each the outcomes that are right, written down before the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Draw = np.random.Generator
Changes = dict[str, Any]

# On the table of the Bullet arm, and at the same place before the other plants.
TABLE = (0.0, 0.0, 0.591)
PLANTS = ("chain", "chain", "free", "bullet")
DOWN = np.pi  # roll of a camera that looks at the table
# Corners of outlines without symmetry, parts of their size; less than 17 px wide the last one shows
# three corners, which look the same from several poses.
OUTLINES = (
    ((-0.5, -0.4), (0.5, -0.5), (0.35, 0.45), (-0.3, 0.3)),
    ((-0.5, -0.3), (0.4, -0.5), (0.5, 0.5), (-0.15, 0.2)),
    ((-0.5, -0.5), (0.5, -0.45), (0.1, -0.1), (-0.2, 0.5)),
)  # fmt: skip


@dataclass(frozen=True)
class Event:
    """Something done to a run under way, `at` s after its first image.

    what: "hold", "stop", "joints_end" (no joint states any more), "images_end" or "joints_stick".
    """

    what: str
    at: float


@dataclass(frozen=True)
class Trial:
    """One run to be made: kind, its number, the experiment's keys, what is right.

    right: kinds of outcome that are right; 'converged' stands for 'converged up to ...' too.
    """

    kind: str
    number: int
    keys: Mapping[str, Any]
    right: tuple[str, ...]
    event: Event | None = None


@dataclass(frozen=True)
class Kind:
    """A kind of fault: how its experiments are drawn, and what is right of them.

    faults: how many are provoked at once. alike: whether its targets look the same from several
    poses, so that no image tells which of them the camera is at.
    """

    name: str
    draw: Callable[[Draw], Changes]
    right: tuple[str, ...]
    event: Callable[[Draw], Event] | None = None
    faults: int = 1
    alike: bool = False
    text: str = field(default="", compare=False)

    def trial(self, seed: int, number: int) -> Trial:
        """The trial of a number; the same for the same seed."""
        random = np.random.default_rng([seed, number, *self.name.encode()])
        keys = {"seed": int(random.integers(2**31)), **self.draw(random)}
        event = None if self.event is None else self.event(random)
        return Trial(self.name, number, keys, self.right, event)


KINDS: dict[str, Kind] = {}


def kind(
    *right: str,
    event: Callable[[Draw], Event] | None = None,
    faults: int = 1,
    alike: bool = False,
) -> Callable[[Callable[[Draw], Changes]], Callable[[Draw], Changes]]:
    """Enter a function that draws an experiment's keys as a kind of its name."""

    def enter(draw: Callable[[Draw], Changes]) -> Callable[[Draw], Changes]:
        name = draw.__name__
        KINDS[name] = Kind(name, draw, right, event, faults, alike, (draw.__doc__ or "").strip())
        return draw

    return enter


# -- what experiments have in common -----------------------------------------------------------


def sampler(random: Draw, height: tuple[float, float] = (0.2, 0.32)) -> Changes:
    """Starts with the target in view, at other heights each."""
    return {"height": list(height), "side": random.uniform(0.02, 0.05),
            "turn": random.uniform(0.2, 0.8)}  # fmt: skip


def placed(
    random: Draw, shape: Any = None, size: float | None = None, outlines: int = len(OUTLINES)
) -> Changes:
    """A target on the table, some way off its middle; without symmetry if no shape is named."""
    size = float(random.uniform(0.05, 0.08)) if size is None else size
    if shape is None:
        outline = OUTLINES[random.integers(outlines)]
        shape = [[size * x, size * y] for x, y in outline]
    x, y = random.uniform(-0.02, 0.02, 2)
    return {"shape": shape, "size": [size, size],
            "pose": [float(x), float(y), TABLE[2], 0.0, 0.0, float(random.uniform(-0.5, 0.5))]}


def goal_above(random: Draw, leans: bool = False) -> Changes:
    """A camera's pose above the table's middle, at which the goal is shown.

    leans: it looks at the table's middle from 8 to 16 degrees beside the vertical. Level poses are
        singular for the arm: its first and its last joint turn the camera about one axis, and none
        about its y axis (the Jacobian's least singular value is 0.003).
    """
    x, y = random.uniform(-0.01, 0.01, 2)
    height = random.uniform(0.24, 0.3)
    lean = float(np.radians(random.uniform(8.0, 16.0)) * random.choice([-1, 1])) if leans else 0.0
    return {"pose": [float(x), float(y - height * np.tan(lean)), float(TABLE[2] + height),
                     DOWN + lean, 0.0, 0.0]}  # fmt: skip


def healthy(random: Draw, plants: tuple[str, ...] = PLANTS,
            schemes: tuple[str, ...] = ("points", "moments", "segments", "pose"),
            own: bool = False) -> Changes:  # fmt: skip
    """A run that nothing is wrong with; `own`: not before the demo's two plates.

    An arm whose camera is to move in all directions gets a goal that leans, and a target that is
    large enough to tell by how much.
    """
    plant, scheme = str(random.choice(plants)), str(random.choice(schemes))
    keys: Changes = {
        "plant": plant, "scheme": scheme, "start": sampler(random),
        "duration": 12.0, "time_after_convergence": 0.3, "gain": float(random.uniform(1.5, 3.0)),
    }  # fmt: skip
    leans = plant != "free" and scheme != "moments"
    if own or leans or scheme not in ("points", "moments") or random.random() < 0.5:
        size = float(random.uniform(0.09, 0.12)) if leans else None
        keys |= {"target": placed(random, size=size), "goal": goal_above(random, leans)}
    return keys


def pictured(random: Draw, **given: Any) -> Changes:
    """The same by pictures; `pose` is left to targets that are large enough for it, or markers."""
    given.setdefault("schemes", ("points", "moments", "segments"))
    return {**healthy(random, **given), "features": "images"}


# -- nothing wrong -----------------------------------------------------------------------------


@kind("converged", faults=0)
def exact_features(random: Draw) -> Changes:
    """Nothing wrong, exact features of any scheme."""
    keys = healthy(random, ("chain", "free"), ("points", "moments", "segments", "lines", "pose"))
    return {**keys, "features": "exact"}


@kind("converged", faults=0)
def pictures(random: Draw) -> Changes:
    """Nothing wrong, pictures."""
    return pictured(random)


@kind("converged", "too_noisy", faults=0)
def noisy_pictures(random: Draw) -> Changes:
    """Pictures with noise of 1 to 5 grey levels: of some targets too much for six directions."""
    return {**pictured(random), "noise": float(random.uniform(1.0, 5.0))}


@kind("converged", "too_noisy", faults=0)
def jittered_features(random: Draw) -> Changes:
    """Exact features that jitter by 0.05 to 0.3 px: of a small target too much for its pose."""
    keys = healthy(random, ("chain", "free"))
    return {**keys, "features": "exact", "jitter": float(random.uniform(0.05, 0.3))}


@kind("converged", "too_noisy", faults=0)
def small_target(random: Draw) -> Changes:
    """A target of 25 to 45 mm, ten to twenty pixels wide, by pictures: its pixels are noise."""
    keys = pictured(random, plants=("free",))
    if random.random() < 0.5:
        keys |= {"plant": str(random.choice(["chain", "bullet"])), "scheme": "moments"}
    return {**keys, "goal": goal_above(random),
            "target": placed(random, size=float(random.uniform(0.025, 0.045)), outlines=2)}


@kind("converged", faults=0)
def marker_target(random: Draw) -> Changes:
    """Points or pose before a marker of 7 to 10 cm, by pictures with a little noise."""
    keys = pictured(random, schemes=("points", "pose"), own=True)
    return {**keys, "target": placed(random, "marker", float(random.uniform(0.07, 0.1))),
            "noise": float(random.uniform(0.0, 2.0))}  # fmt: skip


@kind("converged")
def wrong_depth(random: Draw) -> Changes:
    """A believed depth between 0.6 and 1.6 times the true one."""
    keys = healthy(random, ("chain", "free"))
    return {**keys, "calibration_offset": {"depth": float(random.choice([0.6, 0.75, 1.3, 1.6]))}}


@kind("converged", faults=0)
def rate_known(random: Draw) -> Changes:
    """A target that moves at 30 mm/s, before a scheme that knows so."""
    return {
        "plant": str(random.choice(["chain", "free"])), "features": "exact",
        "scheme": "outcome_campaign.schemes:Following", "target": {
            **placed(random), "motion": {"velocity": [0.03, 0, 0, 0, 0, 0]}},
        "goal": goal_above(random), "start": sampler(random), "duration": 6.0,
        "time_after_convergence": 0.5,
        "gain": 3.0,
    }  # fmt: skip


# -- a camera that is not as believed ----------------------------------------------------------


@kind("converged")
def goal_shown_by_wrong_focal(random: Draw) -> Changes:
    """The goal shown by the camera itself; its focal length is believed 5 to 30 % off."""
    focal = float(random.choice([0.8, 0.95, 1.05, 1.15, 1.3]))
    return {**pictured(random, own=True), "calibration_offset": {"focal": focal}}


@kind("converged")
def goal_shown_by_wrong_centre(random: Draw) -> Changes:
    """The goal shown by the camera itself; its principal point is believed 10 px off."""
    return {**pictured(random, own=True),
            "calibration_offset": {"centre": [float(random.choice([-10, 10])), 6.0]}}  # fmt: skip


@kind("converged", "wrong_camera_model")
def goal_shown_by_wrong_mounting(random: Draw) -> Changes:
    """The goal shown by the camera itself, which is mounted 3 to 8 degrees off."""
    keys = healthy(random, ("chain", "bullet"))
    turn = float(np.radians(random.uniform(3.0, 8.0)))
    axis = random.choice(3)
    return {**keys, "calibration_offset": {"rpy": [turn if i == axis else 0.0 for i in range(3)]}}


@kind("wrong_camera_model")
def goal_of_another_camera(random: Draw) -> Changes:
    """A goal worked out for the camera as it is; its focal length is believed 1.5 to 1.7."""
    return {"plant": "chain", "features": "images", "scheme": "moments", "duration": 8.0,
            "goal": "2016", "start": sampler(random), "time_after_convergence": 0.3,
            "calibration_offset": {"focal": float(random.uniform(1.5, 1.7))}}  # fmt: skip


@kind("converged", "wrong_camera_model")
def camera_turned_in_its_mount(random: Draw) -> Changes:
    """The goal shown by the camera itself, mounted 35 to 50 degrees about its axis from where it is
    believed."""
    keys = healthy(random, ("chain",), ("points",))
    turn = float(np.radians(random.uniform(35.0, 50.0)) * random.choice([-1, 1]))
    return {**keys, "features": "exact", "duration": 14.0,
            "calibration_offset": {"rpy": [turn, 0.0, 0.0]}}  # fmt: skip


# -- the target --------------------------------------------------------------------------------


@kind("target_lost")
def target_leaves(random: Draw) -> Changes:
    """The target leaves the view faster than the camera follows."""
    v = random.uniform(1.2, 1.8)
    a = random.uniform(0, 2 * np.pi)
    motion = {"velocity": [v * np.cos(a), v * np.sin(a), 0, 0, 0, 0],
              "begin": float(random.uniform(0.3, 0.6))}  # fmt: skip
    return {**healthy(random, ("chain",)), "goal": "2016", "target": {"motion": motion}}


@kind("target_lost")
def target_covered(random: Draw) -> Changes:
    """Something is laid over the whole target while the arm servoes: no pictures of it remain."""
    keys = pictured(random, plants=("chain",), own=True)
    keys["target"]["motion"] = {"step": [3.0, 0.0, 0.0], "begin": float(random.uniform(0.3, 0.8))}
    return keys


@kind("target_moves")
def target_drifts(random: Draw) -> Changes:
    """The target moves steadily at 10 to 40 mm/s, which the scheme does not know."""
    v, a = random.uniform(0.01, 0.04), random.uniform(0, 2 * np.pi)
    keys = healthy(random, ("chain", "free"), own=True)
    keys["target"]["motion"] = {"velocity": [v * np.cos(a), v * np.sin(a), 0, 0, 0, 0]}
    return {**keys, "duration": float(random.uniform(4.0, 12.0))}


@kind("target_moves")
def target_swings(random: Draw) -> Changes:
    """The target swings by 5 to 20 mm at 0.2 to 0.6 Hz."""
    a, b = random.uniform(0.005, 0.02, 2)
    keys = healthy(random, ("chain", "free"), own=True)
    frequency = float(random.uniform(0.2, 0.6))
    keys["target"]["motion"] = {"amplitude": [a, b, 0.0], "frequency": frequency}
    return {**keys, "duration": 8.0}


@kind("converged")
def target_pushed_once(random: Draw) -> Changes:
    """The target is pushed by 1 to 2 cm while the arm servoes, and lies still again."""
    keys = healthy(random, ("chain", "free"), own=True)
    a = random.uniform(0, 2 * np.pi)
    keys["target"]["motion"] = {"step": [0.015 * np.cos(a), 0.015 * np.sin(a), 0.0],
                                "begin": float(random.uniform(0.3, 0.6))}  # fmt: skip
    return keys


@kind("wrong_object")
def other_object(random: Draw) -> Changes:
    """A long strip lies where the goal's target was."""
    width = random.uniform(0.05, 0.07)
    strip = [[-width, -0.008], [width, -0.008], [width, 0.008], [-width, 0.02]]
    return {"plant": "chain", "scheme": "moments", "start": sampler(random), "duration": 8.0,
            "time_after_convergence": 0.3, "goal": "2016",
            "target": {"shape": strip, "pose": [0.0, 0.0, 0.59, 0.0, 0.0, 0.0]}}  # fmt: skip


@kind("converged", faults=0, alike=True)
def same_from_four_sides(random: Draw) -> Changes:
    """A square by points, from a start that is turned by 60 to 120 degrees: any of its four
    headings looks like the goal."""
    keys = healthy(random, ("chain", "free"), ("points",))
    return {**keys, "features": "exact", "target": placed(random, "square"),
            "goal": goal_above(random)}  # fmt: skip


# -- the arm -----------------------------------------------------------------------------------


@kind("out_of_reach")
def goal_below_reach(random: Draw) -> Changes:
    """A goal pose that the arm cannot take: too low over the table."""
    z = float(random.uniform(0.66, 0.71))
    return {**healthy(random, ("chain",), ("moments",)), "target": {},
            "goal": {"pose": [0.0, 0.0, z, DOWN, 0.0, 0.0]}}  # fmt: skip


@kind("converged", "singular")
def goal_at_a_singular_posture(random: Draw) -> Changes:
    """A level goal of points or segments, by pictures: the arm cannot turn the camera about its y
    axis there."""
    keys = healthy(random, ("chain", "bullet"), ("points", "segments"))
    return {**keys, "features": "images", "goal": goal_above(random)}


@kind("joint_limit")
def limit_in_the_way(random: Draw) -> Changes:
    """The gantry's limit lies before the goal."""
    upper = float(random.uniform(-0.12, -0.08))
    return {"plant": "chain", "scheme": str(random.choice(["moments", "points"])),
            "controller_parameters": {"upper": {"gantry": upper}}, "goal": "2016",
            "start": {"height": [0.2, 0.32], "side": 0.02, "turn": 0.8},
            "duration": 8.0, "time_after_convergence": 0.3}  # fmt: skip


@kind("saturation")
def joints_too_slow(random: Draw) -> Changes:
    """Joints that may move at 5 to 12 mrad/s only."""
    return {**healthy(random, ("chain",)), "duration": 8.0,
            "controller_parameters": {"max_velocity": float(random.uniform(0.005,
                0.012))}}  # fmt: skip


@kind("joints_do_not_follow")
def joints_stay_behind(random: Draw) -> Changes:
    """Joints that follow their commands with a lag of 3 to 8 s."""
    return {**healthy(random, ("chain",)), "lag": float(random.uniform(3.0, 8.0))}


@kind("joints_do_not_follow", event=lambda random: Event("joints_stick", random.uniform(0.2, 0.5)))
def joints_stick(random: Draw) -> Changes:
    """All joints stand still from a moment on, whatever is commanded: a blocked arm."""
    return healthy(random, ("chain",))


# -- the loop ----------------------------------------------------------------------------------


@kind("gain_too_high")
def gain_far_too_high(random: Draw) -> Changes:
    """A gain of 42 to 50 at 30 images a second."""
    return {**healthy(random, ("chain",)), "gain": float(random.uniform(42.0, 50.0))}


@kind("gain_too_high")
def delay_too_long(random: Draw) -> Changes:
    """A delay of 0.25 to 0.4 s at a gain that swings with it."""
    delay = float(random.uniform(0.25, 0.4))
    return {**healthy(random, ("chain", "free")), "delay": delay,
            "gain": float(random.uniform(1.3, 1.7) / delay)}  # fmt: skip


@kind("converged", "too_few_images")
def images_seldom(random: Draw) -> Changes:
    """One and a half to two and a half images a second."""
    rate = float(random.uniform(1.5, 2.5))
    return {**healthy(random, ("chain", "free")), "features": "exact", "duration": 12.0,
            "camera": {"horizontal_fov": 2.0, "update_rate": rate}}  # fmt: skip


@kind("timed_out")
def gain_too_low(random: Draw) -> Changes:
    """A gain of 0.1 to 0.2 for four seconds."""
    return {**healthy(random, ("chain", "free")), "gain": float(random.uniform(0.1, 0.2)),
            "duration": 4.0}  # fmt: skip


@kind("too_few_images", "converged")
def images_dropped(random: Draw) -> Changes:
    """The camera drops 95 to 97 of 100 images."""
    drop = float(random.uniform(0.95, 0.97))
    return {**healthy(random, ("chain",)), "gain": 1.0,
            "camera": {"horizontal_fov": 2.0, "effects": {"drop_probability": drop}}}  # fmt: skip


@kind("too_few_images", event=lambda random: Event("images_end", random.uniform(0.3, 0.7)))
def camera_dies(random: Draw) -> Changes:
    """No image comes any more from a moment on."""
    return {**healthy(random), "gain": 1.0}


@kind("no_joint_states", event=lambda random: Event("joints_end", random.uniform(0.3, 0.7)))
def joint_states_end(random: Draw) -> Changes:
    """No joint states come any more from a moment on."""
    return {**healthy(random, ("chain", "bullet")), "gain": 1.0}


@kind("held", event=lambda random: Event("hold", random.uniform(0.2, 0.6)))
def held_by_service(random: Draw) -> Changes:
    """`hold` is called while the arm servoes."""
    return {**healthy(random), "gain": 1.0}


@kind("stopped", event=lambda random: Event("stop", random.uniform(0.2, 0.6)))
def stopped_by_service(random: Draw) -> Changes:
    """`stop` is called while the arm servoes."""
    return {**healthy(random), "gain": 1.0}


# -- the scheme --------------------------------------------------------------------------------


@kind("scheme_fault")
def scheme_raises(random: Draw) -> Changes:
    """A scheme that raises."""
    return {**healthy(random, ("chain", "free")), "scheme": "outcome_campaign.schemes:Broken"}


@kind("scheme_fault")
def scheme_not_finite(random: Draw) -> Changes:
    """A feature that is NaN."""
    return {**healthy(random, ("chain", "free")), "scheme": "outcome_campaign.schemes:NotFinite"}


@kind("local_minimum")
def features_contradict(random: Draw) -> Changes:
    """Features that cannot all be at their goals."""
    return {**healthy(random, ("chain",)), "scheme": "outcome_campaign.schemes:Contrary",
            "goal": goal_above(random)}  # fmt: skip


@kind("singular")
def directions_unseen(random: Draw) -> Changes:
    """Two independent features that are to move the camera in six directions."""
    return {**healthy(random, ("chain",)), "scheme": "outcome_campaign.schemes:Dependent"}


@kind("camera_retreat", "target_lost")
def half_turn_by_points(random: Draw) -> Changes:
    """Points from a start turned by 172 to 180 degrees about the optical axis, L current."""
    goal = goal_above(random)
    x, y, z, *_ = goal["pose"]
    turn = float(np.radians(random.uniform(174.0, 180.0)))
    return {"plant": "free", "features": "exact", "scheme": "points", "goal": goal,
            "controller_parameters": {"interaction": "current"}, "target": placed(random),
            "start": {"pose": [x, y, z, DOWN, 0.0, turn]}, "duration": 10.0,
            "time_after_convergence": 0.3,
            "gain": 2.0}  # fmt: skip
