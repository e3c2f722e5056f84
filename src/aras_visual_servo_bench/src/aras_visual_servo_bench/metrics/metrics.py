"""What is told of a run by one number: the table of all metrics, each with unit and formula.

Studies, protocols, reports and the analysis of bags read them here and nowhere else. A user's own
is named 'package.module:function' and decorated the same way:

    @metric(unit="m", better="smaller", source="this paper, equation 3")
    def closest(run: Run) -> float: ...
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.names import import_object, suggest
from aras_visual_servo_base.poses import inverse, pose_difference

from ..errors import StudyError, ViewError
from ..recording.run import Run, compute_settling_time, normalize_errors
from . import decay

SMALLER, GREATER, NEITHER = "smaller", "greater", ""
LIMIT_MARGIN = 1e-3  # part of a joint's range
SETTLING_BAND, DECAY_START, DECAY_END = 0.02, 0.80, 0.15  # parts of the first error
REDUCTION = 0.1  # part of the first distance and angle
LATE_PERIODS = 1.5  # image periods


@dataclass(frozen=True)
class Metric:
    """A function of a run; NaN where the run has no such number.

    name: column in the results. unit: '' for none. better: 'smaller', 'greater' or ''.
    source: its formula, or where it is defined. measure: the function.
    of_features: measured on the scheme's own features, so that it means something else of another
        scheme.
    default: measured where a study names no metrics.
    """

    name: str
    unit: str
    better: str
    source: str
    measure: Callable[[Run], float]
    is_feature_based: bool = False
    default: bool = False

    @property
    def text(self) -> str:
        """What it is, in a line."""
        return (self.measure.__doc__ or "").strip().splitlines()[0]


def metric(
    unit: str, better: str, source: str, is_feature_based: bool = False, default: bool = False
) -> Callable[[Callable], Metric]:
    """Return a decorator that makes a metric of a function from a `Run` to a number.

    The function's name is the column in results, the first line of its docstring the description.

    Args:
        unit: of the number; '' if it has none.
        better: 'smaller', 'greater', or '' if neither is better.
        source: formula, or where it is defined.
        of_features: whether it is measured on the scheme's own features, so that values of
            different schemes cannot be compared.
        default: whether it is measured if a study names no metrics.

    Raises:
        StudyError: `better` is none of these.
    """
    if better not in (SMALLER, GREATER, NEITHER):
        raise StudyError(f"better is '{better}', must be {SMALLER} or {GREATER}")
    return lambda measure: Metric(
        measure.__name__, unit, better, source, measure, is_feature_based, default
    )


def list_default_metrics() -> tuple[str, ...]:
    """Return the names of the metrics of a study that names none."""
    return tuple(name for name, one in METRICS.items() if one.default)


def find_metric(name: str) -> Metric:
    """The metric of that name, built in or a user's own.

    Raises:
        StudyError: there is none, with the nearest name.
    """
    if ":" not in name:
        if name not in METRICS:
            raise StudyError(f"unknown metric '{name}': {suggest(name, METRICS)}")
        return METRICS[name]
    found = import_object("metric", name, StudyError)
    if not isinstance(found, Metric):
        raise StudyError(f"{name} is no metric: decorate it with @metric(unit, better, source)")
    return found


# -- how it ended ------------------------------------------------------------------------------


@metric("", GREATER, "the loop's outcome and the physics' verdict together", default=True)
def success(run: Run) -> float:
    """1 where the loop holds that it has converged and the camera truly stands at its goal."""
    return _score_verdict(run, run.is_success)


@metric("", GREATER, "the physics' verdict alone, within the experiment's `reached`")
def reached(run: Run) -> float:
    """1 where the camera truly stands at its goal, whatever the loop holds."""
    return _score_verdict(run, run.verdict.is_reached)


@metric("", GREATER, "final distance and angle over those of the start, both at most 0.1")
def reduced(run: Run) -> float:
    """1 where a tenth or less is left of both the distance and the angle of the start."""
    distance, angle = _compute_initial_pose_error(run)
    near = run.verdict.distance <= REDUCTION * distance and run.verdict.angle <= REDUCTION * angle
    return _score_verdict(run, near)


@metric("", SMALLER, "success of the loop's word against the physics' verdict", default=True)
def contradicts(run: Run) -> float:
    """1 where the loop holds for reached what the physics knows is not, or the other way round.

    A loop that has converged up to a motion that it names leaves open whether it is there.
    """
    up_to = run.outcome.startswith("converged up to ")
    return _score_verdict(run, not up_to and run.converged != run.verdict.is_reached)


@metric("", NEITHER, "images that were answered, less the one that ended the run")
def iterations(run: Run) -> float:
    """Motions until the last image."""
    return float(max(len(run.stamp) - 1, 0))


@metric("s", SMALLER, "control's 2 % band, of the camera's true distance", default=True)
def settled(run: Run) -> float:
    """Time until the camera stays within 2 % of its first distance from the goal."""
    return _to_finite(run.compute_settling_time())


@metric(
    "", SMALLER, "control's overshoot, of the worst feature", is_feature_based=True, default=True
)
def overshoot(run: Run) -> float:
    """How far a feature's error goes beyond its goal, as a part of its first error."""
    error = run.error[_find_measured_images(run)]
    if not error.size:
        return np.nan
    size = np.abs(error[0])
    # A feature that begins at its goal has no first error to compare with.
    moving = size > SETTLING_BAND * np.max(size, initial=0.0)
    if not moving.any():
        return 0.0
    beyond = -np.sign(error[0, moving]) * error[:, moving] / size[moving]
    return float(max(beyond.max(), 0.0))


