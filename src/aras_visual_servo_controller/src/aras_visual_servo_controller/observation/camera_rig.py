"""Cameras of a scheme, which make one observation of all of them.

The first camera is the control camera: the loop computes its twist, and each of its images is
processed once. From every other camera, the image of the same exposure is used. If there is none,
the newest image before this exposure is used.
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

MAX_WAITING_IMAGES = 8  # number of images of one camera that can wait for images of the others
# Two cameras count as exposed together if their stamps differ by less than this fraction of the
# shorter image period. The stamps of triggered cameras may differ, because each has its own clock.
SAME_EXPOSURE_PART = 0.25
ROUNDING = 1e-6  # rounding error of image periods, s
SAME_STAMP = 1e-9  # stamps that differ by less than this, s, are equal

ObserveFrame = Callable[[JointSample | None, tuple[JointSample, ...]], Observation]


class FixedCameraKinematics:
    """Kinematics of a fixed camera with a fixed target, which are used instead of an arm."""

    def __init__(self, world_T_camera: np.ndarray) -> None:
        """Create the kinematics from `world_T_camera` (4, 4)."""
        self._pose = np.array(world_T_camera, float)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Return world_T_camera (4, 4), which does not depend on the joints."""
        return self._pose


class InverseCameraKinematics:
    """Kinematics of a second camera, if the arm moves one camera and the target of the other one.

    Either the control camera is on the end effector and views a fixed target, and the second camera
    is fixed and views a target on the end effector, or vice versa.

    Attributes:
        fixed_pose: (4, 4) constant pose of the second camera in the frame in which the control
            camera's target is at rest.
    """

    def __init__(self, arm: Arm, fixed_pose: np.ndarray) -> None:
        """Create the kinematics.

        Args:
            arm: arm that describes the camera's motion relative to its own target.
            fixed_pose: (4, 4) see the attribute `fixed_pose`.
        """
        self._arm, self.fixed_pose = arm, np.array(fixed_pose, float)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Return the camera's pose (4, 4) relative to its own target for joints (n,)."""
        return self._arm.pose(q)


CameraKinematics = Arm | FixedCameraKinematics | InverseCameraKinematics


def make_camera_kinematics(
    urdf: str, control: Arm, other: Arm, name: str
) -> Arm | InverseCameraKinematics:
    """Return the kinematics of a camera other than the control camera.

    Args:
        urdf: text of the robot description that contains the other camera.
        control: arm of the control camera.
        other: arm of the other camera.
        name: name of the other camera.

    Raises:
        ConfigurationError: the two cameras are moved by different joints, their targets are carried
            by different links, or the arm moves both a camera and its target.
    """
    if tuple(other.names) != tuple(control.names):
        raise ConfigurationError(
            f"camera '{name}' is moved by {', '.join(other.names)} and the control camera by "
            f"{', '.join(control.names)}: mount all cameras of a scheme on one link, or point them "
            "at a target that this link carries"
        )
    if other.target_frame == control.target_frame:
        return other
    if other.target_frame and control.target_frame:
        raise ConfigurationError(
            f"the target of camera '{name}' is on {other.target_frame} and that of the control "
            f"camera on {control.target_frame}: set the same target_frame for both"
        )
    outside = other if other.target_frame else control
    fixed_pose = Arm.find_fixed_pose(urdf, outside.camera_frame, outside.base_frame)
    if fixed_pose is None:
        raise ConfigurationError(
            f"the arm moves both the camera {outside.camera_frame} and its target "
            f"{outside.target_frame}: together with an eye-in-hand camera, this camera has to be "
            "fixed"
        )
    if outside is other:
        return InverseCameraKinematics(other, fixed_pose)
    fixed_arm = Arm.from_urdf(
        urdf, outside.camera_frame, outside.base_frame, outside.names, outside.target_frame
    )
    zero = np.zeros(len(other))
    world_T_target = fixed_pose @ inverse(fixed_arm.pose(zero))
    return InverseCameraKinematics(other, inverse(world_T_target) @ other.pose(zero))


@dataclass(eq=False)
class _WaitingImage:
    """An image that waits for those of other cameras.

    Attributes:
        stamp: stamp of the exposure, s.
        observe_frame: function that makes the observation of this image.
        observation: result of that function; None before the call.
    """

    stamp: float
    observe_frame: ObserveFrame
    observation: Observation | None = None


