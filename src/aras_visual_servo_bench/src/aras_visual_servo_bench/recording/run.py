"""Record of one run: measurements and commands of the loop, true camera poses, and the result.

The runner, a bag and a ROS graph all give a run in this form.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.diagnosis.pose_uncertainty import NEGLIGIBLE_UNCERTAINTY
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.records.state import CONVERGED, ServoState

from ..experiment.experiment import Experiment
from ..targets.geometry import PlacedTarget
from .run_presentation import RunPresentation

Film = tuple[tuple[float, bytes], ...]  # stamp, s, and JPEG

REACHED, MISSED = "goal_reached", "goal_missed"
SETTLING_BAND = 0.02  # fraction of the initial distance


@dataclass(frozen=True)
class Verdict:
    """Result of a run by the true poses: distance (m) and angle (rad) of the camera from its goal.

    name: 'goal_reached' or 'goal_missed'; '' if the poses are unknown.
    """

    name: str
    distance: float
    angle: float

    @property
    def is_reached(self) -> bool:
        """True if the camera has reached its goal."""
        return self.name == REACHED

    @classmethod
    def compare(
        cls, goal: np.ndarray, pose: np.ndarray, depth: float,
        tolerance: tuple[float, float] | None = None,
    ) -> Verdict:
        """Compare the pose of the camera with the goal pose, both world_T_camera (4, 4).

        Args:
            depth: of the target at the goal, m.
            tolerance: distance (m) and angle (rad) within which the goal is reached; None: the
                accuracy of the outcome 'converged', whose distance is proportional to the depth.
        """
        distance, angle = pose_difference(goal, pose)
        limits = (
            (NEGLIGIBLE_UNCERTAINTY[0] * depth, NEGLIGIBLE_UNCERTAINTY[1])
            if tolerance is None
            else tolerance
        )
        is_reached = distance <= limits[0] and angle <= limits[1]
        return cls(REACHED if is_reached else MISSED, distance, angle)


@dataclass(frozen=True, eq=False)
class CameraRecord:
    """Images and poses of one camera during a run.

    Attributes:
        model: true intrinsics; None: unknown.
        stamp: (p,) exposure times, s. arrival: (p,) arrival at the recorder, s of the same clock.
        pose: (p, 4, 4) true world_T_camera of each image; empty: unknown.
        images: some of the images: stamp and (rows, columns, 3) rgb, in the order of time.
        film: more, smaller images: stamp and JPEG, in the order of time; empty: a film is made of
            `images`.
    """

    model: CameraModel | None = None
    stamp: np.ndarray = field(default_factory=lambda: np.zeros(0))
    arrival: np.ndarray = field(default_factory=lambda: np.zeros(0))
    pose: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 4)))
    images: tuple[tuple[float, np.ndarray], ...] = ()
    film: Film = ()

    def __repr__(self) -> str:
        size = "unknown camera" if self.model is None else f"{self.model.width}x{self.model.height}"
        return (f"CameraRecord({size}, {len(self.stamp)} exposures, {len(self.images)} images "
                f"stored, {len(self.film)} frames of a film)")  # fmt: skip

    def find_nearest_image(self, stamp: float) -> np.ndarray | None:
        """Return the image nearest to a stamp (s); None without images."""
        if not self.images:
            return None
        return min(self.images, key=lambda one: abs(one[0] - stamp))[1]


@dataclass(eq=False, repr=False)
class Run(RunPresentation):
    """Record of one run: measurements and commands of the loop, true camera poses, and the result.

    It is made by `run`, by `load_run` from a bag, or by `Loop.make_run`. `plot`, `report` and
    `to_pandas` of its base class RunPresentation show it. The loop has processed n
    images with k features, and there are m joint states of j joints. Unknown values are None, NaN
    or empty. Poses are world_T_camera (4, 4); lengths are in m, angles in rad, times in s.

    Attributes:
        states: n states of the loop, one per image.
        pose: (n, 4, 4) true world_T_camera when the loop had processed each image.
        joint_names: j names.
        joint_stamp: (m,) of the joint states, s.
        measured_positions, measured_velocities: (m, j) of the joint states, rad or m, per s.
        joint_commands: (m, j) latest command at each joint state; NaN before the first one.
        true_pose: (m, 4, 4) world_T_camera at each joint state, by the true kinematics at
            `measured_positions`; a bag gives the same poses. Metrics of the camera path use them.
            They do not contain vibration, which `pose` does.
        joint_origins: (m, l, 3) of the arm's joint frames in the world at each joint state; l = 0
            without an arm, or if they were not computed.
        goal_pose: (4, 4) desired pose of the camera at the end.
        outcome, reason, remedy: of the whole run, as the loop reports them.
        verdict: result by the true pose at the end, without vibration; from a bag, by the last
            `true_pose`.
        peak_speed: (j,) maximum speed at any physics step; None if it was not recorded.
        name: of the run, for legends. source: bag, file or study of the run, as text.
        units, tolerances: (k,) of the features.
        position_limits: lower and upper limits (j,), rad or m. speed_limits: (j,), rad/s or m/s.
        joint_units: (j,) 'rad' or 'm'.
        cameras: record of each camera, by name; the first is the control camera.
        target: of the control camera, in the world. goal: of the loop.
        centres: (n, 2) measured centre of gravity of the target, normalised.
        real_time_factors: (p, 2) stamp (s) and real-time factor.
        settings: of the run, as text, by name. versions: of the software that affects the results.
        notes: warnings that limit the meaning of the results.
        experiment: the experiment, if known. yaml: YAML text that repeats the run; '': unknown.
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

    @property
    def run(self) -> Run:
        """This run, for user metrics that were written for an object with a run as its part."""
        return self

    # -- images ----------------------------------------------------------------------------

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
        """Collect a field (n, k) of the scheme outputs with these features; NaN without one."""
        return _make_table(
            [getattr(state.scheme_output, field_name)
             if state.scheme_output is not None
             and len(state.scheme_output.names) == len(self.names)
             else None for state in self.states],
            len(self.names),
        )  # fmt: skip

    @cached_property
    def features(self) -> np.ndarray:
        """Measured features s (n, k); NaN without a measurement."""
        return self._collect_outputs("features")

    @cached_property
    def desired_features(self) -> np.ndarray:
        """Desired features s* (n, k)."""
        return self._collect_outputs("desired")

    @cached_property
    def error(self) -> np.ndarray:
        """Measured errors s - s* (n, k), with angles wrapped."""
        return self._collect_outputs("error")

    @cached_property
    def filtered_error(self) -> np.ndarray:
        """Errors (n, k) after the scheme's filter; without a filter the measured errors."""
        filtered = self._collect_outputs("filtered_error")
        return np.where(np.isnan(filtered), self.error, filtered)

    @cached_property
    def desired_twist(self) -> np.ndarray:
        """Desired camera twists (n, 6) in the camera frame, m/s and rad/s."""
        return _make_table([state.desired_twist for state in self.states], 6)

    @cached_property
    def achieved_twist(self) -> np.ndarray:
        """Camera twists (n, 6) that the commanded joint velocities produce, m/s and rad/s."""
        return _make_table([state.achieved_twist for state in self.states], 6)

    @cached_property
    def joints(self) -> np.ndarray:
        """Joint positions (n, j) that the controller used for the images."""
        positions = [None if s.joints is None else s.joints.positions for s in self.states]
        return _make_table(positions, len(self.joint_names))

    @property
    def phases(self) -> tuple[str, ...]:
        """Phase of the loop at each of the n images."""
        return tuple(state.phase for state in self.states)

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Outcome by the loop at each of the n images."""
        return tuple(state.outcome for state in self.states)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reason of the outcome at each of the n images."""
        return tuple(state.reason for state in self.states)

    @cached_property
    def rank(self) -> np.ndarray:
        """Rank (n,) of L in its modelled directions."""
        return np.array([state.rank for state in self.states], int)

    @cached_property
    def singular_L(self) -> np.ndarray:
        """Singular values (n, p) of L in its modelled directions, largest first."""
        return pad_rows(state.singular_values_L for state in self.states)

    @cached_property
    def singular_LJ(self) -> np.ndarray:
        """Singular values (n, q) of the task Jacobian L J."""
        return pad_rows(
            None if s.ik_solution is None else s.ik_solution.singular_values for s in self.states
        )

    @cached_property
    def manipulability(self) -> np.ndarray:
        """Product (n,) of the singular values of L J."""
        return self._collect_ik_solutions("manipulability")

    @cached_property
    def scale(self) -> np.ndarray:
        """Factor (n,) by which joint limits scaled the task velocity; 1 without scaling."""
        return self._collect_ik_solutions("scale")

    def _collect_ik_solutions(self, field_name: str) -> np.ndarray:
        solutions = (state.ik_solution for state in self.states)
        return np.array([np.nan if s is None else getattr(s, field_name) for s in solutions], float)

    @cached_property
    def computation_time(self) -> np.ndarray:
        """Computation time (n,) of the scheme, s; NaN if it was not measured."""
        return np.array([state.computation_time or np.nan for state in self.states], float)

    # -- cameras ---------------------------------------------------------------------------

    @property
    def control_record(self) -> CameraRecord:
        """Record of the control camera, to which poses and twists of the run refer."""
        return next(iter(self.cameras.values()), CameraRecord())

    @property
    def camera(self) -> CameraModel | None:
        """True intrinsics of the control camera."""
        return self.control_record.model

    # -- the end ---------------------------------------------------------------------------

    @property
    def converged(self) -> bool:
        """True if the outcome of the loop is 'converged'."""
        return self.outcome.startswith("converged")

    @property
    def is_success(self) -> bool:
        """True if the loop has converged and the camera has truly reached its goal.

        If the true goal pose is unknown, the outcome of the loop decides alone.
        """
        return self.converged and (self.verdict.is_reached or not self.verdict.name)

    @property
    def is_held_at_goal(self) -> bool:
        """True if the loop was converged at the end, even if its outcome is another one."""
        return self.converged or bool(self.states) and self.states[-1].phase == CONVERGED

    # -- time ------------------------------------------------------------------------------

    @property
    def servoing(self) -> np.ndarray:
        """Mask (m,) of the joint states since the first image."""
        return self.joint_stamp >= (self.stamp[0] if len(self.stamp) else np.inf)

    @property
    def start_stamp(self) -> float:
        """Stamp of the first image that the loop processed, s."""
        return float(self.stamp[0]) if len(self.stamp) else 0.0

    @property
    def end_stamp(self) -> float:
        """Stamp of the last joint state, s; `goal_pose` refers to this time."""
        return float(self.joint_stamp[-1]) if len(self.joint_stamp) else self.start_stamp

    @property
    def time(self) -> np.ndarray:
        """Time (n,) of the images since `start_stamp`, s."""
        return self.stamp - self.start_stamp

    @property
    def joint_time(self) -> np.ndarray:
        """Time (m,) of the joint states since `start_stamp`, s."""
        return self.joint_stamp - self.start_stamp

    # -- camera path -----------------------------------------------------------------------

    def pose_error_history(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute distance (m,), m, and angle (m,), rad, of the true camera from its goal."""
        pairs = [pose_difference(self.goal_pose, pose) for pose in self.true_pose]
        distance, angle = np.array(pairs).reshape(-1, 2).T
        return distance, angle

    def compute_settling_time(self, floor: tuple[float, float] = (1e-4, 1.745e-3)) -> float:
        """Compute the time until the camera stays within 2 % of its initial error, s; inf: never.

        Distance and angle must both be within. The time starts at the first joint state after the
        first image.

        floor: distance (m) and angle (rad) that always count as settled: 0.1 mm and 0.1 degrees.
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

    # -- outlines in the image -------------------------------------------------------------

    def project_outline(self, pose: np.ndarray, stamp: float) -> np.ndarray | None:
        """Project the target's silhouette for world_T_camera (4, 4): pixels (c, 2); None: unknown.
        """
        if self.target is None or self.camera is None:
            return None
        outline = self.target.project(self.target.shape.outline, pose, stamp)
        return None if outline is None else np.column_stack(self.camera.project(*outline.T))

    def project_desired_outline(self) -> np.ndarray | None:
        """Project the target's silhouette at the goal pose: pixels (c, 2); None: unknown."""
        return self.project_outline(self.goal_pose, self.end_stamp)


def compute_settling_time(stamp: np.ndarray, values: np.ndarray, floor: float = 0.0) -> float:
    """Compute the time until values (n,) stay below 2 % of the first one or `floor`; inf: never.

    stamp: (n,) s; the time starts at stamp[0].
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
    """Divide errors (n, k) by the largest absolute value of each column, to compare their units."""
    largest = np.nanmax(np.abs(error), axis=0, initial=0.0)
    return error / np.where(largest > 0.0, largest, 1.0)


def pad_rows(values: Iterable[Sequence[float] | None]) -> np.ndarray:
    """Combine rows of different lengths into one array (n, longest), padded with NaN."""
    rows = [np.zeros(0) if row is None else np.asarray(row, float) for row in values]
    return _make_table(rows, max((len(row) for row in rows), default=0))


def _make_table(rows: Sequence[Sequence[float] | None], width: int) -> np.ndarray:
    """Combine rows into one array (n, width); shorter rows and None are padded with NaN."""
    table = np.full((len(rows), width), np.nan)
    for i, row in enumerate(rows):
        if row is not None:
            table[i, : len(row)] = row
    return table
