"""All metrics; studies, protocols, reports and the analysis of bags use them."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.names import import_object, suggest
from aras_visual_servo_base.poses import inverse, pose_difference

from ..errors import OutOfViewError, StudyError
from ..recording.run import Run, compute_settling_time, normalize_errors
from . import decay
from .condition_number import compute_condition_numbers
from .metric import GREATER, NEITHER, SMALLER, Metric, metric

# A joint is at a limit if its distance from the limit is at most this fraction of its range.
LIMIT_MARGIN = 1e-3
# Metric `overshoot` ignores a feature whose initial error is at most this fraction of the largest
# initial error.
LEAST_START = 0.02
# metric `reduced` is 1 if final distance and angle are at most this fraction of the initial ones
REDUCTION = 0.1
# an image is late if the time from exposure to arrival exceeds this number of image periods
LATE_PERIODS = 1.5


def find_metric(name: str) -> Metric:
    """Return the built-in metric with this name, or the metric 'package.module:function'.

    Raises:
        StudyError: there is no such metric; the message suggests a similar name.
    """
    if ":" not in name:
        if name not in METRICS:
            raise StudyError(f"unknown metric '{name}': {suggest(name, METRICS)}")
        return METRICS[name]
    found = import_object("metric", name, StudyError)
    if not isinstance(found, Metric):
        raise StudyError(f"{name} is not a metric: decorate it with @metric(unit, better, source)")
    return found


@metric(
    "", GREATER, "outcome of the loop, and verdict from the true camera pose", default=True,
    is_binary=True, has_tolerance=True,
)  # fmt: skip
def success(run: Run) -> float:
    """1 if the loop has converged and the camera is truly at its goal."""
    return _score_verdict(run, run.is_success)


@metric(
    "", GREATER, "verdict from the true camera pose, with the experiment's tolerance `reached`",
    is_binary=True, has_tolerance=True,
)  # fmt: skip
def reached(run: Run) -> float:
    """1 if the camera is truly at its goal, whatever outcome the loop reports."""
    return _score_verdict(run, run.verdict.is_reached)


@metric(
    "", GREATER, "final distance and angle to the goal, each at most 0.1 of its initial value",
    is_binary=True,
)  # fmt: skip
def reduced(run: Run) -> float:
    """1 if the final distance and angle to the goal are at most a tenth of the initial ones."""
    distance, angle = _compute_initial_pose_error(run)
    near = run.verdict.distance <= REDUCTION * distance and run.verdict.angle <= REDUCTION * angle
    return _score_verdict(run, near)


@metric(
    "", SMALLER, "outcome of the loop, compared with the verdict from the true camera pose",
    default=True, is_binary=True, has_tolerance=True,
)  # fmt: skip
def contradicts(run: Run) -> float:
    """1 if the loop reports convergence away from the goal, or no convergence at the goal.

    The result is 0 if the outcome starts with 'converged up to', because the loop then does not
    state whether the camera is at its goal.
    """
    up_to = run.outcome.startswith("converged up to ")
    return _score_verdict(run, not up_to and run.converged != run.verdict.is_reached)


@metric("", NEITHER, "number of processed images, without the image that ended the run")
def iterations(run: Run) -> float:
    """Number of camera motions from the first to the last processed image."""
    return float(max(len(run.stamp) - 1, 0))


@metric(
    "s", SMALLER, "2 % settling time of the camera's true distance and angle to its goal",
    default=True,
)  # fmt: skip
def settled(run: Run) -> float:
    """Time after which distance and angle to the goal stay below 2 % of their initial values."""
    return _to_finite(run.compute_settling_time())


@metric(
    "", SMALLER, "largest error of a feature after a change of its sign, divided by its "
    "first error", is_feature_based=True, default=True,
)  # fmt: skip
def overshoot(run: Run) -> float:
    """Largest overshoot of a feature beyond its goal, relative to its initial error."""
    error = run.error[_find_measured_images(run)]
    if not error.size:
        return np.nan
    size = np.abs(error[0])
    # A feature that starts at its goal is ignored, because its overshoot would be divided by its
    # initial error, 0.
    moving = size > LEAST_START * np.max(size, initial=0.0)
    if not moving.any():
        return 0.0
    excess = -np.sign(error[0, moving]) * error[:, moving] / size[moving]
    return float(max(excess.max(), 0.0))


@metric("m", SMALLER, "computed from the true camera pose in the simulation", default=True)
def final_distance(run: Run) -> float:
    """Distance of the camera from its goal at the end."""
    return run.verdict.distance


@metric("rad", SMALLER, "computed from the true camera pose in the simulation", default=True)
def final_angle(run: Run) -> float:
    """Angle between the orientations of the camera and of its goal at the end."""
    return run.verdict.angle


@metric("m", SMALLER, "99.7 % bound that the loop computes; NaN if the loop has not converged")
def open_distance(run: Run) -> float:
    """Upper bound that the loop computes for the final distance from the goal."""
    left = run.states[-1].arrival_status.pose_uncertainty if run.states else None
    return np.nan if left is None else left.distance


@metric("rad", SMALLER, "99.7 % bound that the loop computes; NaN if the loop has not converged")
def open_angle(run: Run) -> float:
    """Upper bound that the loop computes for the final angle to the goal."""
    left = run.states[-1].arrival_status.pose_uncertainty if run.states else None
    return np.nan if left is None else left.angle


@metric("m", NEITHER, "computed from the true camera pose at the first joint state while servoing")
def start_distance(run: Run) -> float:
    """Distance of the camera from its goal at the first image."""
    return _compute_initial_pose_error(run)[0]


@metric(
    "rad", NEITHER, "computed from the true camera pose at the first joint state while servoing"
)  # fmt: skip
def start_angle(run: Run) -> float:
    """Angle between the orientations of the camera and of its goal at the first image."""
    return _compute_initial_pose_error(run)[1]


@metric(
    "m", SMALLER, "sum of the distances between the true camera positions of successive joint "
    "states since the first image", default=True,
)
def path_length(run: Run) -> float:
    """Length of the camera's path."""
    places = run.true_pose[run.servoing, :3, 3]
    if not len(places):
        return np.nan
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


