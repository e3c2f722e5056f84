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

from aras_visual_servo_base.poses import adjoint, inverse, logarithm, relative_pose

from ..errors import ConfigurationError, MeasurementError
from ..kinematics import Arm
from ..kinematics.joint_sample import JointSample
from .feature_observer import FeatureObserver
from .observation import Observation

MAX_WAITING_IMAGES = 8  # pictures of a camera that wait for those of others
# Part of the shorter of two cameras' periods by which their stamps may differ and still be of one
# exposure: clocks of cameras that are triggered together differ by some of it.
SAME_EXPOSURE_PART = 0.25
ROUNDING = 1e-6  # s
SAME_STAMP = 1e-9  # s of age that are none

ObserveFrame = Callable[[JointSample | None, tuple[JointSample, ...]], Observation]


class FixedCameraKinematics:
    """In place of an arm, for a camera that stands still before a world that does."""

    def __init__(self, world_T_camera: np.ndarray) -> None:
        """`world_T_camera`: (4, 4)."""
        self._pose = np.array(world_T_camera, float)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """world_T_camera (4, 4), wherever the joints are."""
        return self._pose


class InverseCameraKinematics:
    """In place of an arm, for a camera before which the arm moves opposite to the control camera.

    One of the two sits in the hand and looks at what stands in the world; the other stands in the
    world and looks at what the hand carries.

    Attributes:
        place: (4, 4) of the camera in the frame in which the control camera's target stands; there
            it never moves.
    """

    def __init__(self, arm: Arm, fixed_pose: np.ndarray) -> None:
        """`arm`: the camera's motion relative to its own target."""
        self._arm, self.fixed_pose = arm, np.array(fixed_pose, float)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """target_T_camera (4, 4) in the frame in which its own target stands, for joints (n,)."""
        return self._arm.pose(q)


CameraKinematics = Arm | FixedCameraKinematics | InverseCameraKinematics


def make_camera_kinematics(
    urdf: str, control: Arm, other: Arm, name: str
) -> Arm | InverseCameraKinematics:
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
    stands = Arm.find_fixed_pose(urdf, before.camera_frame, before.base_frame)
    if stands is None:
        raise ConfigurationError(
            f"the arm moves {before.camera_frame}, and {before.target_frame} too, at which that "
            "camera looks: beside a camera in the hand such a camera has to stand"
        )
    if before is other:
        return InverseCameraKinematics(other, stands)
    standing = Arm.from_urdf(
        urdf, before.camera_frame, before.base_frame, before.names, before.target_frame
    )
    rest = np.zeros(len(other))
    world_T_target = stands @ inverse(standing.pose(rest))
    return InverseCameraKinematics(other, inverse(world_T_target) @ other.pose(rest))


@dataclass(eq=False)
class _WaitingImage:
    """One that waits: its stamp (s), how it is looked at, and what that gave."""

    stamp: float
    observe_frame: ObserveFrame
    observation: Observation | None = None


