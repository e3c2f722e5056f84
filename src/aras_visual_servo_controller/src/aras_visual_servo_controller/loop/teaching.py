"""From views at the goal to a goal: drives there, collects, averages. No ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from aras_visual_servo_camera.contour import corners_of
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.moments import Moments

from ..arm import Arm
from ..arm.joint_sample import JointSample
from ..errors import ConfigurationError, MeasurementError, ServoError
from ..goals.goal import Goal
from ..records.state import ServoSettings, Source
from ..schemes import JointController, Scheme
from ..seeing.observation import Observation
from ..seeing.observer import Observer
from ..seeing.rig import Look, Rig
from .approach import Approach

NO_IMAGES = "no images arrive"
AROUND = 400  # points of an outline that is worked out, about as many as a picture's has


class Teacher:
    """Takes in joint states and images like a driver; keeps the good views of one pose.

    Attributes:
        rig: makes the observations.
        views: the valid ones so far.
        refused: images since the last valid one.
        reason: why the last one was not.
    """

    def __init__(
        self,
        arm: Arm,
        rig: Rig,
        go: np.ndarray | None = None,
        send: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        """`go`: joints (n,) to drive to first; `send`: takes the commands (n,) on the way."""
        self.arm, self.rig = arm, rig
        self._send = send
        self._approach = None
        if go is not None:
            settings = ServoSettings(start=tuple(go), settle=1.0)
            self._approach = Approach(arm.names, np.minimum(arm.velocity, 1.0), settings)
        self._sample: JointSample | None = None
        self.views: list[Observation] = []
        self.refused, self.reason = 0, NO_IMAGES

    @property
    def there(self) -> bool:
        """Whether the pose is reached (at once where none was asked for) and joints are known."""
        return self._sample is not None and (self._approach is None or self._approach.done)

    def joints(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp: float,
    ) -> None:  # fmt: skip
        """Take in a joint state; drive on towards the pose."""
        before = self._sample
        try:
            self._sample = self.arm.sample(names, positions, velocities, stamp)
        except MeasurementError as error:
            self.reason = str(error)
            return
        if self._approach is None or self._approach.done and not self._moved_away():
            return
        dt = 0.0 if before is None else min(max(stamp - before.stamp, 0.0), 0.1)
        self._send(self._approach.command(stamp, dt, self._sample.positions))
        self.reason = self._approach.reason or "on the way to the pose"
        if self._approach.done:
            self.reason = NO_IMAGES

    def _moved_away(self) -> bool:
        """Drive to the pose again where something else has moved the arm: its views are of another
        pose."""
        away = np.abs(self._sample.positions - self._approach.start)
        moved = bool((away > 2.0 * np.asarray(self._approach.settings.arrived)).any())
        if moved:
            self._approach.reset()
            self.views.clear()
        return moved

    def comes_from(self, camera: str, source: Source) -> None:
        """Where a camera's images come from; the one who teaches says so."""

    def image(self, stamp: float, look: Look, camera: str = "") -> None:
        """Take in an image, once there; camera: its name, '': the control camera."""
        if not self.there:
            return
        together = self.rig.add(camera or self.rig.control.name, stamp, look)
        if together is None:
            self.reason = f"no image of camera {self.rig.waits_for} of the same time arrives"
            return
        try:
            view = together[1](self._sample, ())
        except VisionError as error:
            self.refused, self.reason = self.refused + 1, str(error)
            return
        blind = next((one for one in view.cameras.values() if not one.valid), None)
        if blind is None:
            self.views.append(view)
            self.refused = 0
        else:
            self.refused, self.reason = self.refused + 1, blind.reason


def goal_of(
    views: Sequence[Observation],
    scheme: Scheme | JointController,
    arm: Arm,
    name: str,
    depth: float | None = None,
    like: Goal | None = None,
) -> Goal:
    """The mean of several views of one pose.

    Args:
        views: valid ones.
        scheme: what its features want to keep is kept.
        arm: for the pose of the mean joints.
        name: of the goal.
        depth: of the target, m; None: by the geometry that `like` says.
        like: a goal whose target it is.

    Raises:
        ConfigurationError: no view, or a depth that nothing tells.
    """
    if not views:
        raise ConfigurationError(f"{name}: nothing was seen to teach")
    target = None if like is None else like.target
    goals = [Goal.teach(scheme, view, name, depth, target) for view in views]
    joints = {key: float(np.mean([g.joints[key] for g in goals])) for key in goals[0].joints}
    pose = goals[0].world_T_camera
    if joints:
        pose = np.array(arm.pose(np.array([joints[n] for n in arm.names])))
    return replace(_mean(goals), joints=joints, world_T_camera=pose)


def _mean(goals: Sequence[Goal]) -> Goal:
    """The first of several goals of one pose, with the mean of what is seen there."""
    first = goals[0]
    moments = first.moments
    if moments is not None:
        seen = [g.moments for g in goals]
        m, mu = ([getattr(one, key) for one in seen] for key in ("m_array", "mu_array"))
        moments = Moments.from_arrays(
            np.mean(m, axis=0), np.mean(mu, axis=0), moments.order, moments.kind
        )
    kernel = first.kernel
    if kernel is not None:
        kernel = replace(kernel, features=np.mean([g.kernel.features for g in goals], axis=0))
    return replace(
        first, moments=moments, kernel=kernel,
        features={key: mean_of([g.features[key] for g in goals]) for key in first.features},
        others={name: _mean([g.others[name] for g in goals]) for name in first.others},
    )  # fmt: skip


def by_geometry(goal: Goal, scheme: Scheme | JointController) -> Goal:
    """A goal with what the scheme keeps of it, as an exact camera there sees the target's outline.

    As it is where it holds that already, where nobody knows the target's geometry, and where an
    outline tells the features nothing: what is missing then, the check of the goal says.

    Args:
        goal: as an arm sees it.
    """
    try:
        scheme.check(goal)
    except ConfigurationError:
        if goal.target is None or goal.world_T_camera is None:
            return goal
        try:
            outline = _along(goal.target.outline(goal.world_T_camera))
            view = Observer(None, scheme.needs).of_exact(
                0.0, goal.camera, world_T_camera=goal.world_T_camera, plane=goal.plane,
                contour=outline, points=corners_of(outline),  # as they are found in pictures
            )  # fmt: skip
            taught = {key: dict(entry) for key, entry in scheme.teach(view).items()}
        except (ServoError, VisionError):
            return goal
        return replace(goal, features={**taught, **goal.features})
    return goal


def _along(corners: np.ndarray) -> np.ndarray:
    """Points (m, 2) along a polygon's sides, as many to a side as it is long."""
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    counts = np.maximum(1, np.round(AROUND * lengths / lengths.sum())).astype(int)
    return np.vstack([corner + np.arange(count)[:, None] / count * side
                      for corner, side, count in zip(corners, sides, counts, strict=True)])


def mean_of(entries: Sequence[Any]) -> Any:
    """The mean of what features taught: numbers and lists of them; of anything else the last.

    Lists of different lengths are not of one kind: the last one counts.
    """
    last = entries[-1]
    if isinstance(last, dict):
        return {key: mean_of([e[key] for e in entries if key in e]) for key in last}
    try:
        arrays = [np.array(e, float) for e in entries]
    except (TypeError, ValueError):
        return last
    if len({a.shape for a in arrays}) > 1:
        return last
    return np.mean(arrays, axis=0).tolist()