@metric("", SMALLER, "path_length / start_distance; 1 for a straight path", default=True)
def path_ratio(run: Run) -> float:
    """Length of the camera's path relative to the distance from its start to its goal."""
    straight = _compute_initial_pose_error(run)[0]
    return path_length.measure(run) / straight if straight > 1e-6 else np.nan


@metric("m", SMALLER, "largest z of the target's centre in the true camera frame over all images")
def largest_depth(run: Run) -> float:
    """Largest depth of the target along the optical axis."""
    if run.target is None or not len(run.stamp):
        return np.nan
    middle = np.array([0.0, 0.0, run.target.shape.height, 1.0])
    middles = (inverse(pose) @ run.target.world_T_target(float(stamp)) @ middle
            for pose, stamp in zip(run.pose, run.stamp, strict=True))  # fmt: skip
    return float(max(z for _, _, z, _ in middles))


@metric(
    "rad²/s", SMALLER, "time integral of the squared joint speeds; m²/s for prismatic joints",
    default=True,
)  # fmt: skip
def energy(run: Run) -> float:
    """Integral of the sum of the squared joint speeds."""
    after = run.servoing
    if after.sum() < 2:
        return np.nan
    power = np.square(run.measured_velocities[after]).sum(axis=1)
    return float(np.trapezoid(power, run.joint_stamp[after]))


