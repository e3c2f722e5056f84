"""Teaching of goals without ROS: move to a pose, collect views there, and average them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from aras_visual_servo_camera.contour import find_corners
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.moments import Moments

from ..errors import ConfigurationError, MeasurementError, ServoError
from ..goals.goal import Goal
from ..kinematics import Arm
from ..kinematics.joint_sample import JointSample
from ..observation.camera_rig import CameraRig, ObserveFrame
from ..observation.feature_observer import FeatureObserver
from ..observation.observation import Observation
from ..records.state import ImageSource, ServoSettings
from ..schemes import JointController, Scheme
from .start_approach import StartApproach

NO_IMAGES = "no images arrive"
# Number of points of an outline computed from geometry, about as many as an outline from an image
# has.
OUTLINE_POINTS = 400


class ViewCollector:
    """Collector of valid views from one pose.

    Its inputs are joint states and images.

    Attributes:
        camera_rig: cameras that make the observations.
        views: valid observations so far.
        refused_count: number of images since the last valid one.
        reason: why the last image was not valid.
    """

    def __init__(
        self,
        arm: Arm,
        camera_rig: CameraRig,
        start_joints: np.ndarray | None = None,
        send: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        """Create the teacher.

        Args:
            start_joints: joints (n,) to which the arm moves first; None to stay at the present
                joints.
            send: function that sends the commanded positions (n,) to the arm.
        """
        self.arm, self.camera_rig = arm, camera_rig
        self._send = send
        self._start_approach = None
        if start_joints is not None:
            settings = ServoSettings(start=tuple(start_joints), settle=1.0)
            self._start_approach = StartApproach(arm.names, np.minimum(arm.velocity, 1.0), settings)
        self._sample: JointSample | None = None
        self.views: list[Observation] = []
        self.refused_count, self.reason = 0, NO_IMAGES

    @property
    def is_ready(self) -> bool:
        """Return whether the joints are known and the pose, if one was given, is reached."""
        return self._sample is not None and (
            self._start_approach is None or self._start_approach.is_done
        )

    def add_joint_state(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp: float,
    ) -> None:  # fmt: skip
        """Add a joint state, and continue the motion to the pose."""
        before = self._sample
        try:
            self._sample = self.arm.read_joints(names, positions, velocities, stamp)
        except MeasurementError as error:
            self.reason = str(error)
            return
        if (
            self._start_approach is None
            or self._start_approach.is_done
            and not self._restart_if_moved()
        ):
            return
        dt = 0.0 if before is None else min(max(stamp - before.stamp, 0.0), 0.1)
        self._send(self._start_approach.compute_command(stamp, dt, self._sample.positions))
        self.reason = self._start_approach.reason or "moving to the pose"
        if self._start_approach.is_done:
            self.reason = NO_IMAGES

    def _restart_if_moved(self) -> bool:
        """If the arm was moved, drive it back to the pose and remove all views collected so far.

        Return whether the arm was moved.
        """
        offset = np.abs(self._sample.positions - self._start_approach.start)
        is_moved = bool((offset > 2.0 * np.asarray(self._start_approach.settings.arrived)).any())
        if is_moved:
            self._start_approach.reset()
            self.views.clear()
        return is_moved

    def set_source(self, camera: str, source: ImageSource) -> None:
        """Do nothing, because the caller reports the source of a camera's images itself."""

    def add_image(self, stamp: float, observe_frame: ObserveFrame, camera: str = "") -> None:
        """Add an image if the pose is reached; an empty camera name denotes the control camera."""
        if not self.is_ready:
            return
        merged = self.camera_rig.add_image(
            camera or self.camera_rig.control.name, stamp, observe_frame
        )
        if merged is None:
            self.reason = (
                f"no image of camera {self.camera_rig.missing_camera} with the same stamp arrives"
            )
            return
        try:
            view = merged[1](self._sample, ())
        except VisionError as error:
            self.refused_count, self.reason = self.refused_count + 1, str(error)
            return
        invalid = next((one for one in view.cameras.values() if not one.valid), None)
        if invalid is None:
            self.views.append(view)
            self.refused_count = 0
        else:
            self.refused_count, self.reason = self.refused_count + 1, invalid.reason


