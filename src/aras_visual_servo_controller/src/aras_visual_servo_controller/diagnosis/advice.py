"""Remedies that are computed from a run: how much to change, and what fits its scheme."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, log, pi

from ..features.base import Feature
from ..records.outcomes import START_CLOSER, Outcome
from ..records.remedy import Change, Remedy, multiply, remove, set_value
from ..schemes.base import JointController, Scheme, SchemeBase

# Of a loop with a dead time T that swings at its limit, at f = 1 / (4 T), the gain that brings the
# error down fastest without a swing is 1 / (e T) = 1.5 f; somewhat less allows for its tolerance.
GAIN_PER_HERTZ = 1.2  # of the gain, 1/s per Hz
MIN_GAIN_PART = 0.3  # part of the gain that a swing takes, with an L that is too small by so much
MAX_GAIN_FACTOR, MIN_GAIN_FACTOR = 0.6, 0.02
# Times as long as the measured rate says that a run may take, and longest of its present duration.
TIME_RESERVE, MAX_TIME_FACTOR = 1.5, 50.0
# times the reserve where joints are at their limits, of which the slowest changes
LINEAR_RESERVE = 2.0
TIME_CONSTANTS = 8.0  # time constants in which a run comes to its goal
# Tolerances by which errors may scatter for a target twice as large to be enough, and by which they
# do where it is so much that they are not servoed; and by which a camera that is there may see them
# scatter.
NOISE_OF_SMALL_TARGET, NOISE_WHEN_UNKNOWN, TOLERATED_NOISE = 2.0, 50.0, 0.5
SETTLING_TIME = 3.0  # s that the error has to be small for, and some more
# Schemes that see a half turn as it is, and go straight back from most starts.
HALF_TURN_SCHEMES = "pose, two_and_half_d or polar_points"
PACKAGE = __name__.partition(".")[0]


def is_user_scheme(scheme: Scheme | JointController) -> bool:
    """Whether a scheme, or its feature, is a user's own."""
    parts = getattr(scheme, "features", ()) or (scheme,)
    return any(
        isinstance(part, SchemeBase | Feature)
        and not type(part).__module__.startswith(f"{PACKAGE}.") for part in parts
    )  # fmt: skip


def find_gain(scheme: Scheme | JointController | None) -> float | None:
    """The greatest gain of a scheme's law, 1/s; None: it has none of that kind."""
    law = getattr(scheme, "law", None)
    known = (getattr(law, name, None) for name in ("gain", "zero", "infinity"))
    return max((value for value in known if value is not None), default=None)


def can_oscillate(scheme: Scheme | JointController | None, frequency: float) -> bool:
    """Whether a loop of this gain can swing by itself at a frequency, Hz: its joints integrate,
    and follow no command by more than that, so that its gain is 2 pi f at least."""
    gain = find_gain(scheme)
    return gain is None or gain > MIN_GAIN_PART * 2.0 * pi * frequency


def suggest_gain(
    scheme: Scheme | JointController | None, frequency: float | None, duration: float
) -> Remedy:
    """The gain at which a loop that swings at `frequency` Hz comes to rest; None: not known.

    duration: of the run, s, in which it has to come to its goal.
    """
    advice = (
        "lower the gain, or the delay between image and command; mount a camera firmly that shakes"
    )
    law = getattr(scheme, "law", None)
    if (gain := getattr(law, "gain", None)) is not None:
        factor = 0.3 if frequency is None else GAIN_PER_HERTZ * frequency / gain
        factor = min(max(factor, MIN_GAIN_FACTOR), MAX_GAIN_FACTOR)
        return Remedy(advice, multiply("gain", factor), *_compute_duration(gain * factor, duration))
    if hasattr(law, "zero") and hasattr(law, "infinity"):
        return Remedy(advice,
            advice, multiply("law_options.zero", 0.3), multiply("law_options.infinity", 0.3)
        )
    return Remedy(advice)


def _compute_duration(gain: float, duration: float) -> tuple[Change, ...]:
    """The duration, s, in which a loop of a gain, 1/s, comes to its goal, where it needs more."""
    needed = (TIME_CONSTANTS / gain + SETTLING_TIME) / duration
    return (multiply("duration", needed),) if isfinite(duration) and needed > 1.0 else ()


