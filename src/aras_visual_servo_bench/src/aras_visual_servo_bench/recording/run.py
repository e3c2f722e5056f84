"""One run: what the loop saw and decided, where the camera truly was, and what it came to.

The same whether it comes from the runner (from_loop), a bag (from_bag) or a graph (from_graph).
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

Film = tuple[tuple[float, bytes], ...]  # stamp, s, and JPEG

REACHED, MISSED = "goal_reached", "goal_missed"
SETTLING_BAND = 0.02  # part of the way at the start


@dataclass(frozen=True)
class Verdict:
    """What the physics knows of the end: word, and how far the camera is from its goal, m, rad."""

    name: str
    distance: float
    angle: float

    @property
    def is_reached(self) -> bool:
        """Whether the camera stands where the goal is."""
        return self.name == REACHED

    @classmethod
    def compare(
        cls, goal: np.ndarray, pose: np.ndarray, depth: float,
        tolerance: tuple[float, float] | None = None,
    ) -> Verdict:
        """Compare two poses (4, 4), world_T_camera.

        Args:
            depth: of the target at the goal, m.
            reached: m and rad that count as there; None: what plain 'converged' leaves open.
        """
        distance, angle = pose_difference(goal, pose)
        near = (
            (NEGLIGIBLE_UNCERTAINTY[0] * depth, NEGLIGIBLE_UNCERTAINTY[1])
            if tolerance is None
            else tolerance
        )
        there = distance <= near[0] and angle <= near[1]
        return cls(REACHED if there else MISSED, distance, angle)


@dataclass(frozen=True, eq=False)
class CameraRecord:
    """One camera of a run.

    Attributes:
        model: the true one; None: unknown.
        stamp: (p,) exposures, s. arrival: (p,) when the recorder had them, s of the same clock.
        pose: (p, 4, 4) true world_T_camera when each came; none: not known.
        pictures: some of them, (stamp, (rows, columns, 3) rgb), in order.
        film: some more, smaller, (stamp, JPEG), in order; none: it is made of the pictures.
    """

    model: CameraModel | None = None
    stamp: np.ndarray = field(default_factory=lambda: np.zeros(0))
    arrival: np.ndarray = field(default_factory=lambda: np.zeros(0))
    pose: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 4)))
    images: tuple[tuple[float, np.ndarray], ...] = ()
    film: Film = ()

    def find_nearest_image(self, stamp: float) -> np.ndarray | None:
        """The picture that is next to a stamp (s); None where there is none."""
        if not self.images:
            return None
        return min(self.images, key=lambda one: abs(one[0] - stamp))[1]


@dataclass(eq=False)
class Run:
    """One run: what the loop measured and commanded, where the camera truly was, and the result.

    Made by `run`, by `load_run` from a bag, or by `Loop.result`. The loop answered n images with k
    features, and m joint states of j joints came. What is not known is None, NaN or empty. Poses
    are world_T_camera (4, 4); lengths are in m, angles in rad, times in s.

    Attributes:
        states: n records of the loop, one an image.
        pose: (n, 4, 4) true world_T_camera when each image's answer was given.
        joint_names: j names.
        joint_stamp: (m,) s. measured, measured_speed: (m, j) what the joint states say, rad, m, /s.
        commanded: (m, j) the latest command at each joint state; NaN before the first.
        true_pose: (m, 4, 4) world_T_camera at each joint stamp: the true arm's where it stands at
            `measured`, so that a bag knows the same one; metrics of the camera's way are of these.
            A camera that shakes does so about them; `pose` has it.
        arm_places: (m, l, 3) of the arm's joints in the world at each joint stamp; l = 0 where
            there is no such arm, or nobody asked.
        goal_pose: (4, 4) where the camera should be at the end.
        outcome, reason, remedy: of the whole run, as the loop gives them.
        verdict: what the physics knows, of its own pose at the end, at rest; of a bag, of the last
            of `true_pose`.
        peak_speed: (j,) greatest speed at any step, or None where it was not traced.
        name: of the run, in legends. source: where it is from, as text.
        units, tolerances: (k,) of the features.
        limits: least and greatest joints (j,), rad or m. speed: (j,) greatest speeds.
        joint_units: (j,) 'rad' or 'm'.
        cameras: what each saw, by name; the first is the control camera.
        target: in the world. goal: as the loop had it.
        centres: (n, 2) measured centre of gravity of the target, normalised.
        pace: (p, 2) stamp, s, and real-time factor then.
        settings: of the run, as text, by name. versions: of what the numbers depend on.
        notes: what a reader must know before believing the rest.
        experiment: that was run. yaml: text that repeats the run; empty: it is not known.
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
        """Itself: a user's metric, which was given a finished run with its parts, asks for it."""
        return self

    # -- images ----------------------------------------------------------------------------

    @cached_property
    def stamp(self) -> np.ndarray:
        """(n,) exposures, s; the physics' clock."""
        return np.array([state.stamp for state in self.states])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the k features."""
        decisions = (state.scheme_output for state in self.states)
        return next((tuple(d.names) for d in decisions if d is not None), ())

    @property
    def scheme(self) -> str:
        """Its name, as the loop has it."""
        return self.states[0].scheme if self.states else ""

    def _collect_decisions(self, field_name: str) -> np.ndarray:
        """(n, k) of the decisions that have these features; NaN where there is none."""
        return _make_table(
            [getattr(state.scheme_output, field_name)
             if state.scheme_output is not None
             and len(state.scheme_output.names) == len(self.names)
             else None for state in self.states],
            len(self.names),
        )  # fmt: skip

    @cached_property
    def features(self) -> np.ndarray:
        """(n, k) s as measured; NaN where none."""
        return self._collect_decisions("features")

    @cached_property
    def desired_features(self) -> np.ndarray:
        """(n, k) s*."""
        return self._collect_decisions("desired")

    @cached_property
    def error(self) -> np.ndarray:
        """(n, k) s - s* as measured, angles wrapped."""
        return self._collect_decisions("error")

    @cached_property
    def filtered_error(self) -> np.ndarray:
        """(n, k) errors behind the scheme's filter; as measured where it has none."""
        found = self._collect_decisions("filtered_error")
        return np.where(np.isnan(found), self.error, found)

    @cached_property
    def desired_twist(self) -> np.ndarray:
        """(n, 6) twists of the camera in its own frame, m/s and rad/s."""
        return _make_table([state.desired_twist for state in self.states], 6)

    @cached_property
    def achieved_twist(self) -> np.ndarray:
        """(n, 6) of it that the joint velocities give."""
        return _make_table([state.achieved_twist for state in self.states], 6)

    @cached_property
    def joints(self) -> np.ndarray:
        """(n, j) as the controller had them at the exposures."""
        places = [None if s.joints is None else s.joints.positions for s in self.states]
        return _make_table(places, len(self.joint_names))

    @property
    def phases(self) -> tuple[str, ...]:
        """N words of the loop."""
        return tuple(state.phase for state in self.states)

    @property
    def outcomes(self) -> tuple[str, ...]:
        """N words: what the loop knew then."""
        return tuple(state.outcome for state in self.states)

    @property
    def reasons(self) -> tuple[str, ...]:
        """N texts."""
        return tuple(state.reason for state in self.states)

    @cached_property
    def rank(self) -> np.ndarray:
        """(n,) of L in its modelled directions."""
        return np.array([state.rank for state in self.states], int)

    @cached_property
    def singular_L(self) -> np.ndarray:
        """(n, p) singular values of L in its modelled directions, largest first."""
        return pad_rows(state.singular_values_L for state in self.states)

    @cached_property
    def singular_LJ(self) -> np.ndarray:
        """(n, q) of the task's Jacobian L J."""
        return pad_rows(
            None if s.ik_solution is None else s.ik_solution.singular_values for s in self.states
        )

    @cached_property
    def manipulability(self) -> np.ndarray:
        """(n,) product of the singular values of L J."""
        return self._collect_ik_solutions("manipulability")

    @cached_property
    def scale(self) -> np.ndarray:
        """(n,) 1, or the factor by which the task was slowed for limits."""
        return self._collect_ik_solutions("scale")

    def _collect_ik_solutions(self, field_name: str) -> np.ndarray:
        found = (state.ik_solution for state in self.states)
        return np.array([np.nan if r is None else getattr(r, field_name) for r in found], float)

    @cached_property
    def computation_time(self) -> np.ndarray:
        """(n,) s that the scheme took; NaN where no clock was handed in."""
        return np.array([state.computation_time or np.nan for state in self.states], float)

    # -- cameras ---------------------------------------------------------------------------

    @property
    def control_record(self) -> CameraRecord:
        """Of the control camera: poses and twists of the run are its own."""
        return next(iter(self.cameras.values()), CameraRecord())

    @property
    def camera(self) -> CameraModel | None:
        """The true model of the control camera."""
        return self.control_record.model

    # -- the end ---------------------------------------------------------------------------

    @property
    def converged(self) -> bool:
        """Whether the loop says that it has reached its goal."""
        return self.outcome.startswith("converged")

    @property
    def is_success(self) -> bool:
        """Whether the loop holds that it has converged, and the camera truly stands at its goal.

        The loop's word alone where nobody knows where the goal is.
        """
        return self.converged and (self.verdict.is_reached or not self.verdict.name)

    @property
    def is_held_at_goal(self) -> bool:
        """Whether the camera was held at the goal in the end, whatever else the loop had to say."""
        return self.converged or bool(self.states) and self.states[-1].phase == CONVERGED

    # -- time ------------------------------------------------------------------------------

    @property
    def servoing(self) -> np.ndarray:
        """(m,) bool, joint states since the first image."""
        return self.joint_stamp >= (self.stamp[0] if len(self.stamp) else np.inf)

    @property
    def start_stamp(self) -> float:
        """Stamp of the first image that was answered, s."""
        return float(self.stamp[0]) if len(self.stamp) else 0.0

    @property
    def end_stamp(self) -> float:
        """Stamp of the last joint state, to which the goal's pose belongs, s."""
        return float(self.joint_stamp[-1]) if len(self.joint_stamp) else self.start_stamp

    @property
    def time(self) -> np.ndarray:
        """(n,) s since then, of the images."""
        return self.stamp - self.start_stamp

    @property
    def joint_time(self) -> np.ndarray:
        """(m,) s since then, of the joint states."""
        return self.joint_stamp - self.start_stamp

    # -- the way ---------------------------------------------------------------------------

    def pose_error_history(self) -> tuple[np.ndarray, np.ndarray]:
        """Distance (m,) m and angle (m,) rad of the true camera from its goal, at joint_stamp."""
        pairs = [pose_difference(self.goal_pose, pose) for pose in self.true_pose]
        distance, angle = np.array(pairs).reshape(-1, 2).T
        return distance, angle

    def compute_settling_time(self, floor: tuple[float, float] = (1e-4, 1.745e-3)) -> float:
        """Time until the camera stays within 2 % of its first way, s; inf: never.

        It counts from the first joint state since the first image, whose way is the first.

        floor: m and rad (0.1 mm, 0.1 degrees) that count as there however short the way was.
        """
        after = self.servoing
        if not after.any():
            return float("inf")
        latest = 0.0
        for way, least in zip(self.pose_error_history(), floor, strict=True):
            latest = max(latest, compute_settling_time(self.joint_stamp[after], way[after], least))
        return latest

    # -- places ----------------------------------------------------------------------------

    def project_outline(self, pose: np.ndarray, stamp: float) -> np.ndarray | None:
        """Pixels (c, 2) of the target's silhouette for world_T_camera (4, 4); None: unknown."""
        if self.target is None or self.camera is None:
            return None
        rim = self.target.project(self.target.shape.outline, pose, stamp)
        return None if rim is None else np.column_stack(self.camera.project(*rim.T))

    def project_desired_outline(self) -> np.ndarray | None:
        """Pixels (c, 2) of the silhouette that the goal wants, however the target moves."""
        return self.project_outline(self.goal_pose, self.end_stamp)


def compute_settling_time(stamp: np.ndarray, values: np.ndarray, floor: float = 0.0) -> float:
    """From stamp[0] until values (n,) stay within 2 % of the first or `floor`, s; inf: never."""
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
    """Errors (n, k) in parts of the largest that each has had: comparable whatever their units."""
    largest = np.nanmax(np.abs(error), axis=0, initial=0.0)
    return error / np.where(largest > 0.0, largest, 1.0)


def pad_rows(values: Iterable[Sequence[float] | None]) -> np.ndarray:
    """Rows of different lengths as one array (n, longest), NaN where there is nothing."""
    rows = [np.zeros(0) if row is None else np.asarray(row, float) for row in values]
    return _make_table(rows, max((len(row) for row in rows), default=0))


def _make_table(rows: Sequence[Sequence[float] | None], width: int) -> np.ndarray:
    """Rows as one array (n, width); NaN behind those that are shorter, or None."""
    table = np.full((len(rows), width), np.nan)
    for i, row in enumerate(rows):
        if row is not None:
            table[i, : len(row)] = row
    return table
