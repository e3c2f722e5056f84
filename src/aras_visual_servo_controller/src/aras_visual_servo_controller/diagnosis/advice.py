"""Remedies computed from a run, such as the gain or the duration that the run needs."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, log, pi

from ..features.base import Feature
from ..records.outcomes import START_CLOSER, Outcome
from ..records.remedy import Remedy, SettingChange, multiply, remove, set_value
from ..schemes.base import JointController, Scheme, SchemeBase

# A loop with the dead time T (s) oscillates with a constant amplitude at the frequency f = 1 / (4
# T). Its error decays fastest without oscillation at the gain 1 / (e T) = 1.5 f. The suggested
# factor is smaller than 1.5, to leave a reserve.
GAIN_PER_HERTZ = 1.2  # suggested gain per frequency of the oscillation, 1/s per Hz
# A loop that oscillates at the frequency f has, in theory, a gain of 2 pi f or more. If L is too
# small, the effective gain is higher than the configured one. Therefore a configured gain of at
# least this fraction of 2 pi f is accepted as the cause of an oscillation.
MIN_GAIN_PART = 0.3
MAX_GAIN_FACTOR = 0.6  # a suggested gain is at most this fraction of the present gain
MIN_GAIN_FACTOR = 0.02  # a suggested gain is at least this fraction of the present gain
TIME_RESERVE = 1.5  # safety factor on the predicted time to the goal
MAX_TIME_FACTOR = 50.0  # the suggested duration is at most this many times the present one
# Factor on the remaining time if a joint moves at its speed limit. Another joint may reach its
# limit later and slow the arm down further.
LINEAR_RESERVE = 2.0
TIME_CONSTANTS = 8.0  # time that a run needs to reach its goal, in time constants (1 / gain)
# If the noise of the error is at most this many tolerances, a larger target is suggested. If it is
# greater, less image noise is suggested.
NOISE_OF_SMALL_TARGET = 2.0
NOISE_WHEN_UNKNOWN = 50.0  # noise of the error, in units of the tolerance, if it was not measured
# Noise of the error that the suggested change leaves, in units of the tolerance.
TOLERATED_NOISE = 0.5
SETTLING_TIME = 3.0  # time for which the error has to stay small, including a reserve, s
# Schemes that can turn the camera by 180 degrees on a straight path from most starts.
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
    """Return whether a loop with the gain of this scheme can oscillate at `frequency` (Hz).

    The joints integrate their commanded velocities, so a loop that oscillates at f has a gain of
    about 2 pi f or more. The function returns True for gains above MIN_GAIN_PART times this value.
    A scheme without a gain can oscillate at any frequency.
    """
    gain = find_gain(scheme)
    return gain is None or gain > MIN_GAIN_PART * 2.0 * pi * frequency


def suggest_gain(
    scheme: Scheme | JointController | None, frequency: float | None, duration: float
) -> Remedy:
    """Suggest the gain at which a loop that oscillates at `frequency` Hz comes to rest.

    Args:
        frequency: frequency of the oscillation, Hz; None if it is unknown.
        duration: time limit of the run, s.
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
        return Remedy(
            advice, multiply("law_options.zero", 0.3), multiply("law_options.infinity", 0.3)
        )
    return Remedy(advice)


def _compute_duration(gain: float, duration: float) -> tuple[SettingChange, ...]:
    """Suggest a longer duration if a run has too little time at this gain.

    Return the change of the setting `duration`, or () if the present duration is sufficient.

    Args:
        gain: gain of the control law, 1/s.
        duration: time limit of the run, s.
    """
    needed = (TIME_CONSTANTS / gain + SETTLING_TIME) / duration
    return (multiply("duration", needed),) if isfinite(duration) and needed > 1.0 else ()


def suggest_more_time(duration: float, size: float, rate: float, linear: bool = False) -> Remedy:
    """Suggest the duration that the run needs to reach its goal at the present rate.

    Args:
        duration: time limit of the run, s; inf if there is none.
        size: size of the error, in units of the tolerance.
        rate: rate at which the error decreases: in 1/s for an exponential decrease, in units of the
            tolerance per second for a linear one.
        linear: whether the error decreases linearly, because joints are at their speed limits.
    """
    advice = "allow more time, or raise the gain"
    if linear:
        advice = "allow more time, or raise max_velocity or max_acceleration"
    if not isfinite(duration):
        return Remedy(advice)
    if rate <= 0.0:
        return Remedy(advice, multiply("duration", 10.0 if linear else 3.0))
    left = LINEAR_RESERVE * size / rate if linear else log(max(size / 0.3, 2.0)) / rate
    factor = 1.0 + TIME_RESERVE * (left + SETTLING_TIME) / duration
    return Remedy(advice, multiply("duration", min(factor, MAX_TIME_FACTOR)))


def suggest_scheme(candidate: Outcome, scheme: Scheme | JointController) -> Remedy:
    """Suggest another scheme for a run that a camera retreat, local minimum or singularity stopped.

    Args:
        candidate: outcome that names the cause.
        scheme: scheme of the run.
    """
    if candidate.kind == "singular":
        advice = (
            "use other features, more features or another posture; for rotations near 180 degrees "
            f"use {HALF_TURN_SCHEMES}"
        )
        return Remedy(advice, set_value("scheme", "moments"))
    if is_user_scheme(scheme):
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


def _suggest_replacement(scheme: Scheme | JointController, name: str) -> tuple[SettingChange, ...]:
    """Suggest the scheme `name`, or a start closer to the goal if that scheme is already in use.

    Return the changes of the settings.
    """
    features = getattr(scheme, "features", ())
    if any(feature.name == name for feature in features):
        return (START_CLOSER,)
    changes = (set_value("scheme", name),)
    if getattr(scheme, "interaction", "current") != "current":
        changes += (set_value("interaction", "current"),)
    return changes


def suggest_larger_target(noise: float, *others: SettingChange) -> Remedy:
    """Suggest how to reduce the noise of an error that scatters by more than its tolerance.

    The suggestion is a larger target if that is sufficient, otherwise less jitter and image noise.

    Args:
        noise: scatter of the error, in units of the tolerance; 0 if it is unknown.
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
    """Add a smaller time constant of the joints (setting `lag`) to the given advice."""
    return Remedy(advice.advice, *advice.changes, multiply("lag", 0.02))


def suggest_wider_limits(keys: Sequence[str]) -> Remedy:
    """Suggest the robot's own joint limits instead of the parameters `keys` that narrow them."""
    return Remedy(
        "use the robot's own joint limits, or start from another posture",
        *map(remove, keys),
    )


def suggest_longer_watchdog(longest: float, gain: float | None, duration: float) -> Remedy:
    """Suggest a longer watchdog and a lower gain for a loop that receives images rarely.

    Args:
        longest: longest time between two images, s.
        gain: gain of the control law, 1/s, or None if it is unknown.
        duration: time limit of the run, s.
    """
    changes = [set_value("watchdog", round(2.0 * longest, 2))]
    if gain is not None:
        factor = min(0.3 / (gain * longest), 1.0)
        changes.append(multiply("gain", factor))
        changes += _compute_duration(gain * factor, duration)
    return Remedy(
        "increase the camera's frame rate, remove the cause of the delay of its images, or "
        "increase the time limit `watchdog`", *changes,
    )  # fmt: skip