def suggest_more_time(duration: float, size: float, rate: float, linear: bool = False) -> Remedy:
    """The time that the error needs at its present rate.

    Args:
        duration: of the run, s. size: of the error, in tolerances. rate: 1/s, or tolerances a
            second where it shrinks linearly.
    """
    advice = "allow more time, or a higher gain"
    if linear:
        advice = "allow more time, or raise max_velocity or max_acceleration"
    if rate <= 0.0 or not isfinite(duration):
        return Remedy(advice, multiply("duration", 10.0 if linear else 3.0))
    left = LINEAR_RESERVE * size / rate if linear else log(max(size / 0.3, 2.0)) / rate
    factor = 1.0 + TIME_RESERVE * (left + SETTLING_TIME) / duration
    return Remedy(advice, multiply("duration", min(factor, MAX_TIME_FACTOR)))


def suggest_scheme(candidate: Outcome, scheme: Scheme | JointController) -> Remedy:
    """What helps a scheme that retreats, ends in a minimum, or does not see a direction."""
    own = is_user_scheme(scheme)
    if candidate.kind == "singular":
        advice = (
            "use features that do without the direction that is lost, or more of them; near half a "
            f"turn {HALF_TURN_SCHEMES}; or another posture"
        )
        return Remedy(advice, set_value("scheme", "moments"))
    if own:
        return Remedy("see whether a shipped scheme gets there", set_value("scheme", "points"))
    if candidate.kind == "camera_retreat":
        advice = f"use features that turn without retreat: {HALF_TURN_SCHEMES}"
        return Remedy(advice, *_suggest_replacement(scheme, "polar_points"))
    advice = f"use L desired or mean, near half a turn {HALF_TURN_SCHEMES}"
    return Remedy(advice, *_suggest_replacement(scheme, "pose"))


def _suggest_replacement(scheme: Scheme | JointController, name: str) -> tuple[Change, ...]:
    """The changes to another scheme; a nearer start where it is that one already."""
    features = getattr(scheme, "features", ())
    if any(feature.name == name for feature in features):
        return (START_CLOSER,)
    changes = (set_value("scheme", name),)
    if getattr(scheme, "interaction", "current") != "current":
        changes += (set_value("interaction", "current"),)
    return changes


def suggest_larger_target(noise: float, *others: Change) -> Remedy:
    """What an error needs that scatters by more than its tolerance: a larger target where that is
    enough, else less noise.

    Args:
        noise: in tolerances; 0: not known. others: what has to change besides.
    """
    noise = noise or NOISE_WHEN_UNKNOWN
    changes = (multiply("target.size", max(noise, 1.3)),)
    if noise > NOISE_OF_SMALL_TARGET:
        changes = (
            multiply("jitter", TOLERATED_NOISE / noise),
            multiply("noise", TOLERATED_NOISE / noise),
        )
    return Remedy(
        "measure more exactly: more light, a shorter distance, other features, or a larger target",
        *changes, *others,
    )


def suggest_faster_joints(advice: Remedy) -> Remedy:
    """What joints need that move to their commands, but too slowly."""
    return Remedy(str(advice), multiply("lag", 0.02))


def suggest_wider_limits(keys: Sequence[str]) -> Remedy:
    """Limits of the robot itself, where parameters narrow them; keys: those parameters."""
    return Remedy(
        "allow the joint its robot's own limit, or choose another posture to start from",
        *map(remove, keys),
    )


def suggest_longer_watchdog(longest: float, gain: float | None, duration: float) -> Remedy:
    """What a loop needs whose images come seldom: `longest` s apart, or more.

    Args:
        gain: of its law, 1/s; None: not known. duration: of the run, s.
    """
    changes = [set_value("watchdog", round(2.0 * longest, 2))]
    if gain is not None:
        factor = min(0.3 / (gain * longest), 1.0)
        changes.append(multiply("gain", factor))
        changes += _compute_duration(gain * factor, duration)
    return Remedy(
        "raise the camera's rate, or find what delays its images; with images as seldom as these "
        "wait longer for each", *changes,
    )  # fmt: skip