# -- places of the camera ----------------------------------------------------------------------


@metric("m", SMALLER, "pose of the physics", default=True)
def final_distance(run: Run) -> float:
    """How far the camera is from its goal at the end."""
    return run.verdict.distance


@metric("rad", SMALLER, "pose of the physics", default=True)
def final_angle(run: Run) -> float:
    """How far the camera is turned from its goal at the end."""
    return run.verdict.angle


@metric("m", SMALLER, "the loop's 99.7 % bound; NaN where it has not arrived")
def open_distance(run: Run) -> float:
    """How far from its goal the loop leaves open that the camera is."""
    left = run.states[-1].arrival_status.pose_uncertainty if run.states else None
    return np.nan if left is None else left.distance


@metric("rad", SMALLER, "the loop's 99.7 % bound; NaN where it has not arrived")
def open_angle(run: Run) -> float:
    """How far turned from its goal the loop leaves open that the camera is."""
    left = run.states[-1].arrival_status.pose_uncertainty if run.states else None
    return np.nan if left is None else left.angle


@metric("m", NEITHER, "true_pose of the first joint state since the first image")
def start_distance(run: Run) -> float:
    """How far the camera is from its goal at the first image."""
    return _compute_initial_pose_error(run)[0]


@metric("rad", NEITHER, "true_pose of the first joint state since the first image")
def start_angle(run: Run) -> float:
    """How far the camera is turned from its goal at the first image."""
    return _compute_initial_pose_error(run)[1]


@metric(
    "m", SMALLER, "sum of the distances between joint states since the first image", default=True
)
def path_length(run: Run) -> float:
    """Length of the camera's path."""
    places = run.true_pose[run.servoing, :3, 3]
    if not len(places):
        return np.nan
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


@metric("", SMALLER, "path_length / start_distance; 1 is a straight line", default=True)
def path_ratio(run: Run) -> float:
    """Length of the camera's path over the distance from its start to its goal."""
    straight = _compute_initial_pose_error(run)[0]
    return path_length.measure(run) / straight if straight > 1e-6 else np.nan


@metric("m", SMALLER, "z of the target's middle in the true camera, greatest of all images")
def largest_depth(run: Run) -> float:
    """Farthest that the target has been along the optical axis."""
    if run.target is None or not len(run.stamp):
        return np.nan
    middle = np.array([0.0, 0.0, run.target.shape.height, 1.0])
    seen = (inverse(pose) @ run.target.world_T_target(float(stamp)) @ middle
            for pose, stamp in zip(run.pose, run.stamp, strict=True))  # fmt: skip
    return float(max(z for _, _, z, _ in seen))


# -- joints ------------------------------------------------------------------------------------


