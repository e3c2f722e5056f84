"""The cameras that a scheme reads: their observers by name, and one observation of all of them.

The first is the control camera: the loop's twist is its own, and each of its images is answered
once. Of every other camera an answer takes the picture that was exposed together with it, or else
the newest before it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from aras_visual_servo_base.poses import adjoint, inverse, logarithm, relative

from ..arm import Arm
from ..arm.joint_sample import JointSample
from ..errors import ConfigurationError, MeasurementError
from .observation import Observation
from .observer import Observer

KEPT = 8  # pictures of a camera that wait for those of others
# Part of the shorter of two cameras' periods by which their stamps may differ and still be of one
# exposure: clocks of cameras that are triggered together differ by some of it.
TOGETHER = 0.25
ROUNDING = 1e-6  # s
SAME = 1e-9  # s of age that are none

Look = Callable[[JointSample | None, tuple[JointSample, ...]], Observation]


class StandingCamera:
    """In place of an arm, for a camera that stands still before a world that does."""

    def __init__(self, world_T_camera: np.ndarray) -> None:
        """`world_T_camera`: (4, 4)."""
        self._pose = np.array(world_T_camera, float)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """world_T_camera (4, 4), wherever the joints are."""
        return self._pose


class OppositeCamera:
    """In place of an arm, for a camera before which the arm moves opposite to the control camera.

    One of the two sits in the hand and looks at what stands in the world; the other stands in the
    world and looks at what the hand carries.

    Attributes:
        place: (4, 4) of the camera in the frame in which the control camera's target stands; there
            it never moves.
    """

    def __init__(self, arm: Arm, place: np.ndarray) -> None:
        """`arm`: the camera's motion relative to its own target."""
        self._arm, self.place = arm, np.array(place, float)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """target_T_camera (4, 4) in the frame in which its own target stands, for joints (n,)."""
        return self._arm.pose(q)


MovedBy = Arm | StandingCamera | OppositeCamera


def beside(urdf: str, control: Arm, other: Arm, name: str) -> Arm | OppositeCamera:
    """What moves another camera than the control camera.

    Args:
        urdf: text of the description that has the other camera where `other` has it.
        name: of the other camera.

    Raises:
        ConfigurationError: other joints do than move that one, or what one of them looks at is
            carried elsewhere, or by the arm on which it sits itself.
    """
    if tuple(other.names) != tuple(control.names):
        raise ConfigurationError(
            f"camera '{name}' is moved by {', '.join(other.names)} and the control camera by "
            f"{', '.join(control.names)}: cameras of one scheme sit on one link, or look at what "
            "it carries"
        )
    if other.target_frame == control.target_frame:
        return other
    if other.target_frame and control.target_frame:
        raise ConfigurationError(
            f"camera '{name}' looks at what {other.target_frame} carries and the control camera at "
            f"what {control.target_frame} carries: give both one target_frame"
        )
    before = other if other.target_frame else control
    stands = Arm.standing(urdf, before.camera_frame, before.base_frame)
    if stands is None:
        raise ConfigurationError(
            f"the arm moves {before.camera_frame}, and {before.target_frame} too, at which that "
            "camera looks: beside a camera in the hand such a camera has to stand"
        )
    if before is other:
        return OppositeCamera(other, stands)
    standing = Arm.from_urdf(
        urdf, before.camera_frame, before.base_frame, before.names, before.target_frame
    )
    rest = np.zeros(len(other))
    world_T_target = stands @ inverse(standing.pose(rest))
    return OppositeCamera(other, inverse(world_T_target) @ other.pose(rest))


@dataclass(eq=False)
class _Picture:
    """One that waits: its stamp (s), how it is looked at, and what that gave."""

    stamp: float
    look: Look
    seen: Observation | None = None


