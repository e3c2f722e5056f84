"""Remedies that are computed from a run: how much to change, and what fits its scheme."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, log, pi

from ..features.base import Feature
from ..records.outcomes import CLOSER, Outcome
from ..records.remedy import Change, Remedy, multiply, remove, set_to
from ..schemes.base import JointController, Scheme, SchemeBase

# Of a loop with a dead time T that swings at its limit, at f = 1 / (4 T), the gain that brings the
# error down fastest without a swing is 1 / (e T) = 1.5 f; somewhat less allows for its tolerance.
PER_SWING = 1.2  # of the gain, 1/s per Hz
BY_ITSELF = 0.3  # part of the gain that a swing takes, with an L that is too small by so much
LEAST_CUT, DEEPEST_CUT = 0.6, 0.02
# Times as long as the measured rate says that a run may take, and longest of its present duration.
RESERVE, LONGEST = 1.5, 50.0
LINEAR = 2.0  # times the reserve where joints are at their limits, of which the slowest changes
DECAYS = 8.0  # time constants in which a run comes to its goal
# Tolerances by which errors may scatter for a target twice as large to be enough, and by which they
# do where it is so much that they are not servoed; and by which a camera that is there may see them
# scatter.
LARGER, UNKNOWN_NOISE, QUIET = 2.0, 50.0, 0.5
HELD = 3.0  # s that the error has to be small for, and some more
# Schemes that see a half turn as it is, and go straight back from most starts.
STRAIGHT = "pose, two_and_half_d or polar_points"
PACKAGE = __name__.partition(".")[0]


def is_own(scheme: Scheme | JointController) -> bool:
    """Whether a scheme, or its feature, is a user's own."""
    parts = getattr(scheme, "features", ()) or (scheme,)
    return any(
        isinstance(part, SchemeBase | Feature)
        and not type(part).__module__.startswith(f"{PACKAGE}.") for part in parts
    )  # fmt: skip


def gain_of(scheme: Scheme | JointController | None) -> float | None:
    """The greatest gain of a scheme's law, 1/s; None: it has none of that kind."""
    law = getattr(scheme, "law", None)
    known = (getattr(law, name, None) for name in ("gain", "zero", "infinity"))
    return max((value for value in known if value is not None), default=None)


def can_swing(scheme: Scheme | JointController | None, frequency: float) -> bool:
    """Whether a loop of this gain can swing by itself at a frequency, Hz: its joints integrate,
    and follow no command by more than that, so that its gain is 2 pi f at least."""
    gain = gain_of(scheme)
    return gain is None or gain > BY_ITSELF * 2.0 * pi * frequency


def lower_gain(
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
        factor = 0.3 if frequency is None else PER_SWING * frequency / gain
        factor = min(max(factor, DEEPEST_CUT), LEAST_CUT)
        return Remedy(advice, multiply("gain", factor), *_time_for(gain * factor, duration))
    if hasattr(law, "zero") and hasattr(law, "infinity"):
        return Remedy(advice,
            advice, multiply("law_options.zero", 0.3), multiply("law_options.infinity", 0.3)
        )
    return Remedy(advice)


def _time_for(gain: float, duration: float) -> tuple[Change, ...]:
    """The duration, s, in which a loop of a gain, 1/s, comes to its goal, where it needs more."""
    needed = (DECAYS / gain + HELD) / duration
    return (multiply("duration", needed),) if isfinite(duration) and needed > 1.0 else ()


def more_time(duration: float, size: float, rate: float, linear: bool = False) -> Remedy:
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
    left = LINEAR * size / rate if linear else log(max(size / 0.3, 2.0)) / rate
    factor = 1.0 + RESERVE * (left + HELD) / duration
    return Remedy(advice, multiply("duration", min(factor, LONGEST)))


def other_scheme(found: Outcome, scheme: Scheme | JointController) -> Remedy:
    """What helps a scheme that retreats, ends in a minimum, or does not see a direction."""
    own = is_own(scheme)
    if found.kind == "singular":
        advice = (
            "use features that do without the direction that is lost, or more of them; near half a "
            f"turn {STRAIGHT}; or another posture"
        )
        return Remedy(advice, set_to("scheme", "moments"))
    if own:
        return Remedy("see whether a shipped scheme gets there", set_to("scheme", "points"))
    if found.kind == "camera_retreat":
        advice = f"use features that turn without retreat: {STRAIGHT}"
        return Remedy(advice, *_instead(scheme, "polar_points"))
    advice = f"use L desired or mean, near half a turn {STRAIGHT}"
    return Remedy(advice, *_instead(scheme, "pose"))


def _instead(scheme: Scheme | JointController, name: str) -> tuple[Change, ...]:
    """The changes to another scheme; a nearer start where it is that one already."""
    features = getattr(scheme, "features", ())
    if any(feature.name == name for feature in features):
        return (CLOSER,)
    changes = (set_to("scheme", name),)
    if getattr(scheme, "interaction", "current") != "current":
        changes += (set_to("interaction", "current"),)
    return changes


def more_exact(noise: float, *others: Change) -> Remedy:
    """What an error needs that scatters by more than its tolerance: a larger target where that is
    enough, else less noise.

    Args:
        noise: in tolerances; 0: not known. others: what has to change besides.
    """
    noise = noise or UNKNOWN_NOISE
    changes = (multiply("target.size", max(noise, 1.3)),)
    if noise > LARGER:
        changes = multiply("jitter", QUIET / noise), multiply("noise", QUIET / noise)
    return Remedy(
        "measure more exactly: more light, a shorter distance, other features, or a larger target",
        *changes, *others,
    )


def faster_joints(advice: Remedy) -> Remedy:
    """What joints need that move to their commands, but too slowly."""
    return Remedy(str(advice), multiply("lag", 0.02))


def wider_limits(keys: Sequence[str]) -> Remedy:
    """Limits of the robot itself, where parameters narrow them; keys: those parameters."""
    return Remedy(
        "allow the joint its robot's own limit, or choose another posture to start from",
        *map(remove, keys),
    )


def patience(longest: float, gain: float | None, duration: float) -> Remedy:
    """What a loop needs whose images come seldom: `longest` s apart, or more.

    Args:
        gain: of its law, 1/s; None: not known. duration: of the run, s.
    """
    changes = [set_to("watchdog", round(2.0 * longest, 2))]
    if gain is not None:
        factor = min(0.3 / (gain * longest), 1.0)
        changes.append(multiply("gain", factor))
        changes += _time_for(gain * factor, duration)
    return Remedy(
        "raise the camera's rate, or find what delays its images; with images as seldom as these "
        "wait longer for each", *changes,
    )  # fmt: skip