def make_mean_goal(
    views: Sequence[Observation],
    scheme: Scheme | JointController,
    arm: Arm,
    name: str,
    depth: float | None = None,
    target_goal: Goal | None = None,
) -> Goal:
    """Create a goal from the mean of several views from one pose.

    Args:
        views: valid observations.
        scheme: scheme whose features store their data in the goal.
        arm: arm that gives the pose at the mean joints.
        name: name of the goal.
        depth: depth of the target, m; None to compute it from the geometry in `target_goal`.
        target_goal: goal with the same target, or None.

    Raises:
        ConfigurationError: there is no view, or the depth is unknown.
    """
    if not views:
        raise ConfigurationError(
            f"{name}: there is no valid view of the target: bring the target into view"
        )
    target = None if target_goal is None else target_goal.target
    goals = [Goal.teach(scheme, view, name, depth, target) for view in views]
    joints = {key: float(np.mean([g.joints[key] for g in goals])) for key in goals[0].joints}
    pose = goals[0].world_T_camera
    if joints:
        pose = np.array(arm.pose(np.array([joints[n] for n in arm.names])))
    return replace(_average_goals(goals), joints=joints, world_T_camera=pose)


def _average_goals(goals: Sequence[Goal]) -> Goal:
    """Return the first of several goals at one pose, with the mean moments and features of all."""
    first = goals[0]
    moments = first.moments
    if moments is not None:
        all_moments = [g.moments for g in goals]
        m, mu = ([getattr(one, key) for one in all_moments] for key in ("m_array", "mu_array"))
        moments = Moments.from_arrays(
            np.mean(m, axis=0), np.mean(mu, axis=0), moments.order, moments.kind
        )
    kernel = first.kernel
    if kernel is not None:
        kernel = replace(kernel, features=np.mean([g.kernel.features for g in goals], axis=0))
    return replace(
        first, moments=moments, kernel=kernel,
        features={key: average_entries([g.features[key] for g in goals]) for key in first.features},
        other_cameras={name: _average_goals([g.other_cameras[name] for g in goals])
            for name in first.other_cameras},
    )  # fmt: skip


def complete_by_geometry(goal: Goal, scheme: Scheme | JointController) -> Goal:
    """Add the data that the scheme needs to a goal, computed from the geometry of the target.

    Return the goal unchanged if it is complete, if the target's geometry is unknown, or if the
    scheme needs data that cannot be computed from the target's outline. `Scheme.check` then reports
    what is missing.

    Args:
        goal: goal for an arm, see `Goal.for_arm`.
        scheme: scheme whose features need the data.
    """
    try:
        scheme.check(goal)
    except ConfigurationError:
        if goal.target is None or goal.world_T_camera is None:
            return goal
        try:
            outline = _sample_sides(goal.target.compute_outline(goal.world_T_camera))
            view = FeatureObserver(None, scheme.needs).observe_exact_features(
                0.0, goal.camera, world_T_camera=goal.world_T_camera, plane=goal.plane,
                # Find the corners by the same method as in an image.
                contour=outline, points=find_corners(outline),
            )  # fmt: skip
            taught = {key: dict(entry) for key, entry in scheme.teach(view).items()}
        except (ServoError, VisionError):
            return goal
        return replace(goal, features={**taught, **goal.features})
    return goal


def _sample_sides(corners: np.ndarray) -> np.ndarray:
    """Return points (m, 2) on a polygon's sides, more of them on a longer side."""
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    counts = np.maximum(1, np.round(OUTLINE_POINTS * lengths / lengths.sum())).astype(int)
    return np.vstack([corner + np.arange(count)[:, None] / count * side
                      for corner, side, count in zip(corners, sides, counts, strict=True)])


def average_entries(entries: Sequence[Any]) -> Any:
    """Return the mean of several entries that a feature has taught for goals at the same pose.

    Numbers and lists of numbers are averaged. If the entries cannot be averaged, because they are
    texts or lists of different lengths, return the last entry.
    """
    last = entries[-1]
    if isinstance(last, dict):
        return {key: average_entries([e[key] for e in entries if key in e]) for key in last}
    try:
        arrays = [np.array(e, float) for e in entries]
    except (TypeError, ValueError):
        return last
    if len({a.shape for a in arrays}) > 1:
        return last
    return np.mean(arrays, axis=0).tolist()