class Rig:
    """The observers of a scheme's cameras.

    Attributes:
        observers: by name; the first is the control camera's.
        joints_at: gives the joints at a stamp (s), or None; set by who knows them.
        waits_for: name of the camera whose picture the last one waits for; empty where it does not.
    """

    def __init__(self, observers: Iterable[Observer]) -> None:
        self.observers = {observer.name: observer for observer in observers}
        self.control = next(iter(self.observers.values()))
        self.joints_at: Callable[[float], JointSample | None] | None = None
        self._others = {n: o for n, o in self.observers.items() if o is not self.control}
        self.reset()

    def reset(self) -> None:
        """Forget all images, as after the clock went back."""
        for observer in self.observers.values():
            observer.reset()
        self._pictures: dict[str, deque[_Picture]] = {
            name: deque(maxlen=KEPT) for name in self.observers
        }
        self._stamps: dict[str, deque[float]] = {
            name: deque(maxlen=KEPT) for name in self.observers
        }
        self.waits_for = ""

    def add(self, name: str, stamp: float, look: Look) -> tuple[float, Look] | None:
        """Take in a picture of the camera `name`, exposed at `stamp` (s).

        Answers:
            Stamp of the control camera's newest picture that need not wait for another any more,
            and how all are looked at together; None where there is none.
        """
        if not self._others:
            return stamp, look
        self._pictures[name].append(_Picture(stamp, look))
        self._stamps[name].append(stamp)
        waiting = self._pictures[self.control.name]
        self.waits_for = ""
        for i in reversed(range(len(waiting))):
            picture = waiting[i]
            beside = {n: self._beside(n, picture.stamp) for n in self._others}
            if all(beside.values()):
                for _ in range(i + 1):
                    waiting.popleft()
                return picture.stamp, partial(self._look, picture, beside)
            self.waits_for = next(n for n, one in beside.items() if one is None)
        return None

    def _beside(self, name: str, stamp: float) -> _Picture | None:
        """The picture of another camera that belongs to one of this stamp; None: it is still to
        come, by the period at which they came so far."""
        period = self._period(name)
        near = TOGETHER * min(period, self._period(self.control.name)) + ROUNDING
        pictures = self._pictures[name]
        until = [p for p in pictures if p.stamp <= stamp + near]
        if not until:
            return None
        newest, last = until[-1], pictures[-1].stamp
        ended = newest.stamp >= stamp - near or last > stamp + near
        return newest if ended or period and last + period > stamp + near else None

    def _period(self, name: str) -> float:
        """At which a camera's pictures came so far, s; 0 where that is not known yet."""
        return min((b - a for a, b in pairwise(self._stamps[name])), default=0.0)

    def _look(
        self,
        picture: _Picture,
        beside: Mapping[str, _Picture],
        joints: JointSample | None,
        commands: tuple[JointSample, ...],
    ) -> Observation:
        seen = {}
        for name, other in beside.items():
            if other.seen is None:
                then = joints
                if self.joints_at is not None and other.stamp != picture.stamp:
                    then = self.joints_at(other.stamp)
                other.seen = other.look(then, ())
            seen[name] = other.seen
        return self.together(picture.look(joints, commands), seen)

    def together(self, control: Observation, others: Mapping[str, Observation]) -> Observation:
        """One observation of all cameras: the control camera's, with the others', by name.

        Raises:
            MeasurementError: nothing tells where a camera is.
        """
        brought = {}
        for name, view in others.items():
            here = self._pose(name, control) if control.joints is not None else view.world_T_camera
            moved = None
            if abs(view.stamp - control.stamp) > SAME and view.world_T_camera is not None:
                moved = logarithm(relative(view.world_T_camera, here))
            of_control = self._of_control(name, control, here)
            brought[name] = replace(
                view, of_control=of_control, moved=moved,
                apart=isinstance(self.observers[name].arm, OppositeCamera),
            )  # fmt: skip
        return replace(control, others=brought)

    def _pose(self, name: str, control: Observation) -> np.ndarray | None:
        """Of another camera, (4, 4), when the control camera exposed."""
        arm: MovedBy | None = self.observers[name].arm
        return None if arm is None else arm.pose(control.joints.positions)

    def _of_control(
        self, name: str, control: Observation, here: np.ndarray | None
    ) -> np.ndarray | None:
        """See Observation.of_control."""
        arm = self.observers[name].arm
        if isinstance(arm, StandingCamera):
            return np.zeros((6, 6))
        if isinstance(arm, OppositeCamera) and control.world_T_camera is not None:
            return -adjoint(relative(arm.place, control.world_T_camera))
        if here is None or control.world_T_camera is None:
            raise MeasurementError(f"nothing tells where camera {name} is beside {control.name}")
        return adjoint(relative(here, control.world_T_camera))