class CameraRig:
    """Observers of a scheme's cameras.

    Attributes:
        observers: observer of each camera by name, the control camera's first.
        find_joints: function that returns the joints at a stamp (s), or None; set by the loop's
            owner.
        missing_camera: name of the camera whose image has to arrive before the control camera's
            last image can be processed; empty if none is missing.
    """

    def __init__(self, observers: Iterable[FeatureObserver]) -> None:
        self.observers = {observer.name: observer for observer in observers}
        self.control = next(iter(self.observers.values()))
        self.find_joints: Callable[[float], JointSample | None] | None = None
        self._other_observers = {n: o for n, o in self.observers.items() if o is not self.control}
        self.reset()

    def reset(self) -> None:
        """Remove all images, for example after a reset of the clock."""
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
        """Add an image of the camera `name`, exposed at `stamp` (s).

        An image of the control camera waits for those of all other cameras.

        Returns:
            The stamp of the control camera's newest image that does not wait, and the function that
            observes it together with the images of the other cameras; None if all images wait.
        """
        if not self._other_observers:
            return stamp, observe_frame
        self._waiting_images[name].append(_WaitingImage(stamp, observe_frame))
        self._recent_stamps[name].append(stamp)
        waiting = self._waiting_images[self.control.name]
        self.missing_camera = ""
        for i in reversed(range(len(waiting))):
            image = waiting[i]
            matches = {n: self._find_matching_image(n, image.stamp) for n in self._other_observers}
            if all(matches.values()):
                for _ in range(i + 1):
                    waiting.popleft()
                return image.stamp, partial(self._observe_together, image, matches)
            self.missing_camera = next(n for n, one in matches.items() if one is None)
        return None

    def _find_matching_image(self, name: str, stamp: float) -> _WaitingImage | None:
        """Return the image of another camera that matches a stamp.

        Return None if a better match than the images so far can still arrive. The next image is
        expected one period of the camera after its last one.
        """
        period = self._estimate_period(name)
        shorter = min(period, self._estimate_period(self.control.name))
        tolerance = SAME_EXPOSURE_PART * shorter + ROUNDING
        images = self._waiting_images[name]
        candidates = [p for p in images if p.stamp <= stamp + tolerance]
        if not candidates:
            return None
        newest, last = candidates[-1], images[-1].stamp
        is_final = newest.stamp >= stamp - tolerance or last > stamp + tolerance
        return newest if is_final or period and last + period > stamp + tolerance else None

    def _estimate_period(self, name: str) -> float:
        """Return the period of a camera's images, s; 0 if it is unknown."""
        return min((b - a for a, b in pairwise(self._recent_stamps[name])), default=0.0)

    def _observe_together(
        self,
        control_image: _WaitingImage,
        other_images: Mapping[str, _WaitingImage],
        joints: JointSample | None,
        commands: tuple[JointSample, ...],
    ) -> Observation:
        observations = {}
        for name, other in other_images.items():
            if other.observation is None:
                exposure_joints = joints
                if self.find_joints is not None and other.stamp != control_image.stamp:
                    exposure_joints = self.find_joints(other.stamp)
                other.observation = other.observe_frame(exposure_joints, ())
            observations[name] = other.observation
        return self.merge_observations(control_image.observe_frame(joints, commands), observations)

    def merge_observations(
        self, control: Observation, other_cameras: Mapping[str, Observation]
    ) -> Observation:
        """Return the control camera's observation, with the others stored in `other_cameras`.

        Raises:
            MeasurementError: the pose of a camera relative to the control camera is unknown.
        """
        merged = {}
        for name, view in other_cameras.items():
            here = (
                self._compute_pose(name, control)
                if control.joints is not None
                else view.world_T_camera
            )
            motion = None
            if abs(view.stamp - control.stamp) > SAME_STAMP and view.world_T_camera is not None:
                motion = logarithm(relative_pose(view.world_T_camera, here))
            from_control = self._compute_twist_from_control(name, control, here)
            merged[name] = replace(
                view, twist_from_control=from_control, motion_since_exposure=motion,
                has_other_target=isinstance(self.observers[name].arm, InverseCameraKinematics),
            )  # fmt: skip
        return replace(control, other_cameras=merged)

    def _compute_pose(self, name: str, control: Observation) -> np.ndarray | None:
        """Return the pose (4, 4) of another camera at the exposure of the control camera."""
        arm: CameraKinematics | None = self.observers[name].arm
        return None if arm is None else arm.pose(control.joints.positions)

    def _compute_twist_from_control(
        self, name: str, control: Observation, here: np.ndarray | None
    ) -> np.ndarray | None:
        """Return the matrix that maps the control camera's twist to the twist of another camera.

        See `Observation.twist_from_control`.
        """
        arm = self.observers[name].arm
        if isinstance(arm, FixedCameraKinematics):
            return np.zeros((6, 6))
        if isinstance(arm, InverseCameraKinematics) and control.world_T_camera is not None:
            return -adjoint(relative_pose(arm.fixed_pose, control.world_T_camera))
        if here is None or control.world_T_camera is None:
            raise MeasurementError(
                f"the pose of camera {name} relative to {control.name} is unknown: joint states at "
                "the exposures are needed"
            )
        return adjoint(relative_pose(here, control.world_T_camera))