@metric(
    "s", SMALLER, "computed from the joint states and the joint limits in the robot description",
    default=True,
)  # fmt: skip
def limit_time(run: Run) -> float:
    """Time during which a joint is at one of its limits."""
    after = run.servoing
    lower, upper = run.position_limits
    if after.sum() < 2:
        return np.nan
    if lower.shape != run.measured_positions.shape[1:]:
        return 0.0
    margin = LIMIT_MARGIN * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    q = run.measured_positions[after]
    is_at_limit = ((q <= lower + margin) | (q >= upper - margin)).any(axis=1)
    return float(np.diff(run.joint_stamp[after])[is_at_limit[:-1]].sum())


@metric(
    "", SMALLER, "computed from the exact projection of the target's corners into the true camera",
    default=True,
)  # fmt: skip
def image_excursion(run: Run) -> float:
    """Largest offset of a target corner from the image centre; it is 1 at the border of the image.

    Horizontal offsets are divided by half the image width, vertical ones by half the height.
    """
    target, camera = run.target, run.camera
    if target is None or camera is None:
        return np.nan
    half = np.array([camera.width, camera.height]) / 2.0
    worst = np.nan
    for stamp, pose in zip(run.stamp, run.pose, strict=True):
        try:
            points = target.shape.points(target.target_T_camera(pose, float(stamp)))
        except OutOfViewError:
            return float("inf")
        pixels = np.column_stack(camera.project(*points.T)) + 0.5
        worst = np.fmax(worst, np.abs(pixels / half - 1.0).max())
    return float(worst)


@metric(
    "1/s", GREATER, "negative slope of the logarithm of the error norm, fitted while this "
    "norm is between 80 and 15 % of its first value", is_feature_based=True, default=True,
)  # fmt: skip
def decay_rate(run: Run) -> float:
    """Decay rate of the norm of the errors; each error is divided by its initial value."""
    known = _find_measured_images(run)
    return decay.fit_decay_rate(run.stamp[known], run.error[known])


@metric("1/s", NEITHER, "slowest pole of the sampled loop with delay, see metrics/decay.py")
def decay_predicted(run: Run) -> float:
    """Decay rate of the errors that is predicted from the gain and the delay of the experiment."""
    if run.experiment is None or run.experiment.gain is None or len(run.stamp) < 2:
        return np.nan
    period = float(np.median(np.diff(run.stamp)))
    delay = decay.compute_delay(run.experiment)
    return decay.predict_decay_rate(run.experiment.gain, delay, period)


@metric(
    "s", SMALLER, "2 % settling time of the norm of the errors, each divided by its largest value",
    is_feature_based=True,
)  # fmt: skip
def error_settled(run: Run) -> float:
    """Time after which the norm of the errors stays below 2 % of its value at the first image."""
    known = _find_measured_images(run)
    norm = np.linalg.norm(normalize_errors(run.error[known]), axis=1)
    return _to_finite(compute_settling_time(run.stamp[known], norm))


@metric("s", NEITHER, "last stamp minus first stamp of the processed images")
def servoing_time(run: Run) -> float:
    """Time from the first to the last processed image."""
    return float(np.ptp(run.stamp)) if len(run.stamp) else 0.0


@metric("m/s", NEITHER, "linear part of the camera twist at the commanded joint velocities")
def top_speed(run: Run) -> float:
    """Largest linear speed of the camera that the commanded joint velocities produce."""
    return float(np.nanmax(np.linalg.norm(run.achieved_twist[:, :3], axis=1), initial=0.0))


@metric(
    "", GREATER, "smallest singular value of the task Jacobian L J over all images",
    is_feature_based=True,
)  # fmt: skip
def smallest_singular_value(run: Run) -> float:
    """Smallest singular value of the task Jacobian L J over all images."""
    return _to_finite(np.nanmin(run.singular_LJ, initial=np.inf))


@metric(
    "", SMALLER, "largest ratio of the largest to the smallest singular value of L over all images",
    is_feature_based=True,
)  # fmt: skip
def condition_L(run: Run) -> float:
    """Largest condition number of the interaction matrix L over all images.

    Components of the camera twist that the scheme does not control are left out of L.
    """
    found = compute_condition_numbers(run.singular_L)
    return float(np.nanmax(found)) if not np.isnan(found).all() else np.nan