@metric(
    "rad²/s", SMALLER, "integral of the squared joint speeds; m²/s for joints that slide",
    default=True,
)  # fmt: skip
def energy(run: Run) -> float:
    """What the joints' motion costs: the integral of the sum of their squared speeds."""
    after = run.servoing
    if after.sum() < 2:
        return np.nan
    power = np.square(run.measured_velocities[after]).sum(axis=1)
    return float(np.trapezoid(power, run.joint_stamp[after]))


@metric("s", SMALLER, "joint states, limits of the description", default=True)
def limit_time(run: Run) -> float:
    """Time during which a joint stands at one of its limits."""
    after = run.servoing
    lower, upper = run.position_limits
    if after.sum() < 2:
        return np.nan
    if lower.shape != run.measured_positions.shape[1:]:
        return 0.0
    margin = LIMIT_MARGIN * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    q = run.measured_positions[after]
    at = ((q <= lower + margin) | (q >= upper - margin)).any(axis=1)
    return float(np.diff(run.joint_stamp[after])[at[:-1]].sum())


# -- the image ---------------------------------------------------------------------------------


@metric("", SMALLER, "exact projection of the target's corners by the true camera", default=True)
def image_excursion(run: Run) -> float:
    """Farthest place of a corner from the image's centre, in half sizes: above 1 it was outside."""
    target, camera = run.target, run.camera
    if target is None or camera is None:
        return np.nan
    half = np.array([camera.width, camera.height]) / 2.0
    worst = np.nan
    for stamp, pose in zip(run.stamp, run.pose, strict=True):
        try:
            seen = target.shape.points(target.target_T_camera(pose, float(stamp)))
        except ViewError:
            return float("inf")
        pixels = np.column_stack(camera.project(*seen.T)) + 0.5
        worst = np.fmax(worst, np.abs(pixels / half - 1.0).max())
    return float(worst)


# -- errors of the features --------------------------------------------------------------------


@metric(
    "1/s", GREATER, "logarithm of the error between 80 and 15 % of its first value",
    is_feature_based=True, default=True,
)  # fmt: skip
def decay_rate(run: Run) -> float:
    """How fast the norm of the features' error, each in parts of its first, decays."""
    known = _find_measured_images(run)
    stamp, error = run.stamp[known], run.error[known]
    if not len(stamp):
        return np.nan
    first = np.abs(error[0])
    error = error[:, first > SETTLING_BAND * first.max()]
    if not error.size:
        return np.nan
    part = np.linalg.norm(error / np.abs(error[0]), axis=1)
    part = part / part[0]
    begin, end = int(np.argmax(part < DECAY_START)), int(np.argmax(part < DECAY_END)) or len(part)
    if end - begin < 4:
        return np.nan
    return float(-np.polyfit(stamp[begin:end], np.log(part[begin:end]), 1)[0])


@metric("1/s", NEITHER, "slowest root of the sampled loop with its delay: metrics/decay.py")
def decay_predicted(run: Run) -> float:
    """How fast the errors ought to decay by the experiment's gain and delay."""
    if run.experiment is None or run.experiment.gain is None or len(run.stamp) < 2:
        return np.nan
    period = float(np.median(np.diff(run.stamp)))
    return decay.predict_decay_rate(
        run.experiment.gain, decay.compute_delay(run.experiment), period
    )


@metric(
    "s", SMALLER, "2 % band of the norm of the errors, each in parts of its largest",
    is_feature_based=True,
)  # fmt: skip
def error_settled(run: Run) -> float:
    """Time until the norm of the features' errors stays under 2 % of its first."""
    known = _find_measured_images(run)
    return _to_finite(
        compute_settling_time(
            run.stamp[known], np.linalg.norm(normalize_errors(run.error[known]), axis=1)
        )
    )


# -- the loop ----------------------------------------------------------------------------------


@metric("s", NEITHER, "stamps of the images")
def servoing_time(run: Run) -> float:
    """From the first image that was answered to the last."""
    return float(np.ptp(run.stamp)) if len(run.stamp) else 0.0


@metric("m/s", NEITHER, "translation of the twist that the joint velocities give")
def top_speed(run: Run) -> float:
    """Greatest speed of the camera that the joints were given."""
    return float(np.nanmax(np.linalg.norm(run.achieved_twist[:, :3], axis=1), initial=0.0))


