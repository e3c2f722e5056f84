"""From a frame to an observation: what the scheme needs, and what changed since the last frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from aras_visual_servo_base.poses import relative
from aras_visual_servo_camera.contour import CORNER_ACCURACY, fit_corners, outline_of
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.line_fits import deviation_of
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.pipeline import Pipeline, PipelineSettings
from aras_visual_servo_camera.undistortion import CameraModel, normalise_pixels

from ..arm.joint_sample import JointSample
from .observation import CAMERA, SEGMENTED, Need, Observation

if TYPE_CHECKING:
    from aras_visual_servo_camera.trackers import Tracker

    from ..arm import Arm
    from .frame import Frame

# Normalised coordinates beyond this are no pixel of any lens: 88 degrees off the axis is 29.
FARTHEST = 30.0


def observe(
    frame: Frame,
    joints: JointSample | None,
    observer: Observer,
    camera: CameraModel | None = None,
    commands: Sequence[JointSample] = (),
    plane: Plane | None = None,
    world_T_camera: np.ndarray | None = None,
) -> Observation:
    """Work out of a frame what the scheme needs: moments, contour, corners, plane.

    Args:
        frame: image, exact features in px, or moments.
        joints: at the exposure; None: not known.
        observer: knows the arm, the scheme's needs, the goal's plane and the frame before.
        camera: intrinsics by which pixels are read; None: those of the frame.
        commands: given since the exposure.
        plane: of the target, where it is known better than by goal and kinematics.
        world_T_camera: (4, 4) where it is known better than by the joints.

    Returns:
        The observation; not `valid`, with a reason, where the target is not found.
    """
    camera = frame.camera if camera is None else camera
    if frame.image is not None:
        return observer.of_image(frame.stamp, frame.picture, camera, joints, commands, frame.depth,
                                 plane, world_T_camera)  # fmt: skip
    if (target := frame.target) is not None:
        return observer.of_moments(
            frame.stamp, target.moments, target.valid, target.reason, camera, joints, commands,
            target.kernel, target.pixel_count, target.touches,
        )  # fmt: skip
    outline, points = frame.outline, frame.points
    if outline is not None:
        outline = normalise_pixels(outline, frame.camera, camera, closed=True)
    if points is not None:
        points = normalise_pixels(points, frame.camera, camera)
    return observer.of_exact(frame.stamp, camera, joints, world_T_camera, outline, points, commands,
                             plane, frame.jitter / camera.K[0])  # fmt: skip


class Observer:
    """Makes the observations of one camera: from an image, from moments, or from exact geometry.

    It keeps the last observation's stamp and pose, from which the next one gets dt and motion.

    Attributes:
        arm: for the camera's pose; None: no poses, unless they are given.
        needs: what the scheme needs; nothing else is measured.
        plane_from: function from world_T_camera (4, 4) to the target's plane there or None, such as
            `Goal.plane_from`; None: no planes, unless they are given.
        pipeline: segmentation and moments, for `of_image`.
        name: of the camera.
    """

    def __init__(
        self,
        arm: Arm | None,
        needs: frozenset[Need] = frozenset((Need.MOMENTS,)),
        vision: PipelineSettings | None = None,
        tracker: Tracker | None = None,
        plane_from: Callable[[np.ndarray], Plane | None] | None = None,
        name: str = CAMERA,
    ) -> None:
        """`tracker`: of the points that count as corners; None: those of the outline."""
        self.arm, self.plane_from, self.name = arm, plane_from, name
        self.tracker = tracker
        self.needs = frozenset(needs)
        self.pipeline = Pipeline(vision if vision is not None else PipelineSettings())
        self.reset()

    def reset(self) -> None:
        """Forget the last observation, as after the clock went back."""
        self._stamp: float | None = None
        self._pose: np.ndarray | None = None
        self.pipeline.reset()
        if self.tracker is not None:
            self.tracker.reset()

    def of_image(
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
        """Run the camera package's own pipeline on a picture.

        Args:
            stamp: of the exposure, s.
            image: `Image`, or (rows, columns) grey or (rows, columns, 3) RGB, uint8.
            camera: its intrinsics.
            joints: at the exposure.
            commands: given since the exposure.
            depth: (rows, columns), m.
            plane: of the target, where it is known better than by goal and kinematics.
            world_T_camera: (4, 4) where it is known better than by the joints.
        """
        if not isinstance(image, Image):
            image = Image(np.asarray(image), "mono8" if np.ndim(image) == 2 else "rgb8")
        seen: dict[str, object] = {}
        valid, reason = True, ""
        tracked = self.tracker is not None and Need.CORNERS in self.needs
        needs = self.needs - {Need.CORNERS} if tracked else self.needs
        if needs & SEGMENTED:
            valid, reason, seen = self._segmented(image, camera, needs)
        if valid and tracked:
            try:
                found = self.tracker.look(
                    image.grey, camera, self._pose_at(joints, world_T_camera), depth
                )
                seen["corners"] = _frozen(found.points)
                seen["corner_accuracy"] = found.accuracy
                seen["corner_unshared"] = found.unshared
                seen["corner_spread"] = None if found.spread is None else _frozen(found.spread)
                seen["numbered"] = self.tracker.numbered
                seen["marker"] = found.marker
                plane = found.plane if plane is None else plane
            except VisionError as error:
                valid, reason = False, str(error)
        if Need.IMAGE in self.needs:
            pixels = image.rgb if image.has_colour else image.grey
            seen["image"] = _read_only(pixels)
        if Need.DEPTH in self.needs and depth is not None:
            seen["depth"] = _read_only(np.asarray(depth, np.float32))
            if plane is None and valid:
                from .depth_image import plane_of

                plane = plane_of(seen["depth"], camera, seen.get("corners", seen.get("contour")))
        return self._made(stamp, valid, reason, camera, joints, world_T_camera, commands,
                          plane=plane, **seen)  # fmt: skip

    def of_moments(
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
        touches: Sequence[str] = (),
    ) -> Observation:
        """From what the camera node measured (ImageMoments), without the picture itself."""
        if valid and moments is not None and (fault := implausible(moments)):
            valid, reason, moments = False, fault, None
        if valid and moments is None and Need.MOMENTS in self.needs:
            valid, reason = False, reason or "the camera node sent no moments"
        return self._made(
            stamp, bool(valid), reason, camera, joints, None, commands,
            moments=moments,
            kernel=None if kernel is None else _frozen(kernel),
            pixel_count=int(pixel_count),
            touches=tuple(touches),
        )  # fmt: skip

    def of_exact(
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
        """Exact features of a target, without pictures.

        Args:
            stamp, camera, joints, commands, plane: as in `of_image`.
            world_T_camera: (4, 4); from the joints where it is left out.
            contour: (n, 2) outline, normalised: its moments are exact, its vertices the corners.
            points: (n, 2) corners where the contour has others, or where there is none.
            noise: standard deviation that was added to their coordinates, normalised.
        """
        valid, reason, moments, corners = True, "", None, None
        if contour is not None:
            contour = corners = _frozen(contour)
            try:
                moments = Moments.from_polygon(contour)
            except VisionError as error:
                valid, reason = False, str(error)
        if points is not None:
            corners = _frozen(points)
        if contour is None and points is None:
            valid, reason = False, "the target is not in view"
        elif not all(np.isfinite(a).all() for a in (contour, corners) if a is not None):
            valid, reason = False, "a coordinate of the target is not finite"
        return self._made(
            stamp, valid, reason, camera, joints, world_T_camera, commands,
            moments=moments, contour=contour, corners=corners, plane=plane, corner_noise=noise,
        )  # fmt: skip

    def _pose_at(
        self, joints: JointSample | None, world_T_camera: np.ndarray | None
    ) -> np.ndarray | None:
        """world_T_camera (4, 4): as given, else by the joints; None where neither tells it."""
        if world_T_camera is None and joints is not None and self.arm is not None:
            return self.arm.pose(joints.positions)
        return world_T_camera

    def _segmented(
        self, image: Image, camera: CameraModel, needs: frozenset[Need]
    ) -> tuple[bool, str, dict[str, object]]:
        """What the pipeline finds of the target, by field of Observation."""
        self.pipeline.set_camera(camera)
        try:
            measured = self.pipeline.measure(image)
        except VisionError as error:
            return False, str(error), {}
        target = measured.target
        seen = {"pixel_count": target.pixel_count, "touches": target.borders}
        if not measured.valid:
            return False, measured.reason, seen
        seen["moments"] = measured.moments
        try:
            if needs & {Need.CONTOUR, Need.CORNERS, Need.DEPTH}:
                contour = outline_of(image.grey, target, camera)
                seen["contour"] = _frozen(contour)
                if Need.CORNERS in needs:
                    corners, spread = fit_corners(contour)
                    seen["corners"], seen["corner_spread"] = _frozen(corners), _frozen(spread)
                    seen["corner_accuracy"] = hypot(
                        CORNER_ACCURACY / camera.K[0], deviation_of(spread)
                    )
                    seen["numbered"] = False
            if Need.KERNEL in needs:
                from aras_visual_servo_camera.kernel import kernel_features

                mask = self.pipeline.original_mask(image)
                seen["kernel"] = _frozen(kernel_features(mask).layout())
        except VisionError as error:
            return False, str(error), seen
        return True, "", seen

    def _made(
        self,
        stamp: float,
        valid: bool,
        reason: str,
        camera: CameraModel,
        joints: JointSample | None,
        world_T_camera: np.ndarray | None,
        commands: Sequence[JointSample],
        plane: Plane | None = None,
        depth: np.ndarray | None = None,
        **seen: object,
    ) -> Observation:
        stamp = float(stamp)
        pose = self._pose_at(joints, world_T_camera)
        if pose is not None:
            pose = _frozen(pose)
        measured = plane is not None
        if plane is None and depth is None and pose is not None and self.plane_from is not None:
            plane = self.plane_from(pose)
        guessed = world_T_camera is None and joints is not None and joints.guessed
        known = None if guessed else pose
        dt, moved = 0.0, None
        if self._stamp is not None and stamp > self._stamp:
            dt = stamp - self._stamp
            if known is not None and self._pose is not None:
                moved = relative(self._pose, known)
                moved.setflags(write=False)
        if self._stamp is None or stamp > self._stamp:
            self._stamp, self._pose = stamp, known
        return Observation(
            stamp, dt, valid, reason, camera, joints, pose,
            previous_T_camera=moved, commands=tuple(commands), plane=plane, depth=depth,
            plane_measured=measured, name=self.name, **seen,
        )  # fmt: skip


def implausible(moments: Moments) -> str:
    """Why no camera can have seen these moments, in words; empty when one can."""
    if not (abs(moments.xg) < FARTHEST and abs(moments.yg) < FARTHEST):
        return f"implausible moments: the target's centre at {moments.xg:.3g}, {moments.yg:.3g}"
    if not 0.0 < moments.m00 < (2.0 * FARTHEST) ** 2:
        return f"implausible moments: an area of {moments.m00:.3g}"
    powers = (2.0 * FARTHEST) ** np.add.outer(*(np.arange(moments.order + 1),) * 2)
    if not (np.abs(moments.centred) <= moments.m00 * powers).all():
        return f"implausible moments: {np.abs(moments.centred).max():.3g} for an area of " + (
            f"{moments.m00:.3g}"
        )
    return ""


def _frozen(values: ArrayLike) -> np.ndarray:
    """A read-only copy in float64."""
    array = np.array(values, float)
    array.setflags(write=False)
    return array


def _read_only(array: np.ndarray) -> np.ndarray:
    """A read-only view: pictures are not copied."""
    view = array.view()
    view.setflags(write=False)
    return view