@metric(
    "", GREATER, "smallest value of sqrt(det(L J J^T L^T)) over all images", is_feature_based=True
)  # fmt: skip
def manipulability(run: Run) -> float:
    """Smallest product of the singular values of the task Jacobian L J over all images."""
    return _to_finite(np.nanmin(run.manipulability, initial=np.inf))


@metric("", GREATER, "smallest scale factor of the differential inverse kinematics over all images")
def scale(run: Run) -> float:
    """Smallest factor by which limits reduced the camera velocity; 1 if they never did."""
    return _to_finite(np.nanmin(run.scale, initial=np.inf))


@metric("", NEITHER, "number of exposures of the control camera")
def images(run: Run) -> float:
    """Number of recorded images."""
    return float(len(run.control_record.stamp))


@metric("Hz", NEITHER, "(number of images - 1) / (last stamp - first stamp)")
def image_rate(run: Run) -> float:
    """Number of images per second of simulated time."""
    gaps = np.diff(run.control_record.stamp)
    return float(gaps.size / gaps.sum()) if gaps.size else np.nan


@metric(
    "", SMALLER, "n - 1 missing images in each gap of n periods, plus images later than 1.5 periods"
)  # fmt: skip
def images_late(run: Run) -> float:
    """Number of images that are missing or arrived more than 1.5 image periods after exposure."""
    gaps = np.diff(run.control_record.stamp)
    if not gaps.size:
        return 0.0
    period = float(np.median(gaps))
    missing = np.maximum(np.round(gaps / period) - 1.0, 0.0).sum()
    delays = run.control_record.arrival - run.control_record.stamp
    return float(missing + np.count_nonzero(delays > LATE_PERIODS * period))


@metric(
    "ms", NEITHER, "time of arrival on the recorder's clock minus stamp of the image; negative "
    "if the clock was late",
)  # fmt: skip
def delay(run: Run) -> float:
    """Mean time from an exposure until the recorder received the image."""
    late = 1e3 * (run.control_record.arrival - run.control_record.stamp)
    return float(late.mean()) if late.size else np.nan


@metric("ms", NEITHER, "processor time of the scheme, averaged over all images")
def computing(run: Run) -> float:
    """Mean processing time of the scheme per image."""
    known = run.computation_time[np.isfinite(run.computation_time)]
    return 1e3 * float(known.mean()) if known.size else np.nan


@metric("", NEITHER, "simulated time divided by wall time, averaged while servoing")
def real_time_factor(run: Run) -> float:
    """Ratio of simulated time to wall time while servoing."""
    stamp, factor = run.real_time_factors.reshape(-1, 2).T
    during = (stamp >= run.start_stamp) & np.isfinite(factor)
    return float(factor[during].mean()) if during.any() else np.nan


def _compute_initial_pose_error(run: Run) -> tuple[float, float]:
    """Compute distance (m) and rotation angle (rad) from the first camera pose to the goal pose."""
    poses = run.true_pose[run.servoing]
    return pose_difference(run.goal_pose, poses[0]) if len(poses) else (np.nan, np.nan)


def _score_verdict(run: Run, is_true: bool) -> float:
    """Return 1 if the statement `is_true` about a run holds, else 0.

    Return NaN if it is unknown whether the camera has reached its goal.
    """
    return float(is_true) if run.verdict.name else np.nan


def _find_measured_images(run: Run) -> np.ndarray:
    """Return a mask (n,) of the images in which all errors are known."""
    return np.isfinite(run.error).all(axis=1) & bool(run.names)


def _to_finite(value: float) -> float:
    return float(value) if np.isfinite(value) else np.nan


METRICS: dict[str, Metric] = {m.name: m for m in list(vars().values()) if isinstance(m, Metric)}
