"""Record of one run: measurements and commands of the loop, true camera poses, and the result.

The runner, a bag and a ROS graph all give a run in this form.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.records.state import CONVERGED, ServoState

from ..experiment.experiment import Experiment
from ..targets.geometry import PlacedTarget
from .camera_record import CameraRecord
from .presentable_run import PresentableRun
from .verdict import Verdict

SETTLING_BAND = 0.02  # an error is settled if it is below this fraction of its initial value


@dataclass(eq=False, repr=False)
class Run(PresentableRun):
    """Record of one run: measurements and commands of the loop, true camera poses, and the result.

    The functions `run` and `load_run` and the method `Loop.make_run` return a Run. The methods
    `plot`, `report` and `to_pandas` of its base class PresentableRun show it. In the shapes of
    arrays, n is the number of images that the loop has processed, k the number of features, m the
    number of joint states, and j the number of joints. Unknown values are None, NaN or empty. Poses
    are world_T_camera (4, 4); lengths are in m, angles in rad, times in s.

    Attributes:
        states: state of the control loop after each of the n images.
        pose: (n, 4, 4) true world_T_camera at the time when the loop has processed each image, with
            vibration.
        joint_names: names of the j joints.
        joint_stamp: (m,) stamp of each joint state, s.
        measured_positions: (m, j) joint positions of each joint state, rad or m.
        measured_velocities: (m, j) joint velocities of each joint state, rad/s or m/s.
        joint_commands: (m, j) latest command at each joint state; NaN before the first command.
        true_pose: (m, 4, 4) world_T_camera at each joint state, without vibration, computed from
            `measured_positions` with the true kinematics. The metrics of the camera path use it.
        joint_origins: (m, l, 3) origins of the arm's l joint frames in the world at each joint
            state, m; l = 0 without an arm, or if they were not computed.
        goal_pose: (4, 4) desired pose of the camera at the end.
        outcome: outcome of the run, as the loop reports it, such as 'converged'.
        reason: reason of the outcome.
        remedy: what to change after a failure.
        verdict: result according to the true pose at the end, without vibration; for a run from a
            bag, according to the last `true_pose`.
        peak_speed: (j,) maximum speed of each joint over all physics steps; None if it was not
            recorded.
        name: name of the run, for legends.
        source: bag, file or study from which the run comes, as text.
        units: (k,) unit of each feature.
        tolerances: (k,) tolerance of each feature.
        position_limits: lower limits (j,) and upper limits (j,) of the joints, rad or m.
        speed_limits: (j,) speed limit of each joint, rad/s or m/s.
        joint_units: (j,) unit of each joint, 'rad' or 'm'.
        cameras: record of each camera, by name; the first is the control camera.
        target: target of the control camera, with its pose in the world.
        goal: goal of the control loop.
        centres: (n, 2) measured centre of gravity of the target, in normalised coordinates.
        real_time_factors: (p, 2) pairs of stamp (s) and real-time factor.
        settings: settings of the run as text, by name.
        versions: versions of the software that affects the results.
        notes: warnings that limit the meaning of the results.
        experiment: settings from which the run was made; None if unknown.
        yaml: YAML text of an experiment that repeats the run; '' if unknown.
    """

    states: tuple[ServoState, ...]
    pose: np.ndarray
    joint_names: tuple[str, ...]
    joint_stamp: np.ndarray
    measured_positions: np.ndarray
    measured_velocities: np.ndarray
    joint_commands: np.ndarray
    true_pose: np.ndarray
    goal_pose: np.ndarray
    outcome: str
    reason: str
    remedy: str
    verdict: Verdict
    peak_speed: np.ndarray | None = None
    joint_origins: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    name: str = ""
    source: str = ""
    units: tuple[str, ...] = ()
    tolerances: tuple[float, ...] = ()
    position_limits: tuple[np.ndarray, np.ndarray] = (np.zeros(0), np.zeros(0))
    speed_limits: np.ndarray = field(default_factory=lambda: np.zeros(0))
    joint_units: tuple[str, ...] = ()
    cameras: Mapping[str, CameraRecord] = field(default_factory=dict)
    target: PlacedTarget | None = None
    goal: Goal | None = None
    centres: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    real_time_factors: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    settings: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    experiment: Experiment | None = None
    yaml: str = ""

    def __post_init__(self) -> None:
        count = len(self.names)
        self.units = tuple(self.units) if len(self.units) == count else ("",) * count
        if len(self.tolerances) != count:
            self.tolerances = ()

    @cached_property
    def stamp(self) -> np.ndarray:
        """Exposure times (n,) of the images, s of simulated time."""
        return np.array([state.stamp for state in self.states])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the k features."""
        outputs = (state.scheme_output for state in self.states)
        return next((tuple(output.names) for output in outputs if output is not None), ())

    @property
    def scheme(self) -> str:
        """Name of the scheme."""
        return self.states[0].scheme if self.states else ""

    def _collect_outputs(self, field_name: str) -> np.ndarray:
        """Collect a field (n, k) of the scheme's outputs; NaN for images without an output."""
        return _make_table(
            [getattr(state.scheme_output, field_name)
             if state.scheme_output is not None
             and len(state.scheme_output.names) == len(self.names)
             else None for state in self.states],
            len(self.names),
        )  # fmt: skip

    @cached_property
    def features(self) -> np.ndarray:
        """Measured features s (n, k); NaN for images without a measurement."""
        return self._collect_outputs("features")

    @cached_property
    def desired_features(self) -> np.ndarray:
        """Desired features s* (n, k)."""
        return self._collect_outputs("desired")

    @cached_property
    def error(self) -> np.ndarray:
        """Measured errors s - s* (n, k); errors of angles are wrapped to -pi to pi."""
        return self._collect_outputs("error")

    @cached_property
    def filtered_error(self) -> np.ndarray:
        """Errors (n, k) after the scheme's filter; measured errors if the scheme has no filter."""
        filtered = self._collect_outputs("filtered_error")
        return np.where(np.isnan(filtered), self.error, filtered)

    @cached_property
    def desired_twist(self) -> np.ndarray:
        """Camera twists (n, 6) that the scheme desires, in the camera frame, m/s and rad/s."""
        return _make_table([state.desired_twist for state in self.states], 6)

    @cached_property
    def achieved_twist(self) -> np.ndarray:
        """Camera twists (n, 6) that the commanded joint velocities produce, m/s and rad/s."""
        return _make_table([state.achieved_twist for state in self.states], 6)

    @cached_property
    def joints(self) -> np.ndarray:
        """Joint positions (n, j) that the controller used for each image, rad or m."""
        positions = [None if s.joints is None else s.joints.positions for s in self.states]
        return _make_table(positions, len(self.joint_names))

    @property
    def phases(self) -> tuple[str, ...]:
        """Phase of the loop at each of the n images, such as 'servoing' or 'converged'."""
        return tuple(state.phase for state in self.states)

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Outcome that the loop reported at each of the n images."""
        return tuple(state.outcome for state in self.states)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reason of the outcome at each of the n images."""
        return tuple(state.reason for state in self.states)

    @cached_property
    def rank(self) -> np.ndarray:
        """Rank (n,) of the interaction matrix L in each image.

        Components of the camera twist that the scheme does not control are left out of L.
        """
        return np.array([state.rank for state in self.states], int)

    @cached_property
    def singular_L(self) -> np.ndarray:
        """Singular values (n, p) of the interaction matrix L in each of n images, largest first.

        p is the largest number of singular values in an image; missing values are NaN. Components
        of the camera twist that the scheme does not control are left out of L.
        """
        return pad_rows(state.singular_values_L for state in self.states)

    @cached_property
    def singular_LJ(self) -> np.ndarray:
        """Singular values (n, q) of the task Jacobian L J in each of n images.

        J is the Jacobian of the camera. q is the largest number of singular values in an image;
        missing values are NaN.
        """
        return pad_rows(
            None if s.ik_solution is None else s.ik_solution.singular_values for s in self.states
        )

    @cached_property
    def manipulability(self) -> np.ndarray:
        """Product (n,) of the singular values of the task Jacobian L J."""
        return self._collect_ik_solutions("manipulability")

    @cached_property
    def scale(self) -> np.ndarray:
        """Factor (n,) by which speed and acceleration limits reduced the desired twist, 0 to 1."""
        return self._collect_ik_solutions("scale")

    def _collect_ik_solutions(self, field_name: str) -> np.ndarray:
        solutions = (state.ik_solution for state in self.states)
        return np.array([np.nan if s is None else getattr(s, field_name) for s in solutions], float)

    @cached_property
    def computation_time(self) -> np.ndarray:
        """Computation time (n,) of the scheme for each image, s; NaN if it was not measured."""
        return np.array([state.computation_time or np.nan for state in self.states], float)

    @property
    def control_record(self) -> CameraRecord:
        """Record of the control camera, to which poses and twists of the run refer."""
        return next(iter(self.cameras.values()), CameraRecord())

    @property
    def camera(self) -> CameraModel | None:
        """True intrinsics of the control camera."""
        return self.control_record.model

    @property
    def converged(self) -> bool:
        """True if the outcome of the loop is 'converged'."""
        return self.outcome.startswith("converged")

    @property
    def is_success(self) -> bool:
        """True if the loop has converged and the true camera pose is at the goal.

        If the true pose or the goal pose is unknown, only the outcome of the loop is used.
        """
        return self.converged and (self.verdict.is_reached or not self.verdict.name)

    @property
    def is_held_at_goal(self) -> bool:
        """True if the loop was in the converged phase at the end, whatever its outcome."""
        return self.converged or bool(self.states) and self.states[-1].phase == CONVERGED

    @property
    def servoing(self) -> np.ndarray:
        """Mask (m,), True for the joint states since the first image."""
        return self.joint_stamp >= (self.stamp[0] if len(self.stamp) else np.inf)

    @property
    def start_stamp(self) -> float:
        """Stamp of the first image that the loop processed, s."""
        return float(self.stamp[0]) if len(self.stamp) else 0.0

    @property
    def end_stamp(self) -> float:
        """Stamp of the last joint state, s; `goal_pose` is the goal pose at this time."""
        return float(self.joint_stamp[-1]) if len(self.joint_stamp) else self.start_stamp

    @property
    def time(self) -> np.ndarray:
        """Time (n,) of the images since `start_stamp`, s."""
        return self.stamp - self.start_stamp

    @property
    def joint_time(self) -> np.ndarray:
        """Time (m,) of the joint states since `start_stamp`, s."""
        return self.joint_stamp - self.start_stamp

    def pose_error_history(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute the distance and angle between the true camera pose and the goal pose.

        Returns:
            Distances (m,), m, and angles (m,), rad, at the m joint states."""
        pairs = [pose_difference(self.goal_pose, pose) for pose in self.true_pose]
        distance, angle = np.array(pairs).reshape(-1, 2).T
        return distance, angle

    def compute_settling_time(self, floor: tuple[float, float] = (1e-4, 1.745e-3)) -> float:
        """Compute the time after which the pose error stays below 2 % of its initial value, s.

        Both the distance and the angle of the pose error must stay below 2 % of their initial
        values. The time starts at the first joint state after the first image. Return inf if they
        do not.

        floor: distance (m) and angle (rad); smaller errors are regarded as settled, even if they
            are above 2 % of the initial error. Default: 0.1 mm and 0.1 degrees.
        """
        after = self.servoing
        if not after.any():
            return float("inf")
        latest = 0.0
        for error, least in zip(self.pose_error_history(), floor, strict=True):
            latest = max(
                latest, compute_settling_time(self.joint_stamp[after], error[after], least)
            )
        return latest

    def project_desired_outline(self) -> np.ndarray | None:
        """Return the corners (c, 2) of the target's silhouette at the goal pose, px, or None.

        None means that the target, the camera or the goal pose is unknown.
        """
        if self.target is None or self.camera is None:
            return None
        outline = self.target.project(self.target.shape.outline, self.goal_pose, self.end_stamp)
        return None if outline is None else self.camera.project_points(outline)


def compute_settling_time(stamp: np.ndarray, values: np.ndarray, floor: float = 0.0) -> float:
    """Compute the time after which the values stay below 2 % of the first value, s.

    Return inf if they do not stay below.

    Args:
        stamp: stamps (n,), s; the time starts at stamp[0].
        values: values (n,) of at least 0.
        floor: limit that replaces 2 % of the first value if the limit is larger.
    """
    known = np.isfinite(values)
    stamp, values = stamp[known], values[known]
    if not len(values):
        return float("inf")
    above = np.flatnonzero(values > max(SETTLING_BAND * values[0], floor))
    if not above.size:
        return 0.0
    after = int(above[-1]) + 1
    return float(stamp[after] - stamp[0]) if after < len(stamp) else float("inf")


def normalize_errors(error: np.ndarray) -> np.ndarray:
    """Divide each column of errors (n, k) by its largest absolute value.

    Errors with different units then become comparable."""
    largest = np.nanmax(np.abs(error), axis=0, initial=0.0)
    return error / np.where(largest > 0.0, largest, 1.0)


def pad_rows(values: Iterable[Sequence[float] | None]) -> np.ndarray:
    """Combine n rows into an array; NaN is appended to rows that are shorter than the longest."""
    rows = [np.zeros(0) if row is None else np.asarray(row, float) for row in values]
    return _make_table(rows, max((len(row) for row in rows), default=0))


def _make_table(rows: Sequence[Sequence[float] | None], width: int) -> np.ndarray:
    """Combine n rows into an array (n, width); NaN is appended to shorter rows.

    A row that is None becomes NaN."""
    table = np.full((len(rows), width), np.nan)
    for i, row in enumerate(rows):
        if row is not None:
            table[i, : len(row)] = row
    return table
