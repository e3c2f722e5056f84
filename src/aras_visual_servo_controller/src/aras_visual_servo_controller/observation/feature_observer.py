"""Observer of one camera, which measures the quantities that the scheme needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from aras_visual_servo_base.poses import relative_pose
from aras_visual_servo_camera.camera_model import CameraModel, normalise_pixels
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.segmentation_settings import SegmentationSettings

from ..kinematics.joint_sample import JointSample, make_read_only_copy
from .observation import CAMERA, Need, Observation

if TYPE_CHECKING:
    from aras_visual_servo_camera.images import Image
    from aras_visual_servo_camera.trackers import Tracker

    from ..kinematics import Arm
    from .feature_extractor import FeatureExtractor
    from .frame import Frame

# Largest plausible normalised coordinate of a point; 30 corresponds to 88 degrees from the optical
# axis.
MAX_COORDINATE = 30.0


def observe(
    frame: Frame,
    joints: JointSample | None,
    observer: FeatureObserver,
    camera: CameraModel | None = None,
    commands: Sequence[JointSample] = (),
    plane: Plane | None = None,
    world_T_camera: np.ndarray | None = None,
) -> Observation:
    """Measure the quantities that the scheme needs in a frame: moments, contour, corners, plane.

    Args:
        frame: image, or exact outline and corners in px, or moments.
        joints: joints at the exposure; None if they are unknown.
        observer: observer with the arm, the scheme's needs, the goal's plane and the last frame.
        camera: intrinsics with which the pixels are read; None for those of the frame.
        commands: commands that were sent since the exposure.
        plane: plane of the target, if it is known more accurately than from the goal and the
            camera's pose.
        world_T_camera: (4, 4) pose of the camera, if it is known more accurately than from the
            joints.

    Returns:
        The observation. If the target is not found, the observation is not `valid` and its `reason`
        says why.
    """
    camera = frame.camera if camera is None else camera
    if frame.image is not None:
        return observer.observe_image(
            frame.stamp, observer.images.decode_image(frame), camera, joints, commands,
            frame.depth, plane, world_T_camera,
        )  # fmt: skip
    if (target := frame.target) is not None:
        return observer.observe_moments(
            frame.stamp, target.moments, target.valid, target.reason, camera, joints, commands,
            target.kernel, target.pixel_count, target.touched_borders,
        )  # fmt: skip
    outline, points = frame.outline, frame.points
    # the normalised points are new arrays; read-only ones are not copied
    if outline is not None:
        outline = normalise_pixels(outline, frame.camera, camera, is_closed=True)
        outline.setflags(write=False)
    if points is not None:
        points = normalise_pixels(points, frame.camera, camera)
        points.setflags(write=False)
    return observer.observe_exact_features(
        frame.stamp, camera, joints, world_T_camera, outline, points, commands, plane,
        frame.jitter / camera.K[0],
    )  # fmt: skip


class FeatureObserver:
    """Observer of one camera: makes its observations from images, moments or exact geometry.

    The stamp and pose of the last observation are stored, to compute the time step and the motion
    of the next one.

    Attributes:
        arm: arm that gives the camera's pose; None if the only known poses are those passed as
            arguments.
        needs: quantities that the scheme needs; other quantities are not measured.
        compute_plane: function that returns the target's plane in the camera's frame, or None, for
            world_T_camera (4, 4), such as `Goal.compute_plane`; None if the only known planes are
            those passed as arguments.
        images: reader of images for `observe_image`, created for the first image.
        segmentation: method that selects the target's pixels.
        name: name of the camera.
    """

    def __init__(
        self,
        arm: Arm | None,
        needs: frozenset[Need] = frozenset((Need.MOMENTS,)),
        segmentation: SegmentationSettings | None = None,
        tracker: Tracker | None = None,
        compute_plane: Callable[[np.ndarray], Plane | None] | None = None,
        name: str = CAMERA,
    ) -> None:
        """Create the observer.

        Args:
            tracker: tracker of the points that are used as corners; None to use the corners of the
                outline.
        """
        self.arm, self.compute_plane, self.name = arm, compute_plane, name
        self.tracker = tracker
        self.segmentation = SegmentationSettings() if segmentation is None else segmentation
        self.needs = frozenset(needs)
        self.reset()

    def reset(self) -> None:
        """Forget the last observation, for example after a reset of the clock."""
        self._last_stamp: float | None = None
        self._last_pose: np.ndarray | None = None
        self.__dict__.pop("images", None)
        if self.tracker is not None:
            self.tracker.reset()

    @cached_property
    def images(self) -> FeatureExtractor:
        """Reader of images; it is created at the first use, because exact features need no reader.
        """
        from .feature_extractor import FeatureExtractor

        return FeatureExtractor(self.needs, self.segmentation, self.tracker)

    def observe_image(
        self,
        stamp: float,
        image: Image | np.ndarray,
        camera: CameraModel,
        joints: JointSample | None = None,
        commands: Sequence[JointSample] = (),
        depth: np.ndarray | None = None,
        plane: Plane | None = None,
        world_T_camera: np.ndarray | None = None,
    ) -> Observation:
        """Measure an image with the pipeline of the camera package.

        Args:
            stamp: stamp of the exposure, s.
            image: `Image`, or (rows, columns) grey or (rows, columns, 3) RGB, uint8.
            camera: intrinsics of the camera.
            joints: joints at the exposure.
            commands: commands that were sent since the exposure.
            depth: (rows, columns) depth image, m.
            plane: plane of the target, if it is known more accurately than from goal and
                kinematics.
            world_T_camera: (4, 4) pose of the camera, if it is known more accurately than from the
                joints.
        """
        pose = self._find_pose(joints, world_T_camera)
        valid, reason, plane, fields = self.images.read(image, camera, pose, depth, plane)
        return self._make_observation(
            stamp, valid, reason, camera, joints, world_T_camera, commands, pose, plane, **fields
        )

    def observe_moments(
        self,
        stamp: float,
        moments: Moments | None,
        valid: bool,
        reason: str,
        camera: CameraModel,
        joints: JointSample | None = None,
        commands: Sequence[JointSample] = (),
        kernel: ArrayLike | None = None,
        pixel_count: int = 0,
        touched_borders: Sequence[str] = (),
    ) -> Observation:
        """Make an observation from the moments that the camera node measured (ImageMoments)."""
        if valid and moments is not None and (fault := explain_implausible(moments)):
            valid, reason, moments = False, fault, None
        if valid and moments is None and Need.MOMENTS in self.needs:
            valid, reason = False, reason or "the camera node sent no moments"
        return self._make_observation(
            stamp, bool(valid), reason, camera, joints, None, commands,
            moments=moments,
            kernel=None if kernel is None else make_read_only_copy(kernel),
            pixel_count=int(pixel_count),
            touched_borders=tuple(touched_borders),
        )  # fmt: skip

    def observe_exact_features(
        self,
        stamp: float,
        camera: CameraModel,
        joints: JointSample | None = None,
        world_T_camera: np.ndarray | None = None,
        contour: ArrayLike | None = None,
        points: ArrayLike | None = None,
        commands: Sequence[JointSample] = (),
        plane: Plane | None = None,
        noise: float = 0.0,
    ) -> Observation:
        """Make an observation from exact features of the target, without an image.

        Args:
            stamp, camera, joints, commands, plane: see `observe_image`.
            world_T_camera: (4, 4) pose of the camera; None to compute it from the joints.
            contour: (n, 2) outline, normalised. Its moments are exact, and its vertices are the
                corners.
            points: (n, 2) corners, if they are not the vertices of the contour.
            noise: standard deviation of the noise added to the coordinates, normalised.
        """
        valid, reason, moments, corners = True, "", None, None
        if contour is not None:
            contour = np.asarray(contour, float)
            if contour.flags.writeable:
                contour = make_read_only_copy(contour)
            corners = contour
            try:
                moments = Moments.from_polygon(contour)
            except VisionError as error:
                valid, reason = False, str(error)
        if points is not None:
            corners = np.asarray(points, float)
            if corners.flags.writeable:
                corners = make_read_only_copy(corners)
        if contour is None and points is None:
            valid, reason = False, "the target is not in view"
        elif not (
            (corners is contour or all(np.isfinite(corners.ravel()).tolist()))
            # with moments, the contour needs no check, because `from_polygon` has computed the
            # moments from it
            and (contour is None or moments is not None or np.isfinite(contour).all())
        ):
            valid, reason = False, "a coordinate of the target's outline or corners is not finite"
        return self._make_observation(
            stamp, valid, reason, camera, joints, world_T_camera, commands,
            moments=moments, contour=contour, corners=corners, plane=plane, corner_noise=noise,
        )  # fmt: skip

    def _find_pose(
        self, joints: JointSample | None, world_T_camera: np.ndarray | None
    ) -> np.ndarray | None:
        """Return world_T_camera (4, 4) as given, or else from the joints.

        Return None if both are unknown.
        """
        if world_T_camera is None and joints is not None and self.arm is not None:
            return self.arm.pose(joints.positions)
        return world_T_camera

    def _make_observation(
        self,
        stamp: float,
        valid: bool,
        reason: str,
        camera: CameraModel,
        joints: JointSample | None,
        world_T_camera: np.ndarray | None,
        commands: Sequence[JointSample],
        pose: np.ndarray | None = None,
        plane: Plane | None = None,
        depth: np.ndarray | None = None,
        **fields: object,
    ) -> Observation:
        stamp = float(stamp)
        if pose is None:
            pose = self._find_pose(joints, world_T_camera)
        if pose is not None:
            # np.asarray makes no copy, so the pose can be the arm's own array, which is read-only
            pose = np.asarray(pose, float)
            pose = make_read_only_copy(pose) if pose.flags.writeable else pose
        is_measured = plane is not None
        if plane is None and depth is None and pose is not None and self.compute_plane is not None:
            plane = self.compute_plane(pose)
        is_guessed = world_T_camera is None and joints is not None and joints.is_uncertain
        exact_pose = None if is_guessed else pose
        dt, motion, last_stamp = 0.0, None, self._last_stamp
        if last_stamp is None or stamp > last_stamp:
            if last_stamp is not None:
                dt = stamp - last_stamp
            if exact_pose is not None and self._last_pose is not None:
                motion = relative_pose(self._last_pose, exact_pose)
                motion.setflags(write=False)
            self._last_stamp, self._last_pose = stamp, exact_pose
        return Observation(
            stamp, dt, valid, reason, camera, joints, pose,
            previous_T_camera=motion, commands=tuple(commands), plane=plane, depth=depth,
            is_plane_measured=is_measured, name=self.name, **fields,
        )  # fmt: skip


def explain_implausible(moments: Moments) -> str:
    """Describe why no camera can measure these moments; empty text if they are plausible."""
    if not (abs(moments.xg) < MAX_COORDINATE and abs(moments.yg) < MAX_COORDINATE):
        return f"implausible moments: the target's centre is ({moments.xg:.3g}, {moments.yg:.3g})"
    if not 0.0 < moments.m00 < (2.0 * MAX_COORDINATE) ** 2:
        return f"implausible moments: the target's area is {moments.m00:.3g}"
    powers = (2.0 * MAX_COORDINATE) ** np.add.outer(*(np.arange(moments.order + 1),) * 2)
    if not (np.abs(moments.centred) <= moments.m00 * powers).all():
        return (
            f"implausible moments: a moment of {np.abs(moments.centred).max():.3g} for an area of "
            f"{moments.m00:.3g}"
        )
    return ""