@metric("", GREATER, "L J of each image", is_feature_based=True)
def smallest_singular_value(run: Run) -> float:
    """Least singular value of the task's Jacobian L J."""
    return _to_finite(np.nanmin(run.singular_LJ, initial=np.inf))


@metric(
    "", SMALLER, "largest over smallest singular value of L, greatest of all images",
    is_feature_based=True,
)  # fmt: skip
def condition_L(run: Run) -> float:
    """Greatest condition number of L in the directions that are servoed."""
    found = condition_number(run.singular_L)
    return float(np.nanmax(found)) if not np.isnan(found).all() else np.nan


@metric("", GREATER, "sqrt(det(L J J^T L^T)), least of all images", is_feature_based=True)
def manipulability(run: Run) -> float:
    """Least product of the singular values of L J."""
    return _to_finite(np.nanmin(run.manipulability, initial=np.inf))


@metric("", GREATER, "the resolver's, least of all images")
def scale(run: Run) -> float:
    """Least factor by which limits slowed the task; 1: never."""
    return _to_finite(np.nanmin(run.scale, initial=np.inf))


# -- time and the machine ----------------------------------------------------------------------


@metric("", NEITHER, "exposures")
def images(run: Run) -> float:
    """Images that were recorded."""
    return float(len(run.control_record.stamp))


@metric("Hz", NEITHER, "images a second of simulated time")
def image_rate(run: Run) -> float:
    """Images a second of simulated time."""
    gaps = np.diff(run.control_record.stamp)
    return float(gaps.size / gaps.sum()) if gaps.size else np.nan


@metric("", SMALLER, "a gap of n periods counts n - 1, an image 1.5 periods after its exposure 1")
def images_late(run: Run) -> float:
    """Images that are missing, or came more than 1.5 periods after their exposure."""
    gaps = np.diff(run.control_record.stamp)
    if not gaps.size:
        return 0.0
    period = float(np.median(gaps))
    missing = np.maximum(np.round(gaps / period) - 1.0, 0.0).sum()
    return float(
        missing
        + np.count_nonzero(
            run.control_record.arrival - run.control_record.stamp > LATE_PERIODS * period
        )
    )


@metric("ms", NEITHER, "the recorder's clock; below 0 where that had not yet heard the time")
def delay(run: Run) -> float:
    """Mean time from an exposure until the recorder had it."""
    late = 1e3 * (run.control_record.arrival - run.control_record.stamp)
    return float(late.mean()) if late.size else np.nan


@metric("ms", NEITHER, "processor time")
def computing(run: Run) -> float:
    """Mean time that the scheme took for an image."""
    known = run.computation_time[np.isfinite(run.computation_time)]
    return 1e3 * float(known.mean()) if known.size else np.nan


@metric("", NEITHER, "simulated over wall time")
def real_time_factor(run: Run) -> float:
    """Simulated over wall time while servoing."""
    stamp, factor = run.real_time_factors.reshape(-1, 2).T
    during = (stamp >= run.start_stamp) & np.isfinite(factor)
    return float(factor[during].mean()) if during.any() else np.nan


def condition_number(singular: np.ndarray) -> np.ndarray:
    """Largest over smallest singular value of each image, (n, p) -> (n,); NaN where none is."""
    if not singular.shape[1]:
        return np.full(len(singular), np.nan)
    least = np.nanmin(np.where(np.isnan(singular), np.inf, singular), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.isfinite(least), singular[:, 0] / least, np.nan)


def _compute_initial_pose_error(run: Run) -> tuple[float, float]:
    """Distance, m, and angle, rad, from the camera's place at the first image to its goal."""
    poses = run.true_pose[run.servoing]
    return pose_difference(run.goal_pose, poses[0]) if len(poses) else (np.nan, np.nan)


def _score_verdict(run: Run, is_true: bool) -> float:
    """1 or 0; NaN where the goal, and so the verdict, is unknown."""
    return float(is_true) if run.verdict.name else np.nan


def _find_measured_images(run: Run) -> np.ndarray:
    """(n,) bool: images whose errors are all known."""
    return np.isfinite(run.error).all(axis=1) & bool(run.names)


def _to_finite(value: float) -> float:
    return float(value) if np.isfinite(value) else np.nan


METRICS: dict[str, Metric] = {m.name: m for m in list(vars().values()) if isinstance(m, Metric)}
