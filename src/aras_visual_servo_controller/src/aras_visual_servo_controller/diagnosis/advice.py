"""Remedies computed from a run, such as the gain or the duration that the run needs."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, log, pi

from ..features.base import Feature
from ..records.outcomes import START_CLOSER, Outcome
from ..records.remedy import Change, Remedy, multiply, remove, set_value
from ..schemes.base import JointController, Scheme, SchemeBase

# A loop with dead time T oscillates at its stability limit with f = 1 / (4 T). Its error decays
# fastest without oscillation at the gain 1 / (e T) = 1.5 f; the smaller factor leaves a reserve.
GAIN_PER_HERTZ = 1.2  # suggested gain per frequency of the oscillation, 1/s per Hz
# Smallest part of 2 pi f that the gain of a loop oscillating at f may have: an L that is too small
# raises the effective gain.
MIN_GAIN_PART = 0.3
# Bounds of the suggested factor on the gain.
MAX_GAIN_FACTOR, MIN_GAIN_FACTOR = 0.6, 0.02
# Factor on the remaining time predicted from the measured rate, and upper bound of the suggested
# factor on the duration.
TIME_RESERVE, MAX_TIME_FACTOR = 1.5, 50.0
# Additional factor for joints at their speed limits: which joint is the slowest can change.
LINEAR_RESERVE = 2.0
TIME_CONSTANTS = 8.0  # time constants that a run needs to reach its goal
# Noise of the error in tolerances: the largest for which a larger target is suggested; the value
# that is assumed where the noise is unknown; and the value that reduced noise should reach.
NOISE_OF_SMALL_TARGET, NOISE_WHEN_UNKNOWN, TOLERATED_NOISE = 2.0, 50.0, 0.5
SETTLING_TIME = 3.0  # s that the error has to stay small, with a reserve
# Schemes that measure rotations near 180 degrees and take a straight path from most starts.
HALF_TURN_SCHEMES = "pose, two_and_half_d or polar_points"
PACKAGE = __name__.partition(".")[0]


def is_user_scheme(scheme: Scheme | JointController) -> bool:
    """Return whether a scheme or one of its features is user code."""
    parts = getattr(scheme, "features", ()) or (scheme,)
    return any(
        isinstance(part, SchemeBase | Feature)
        and not type(part).__module__.startswith(f"{PACKAGE}.") for part in parts
    )  # fmt: skip


def find_gain(scheme: Scheme | JointController | None) -> float | None:
    """Return the greatest gain of a scheme's control law, 1/s, or None if the law has no gain."""
    law = getattr(scheme, "law", None)
    known = (getattr(law, name, None) for name in ("gain", "zero", "infinity"))
    return max((value for value in known if value is not None), default=None)


def can_oscillate(scheme: Scheme | JointController | None, frequency: float) -> bool:
    """Return whether a loop with the gain of this scheme can oscillate at a frequency, Hz.

    The joints integrate their commanded velocities, so a loop that oscillates at f has a gain of at
    least 2 pi f.
    """
    gain = find_gain(scheme)
    return gain is None or gain > MIN_GAIN_PART * 2.0 * pi * frequency


def suggest_gain(
    scheme: Scheme | JointController | None, frequency: float | None, duration: float
) -> Remedy:
    """Suggest the gain at which a loop that oscillates at `frequency` Hz comes to rest.

    Args:
        frequency: in Hz, or None if it is unknown.
        duration: time limit of the run, s, within which it has to reach its goal.
    """
    advice = (
        "lower the gain or the delay between image and command; if the camera shakes, mount it "
        "more firmly"
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
    """Return the change to a longer duration (s) if a loop of this gain (1/s) needs one."""
    needed = (TIME_CONSTANTS / gain + SETTLING_TIME) / duration
    return (multiply("duration", needed),) if isfinite(duration) and needed > 1.0 else ()


def suggest_more_time(duration: float, size: float, rate: float, linear: bool = False) -> Remedy:
    """Suggest the duration that the run needs to reach its goal at the present rate.

    Args:
        duration: time limit of the run, s.
        size: of the error, in tolerances.
        rate: at which the error shrinks: 1/s if exponentially, tolerances per second if linearly.
        linear: whether the error shrinks linearly, because joints are at their speed limits.
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
    """Suggest another scheme for a camera retreat, a local minimum or a singularity."""
    is_user = is_user_scheme(scheme)
    if candidate.kind == "singular":
        advice = (
            "use other features, more features or another posture; for rotations near 180 degrees "
            f"use {HALF_TURN_SCHEMES}"
        )
        return Remedy(advice, set_value("scheme", "moments"))
    if is_user:
        return Remedy(
            "check whether a built-in scheme reaches the goal", set_value("scheme", "points")
        )
    if candidate.kind == "camera_retreat":
        advice = f"use features that do not make the camera retreat ({HALF_TURN_SCHEMES})"
        return Remedy(advice, *_suggest_replacement(scheme, "polar_points"))
    advice = (
        "set interaction to desired or mean; for rotations near 180 degrees use "
        f"{HALF_TURN_SCHEMES}"
    )
    return Remedy(advice, *_suggest_replacement(scheme, "pose"))


def _suggest_replacement(scheme: Scheme | JointController, name: str) -> tuple[Change, ...]:
    """Return the changes to another scheme, or to a closer start if it is in use already."""
    features = getattr(scheme, "features", ())
    if any(feature.name == name for feature in features):
        return (START_CLOSER,)
    changes = (set_value("scheme", name),)
    if getattr(scheme, "interaction", "current") != "current":
        changes += (set_value("interaction", "current"),)
    return changes


def suggest_larger_target(noise: float, *others: Change) -> Remedy:
    """Suggest less noise for an error that scatters by more than its tolerance.

    A larger target is suggested where it is sufficient, otherwise less jitter and image noise.

    Args:
        noise: scatter of the error, in tolerances; 0 if it is unknown.
        others: further changes that the run needs.
    """
    noise = noise or NOISE_WHEN_UNKNOWN
    changes = (multiply("target.size", max(noise, 1.3)),)
    if noise > NOISE_OF_SMALL_TARGET:
        changes = (
            multiply("jitter", TOLERATED_NOISE / noise),
            multiply("noise", TOLERATED_NOISE / noise),
        )
    return Remedy(
        "reduce the measurement noise by more light, a shorter distance, other features or a "
        "larger target",
        *changes, *others,
    )


def suggest_faster_joints(advice: Remedy) -> Remedy:
    """Add a shorter lag to the advice, for joints that follow their commands too slowly."""
    return Remedy(str(advice), multiply("lag", 0.02))


def suggest_wider_limits(keys: Sequence[str]) -> Remedy:
    """Suggest the robot's own joint limits instead of the parameters `keys` that narrow them."""
    return Remedy(
        "use the robot's own joint limits, or start from another posture",
        *map(remove, keys),
    )


def suggest_longer_watchdog(longest: float, gain: float | None, duration: float) -> Remedy:
    """Suggest a longer watchdog and a lower gain for a loop whose images are rare.

    Args:
        longest: longest time between two images, s.
        gain: of the control law, 1/s, or None if it is unknown.
        duration: time limit of the run, s.
    """
    changes = [set_value("watchdog", round(2.0 * longest, 2))]
    if gain is not None:
        factor = min(0.3 / (gain * longest), 1.0)
        changes.append(multiply("gain", factor))
        changes += _compute_duration(gain * factor, duration)
    return Remedy(
        "raise the camera's frame rate, or find out what delays its images; at this frame rate, "
        "raise the watchdog's time", *changes,
    )  # fmt: skip