class CameraRig:
    """The observers of a scheme's cameras.

    Attributes:
        observers: by name; the first is the control camera's.
        joints_at: gives the joints at a stamp (s), or None; set by who knows them.
        waits_for: name of the camera whose picture the last one waits for; empty where it does not.
    """

    def __init__(self, observers: Iterable[FeatureObserver]) -> None:
        self.observers = {observer.name: observer for observer in observers}
        self.control = next(iter(self.observers.values()))
        self.find_joints: Callable[[float], JointSample | None] | None = None
        self._other_observers = {n: o for n, o in self.observers.items() if o is not self.control}
        self.reset()

    def reset(self) -> None:
        """Forget all images, as after the clock went back."""
        for observer in self.observers.values():
            observer.reset()
        self._waiting_images: dict[str, deque[_WaitingImage]] = {
            name: deque(maxlen=MAX_WAITING_IMAGES) for name in self.observers
        }
        self._recent_stamps: dict[str, deque[float]] = {
            name: deque(maxlen=MAX_WAITING_IMAGES) for name in self.observers
        }
        self.missing_camera = ""

    def add_image(
        self, name: str, stamp: float, observe_frame: ObserveFrame
    ) -> tuple[float, ObserveFrame] | None:
        """Take in a picture of the camera `name`, exposed at `stamp` (s).

        Answers:
            Stamp of the control camera's newest picture that need not wait for another any more,
            and how all are looked at together; None where there is none.
        """
        if not self._other_observers:
            return stamp, observe_frame
        self._waiting_images[name].append(_WaitingImage(stamp, observe_frame))
        self._recent_stamps[name].append(stamp)
        waiting = self._waiting_images[self.control.name]
        self.missing_camera = ""
        for i in reversed(range(len(waiting))):
            picture = waiting[i]
            beside = {n: self._find_matching_image(n, picture.stamp) for n in self._other_observers}
            if all(beside.values()):
                for _ in range(i + 1):
                    waiting.popleft()
                return picture.stamp, partial(self._observe_together, picture, beside)
            self.missing_camera = next(n for n, one in beside.items() if one is None)
        return None

    def _find_matching_image(self, name: str, stamp: float) -> _WaitingImage | None:
        """The picture of another camera that belongs to one of this stamp; None: it is still to
        come, by the period at which they came so far."""
        period = self._estimate_period(name)
        near = SAME_EXPOSURE_PART * min(period, self._estimate_period(self.control.name)) + ROUNDING
        pictures = self._waiting_images[name]
        until = [p for p in pictures if p.stamp <= stamp + near]
        if not until:
            return None
        newest, last = until[-1], pictures[-1].stamp
        ended = newest.stamp >= stamp - near or last > stamp + near
        return newest if ended or period and last + period > stamp + near else None

    def _estimate_period(self, name: str) -> float:
        """At which a camera's pictures came so far, s; 0 where that is not known yet."""
        return min((b - a for a, b in pairwise(self._recent_stamps[name])), default=0.0)

    def _observe_together(
        self,
        control_image: _WaitingImage,
        other_images: Mapping[str, _WaitingImage],
        joints: JointSample | None,
        commands: tuple[JointSample, ...],
    ) -> Observation:
        seen = {}
        for name, other in other_images.items():
            if other.observation is None:
                then = joints
                if self.find_joints is not None and other.stamp != control_image.stamp:
                    then = self.find_joints(other.stamp)
                other.observation = other.observe_frame(then, ())
            seen[name] = other.observation
        return self.merge_observations(control_image.observe_frame(joints, commands), seen)

    def merge_observations(
        self, control: Observation, other_cameras: Mapping[str, Observation]
    ) -> Observation:
        """One observation of all cameras: the control camera's, with the others', by name.

        Raises:
            MeasurementError: nothing tells where a camera is.
        """
        brought = {}
        for name, view in other_cameras.items():
            here = (
                self._compute_pose(name, control)
                if control.joints is not None
                else view.world_T_camera
            )
            moved = None
            if abs(view.stamp - control.stamp) > SAME_STAMP and view.world_T_camera is not None:
                moved = logarithm(relative_pose(view.world_T_camera, here))
            of_control = self._compute_twist_from_control(name, control, here)
            brought[name] = replace(
                view, twist_from_control=of_control, motion_since_exposure=moved,
                has_other_target=isinstance(self.observers[name].arm, InverseCameraKinematics),
            )  # fmt: skip
        return replace(control, other_cameras=brought)

    def _compute_pose(self, name: str, control: Observation) -> np.ndarray | None:
        """Of another camera, (4, 4), when the control camera exposed."""
        arm: CameraKinematics | None = self.observers[name].arm
        return None if arm is None else arm.pose(control.joints.positions)

    def _compute_twist_from_control(
        self, name: str, control: Observation, here: np.ndarray | None
    ) -> np.ndarray | None:
        """See Observation.of_control."""
        arm = self.observers[name].arm
        if isinstance(arm, FixedCameraKinematics):
            return np.zeros((6, 6))
        if isinstance(arm, InverseCameraKinematics) and control.world_T_camera is not None:
            return -adjoint(relative_pose(arm.fixed_pose, control.world_T_camera))
        if here is None or control.world_T_camera is None:
            raise MeasurementError(f"nothing tells where camera {name} is beside {control.name}")
        return adjoint(relative_pose(here, control.world_T_camera))
