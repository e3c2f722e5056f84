"""What is known of one image: one immutable record, made by one factory.

The node, the runner and the tests all make `Observation`s with an `Observer`; a feature reads
them and keeps nothing of its own. Frames: the camera's optical frame has z forward, x right, y
down; `a_T_b` (4, 4) maps b to a.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from math import hypot
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from aras_visual_servo_base.poses import logarithm, relative
from aras_visual_servo_camera.contour import CORNER_ACCURACY, fit_corners, outline_of
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.pipeline import Pipeline, PipelineSettings
from aras_visual_servo_camera.undistortion import CameraModel

from .joint_sample import JointSample

if TYPE_CHECKING:
    from aras_visual_servo_camera.trackers import Tracker

    from ..arm import Arm

CAMERA = "camera"  # name of the one camera of an experiment or a node that names none
# Normalised coordinates beyond this are no pixel of any lens: 88 degrees off the axis is 29.
FARTHEST = 30.0


class Need(Enum):
    """What a feature or a scheme needs of an image; nothing else is measured for it."""

    MOMENTS = "moments"
    CONTOUR = "contour"
    CORNERS = "corners"
    IMAGE = "image"
    DEPTH = "depth"
    KERNEL = "kernel"


# Needs that the segmented target answers: without it such an observation is not valid.
SEGMENTED = frozenset((Need.MOMENTS, Need.CONTOUR, Need.CORNERS, Need.KERNEL))


@dataclass(frozen=True, eq=False)
class Observation:
    """Everything that is known of one image; what no scheme needs is None, arrays are read-only.

    Lengths are in m, angles in rad, times in s; image coordinates are normalised, x = X/Z to the
    right and y = Y/Z downwards. `a_T_b` (4, 4) maps b to a.

    Attributes:
        stamp: exposure, s of simulated time.
        dt: s since the previous observation; 0.0 for the first.
        valid, reason: whether the segmentation found the target, and why not. A scheme with its
            own image processing decides for itself.
        camera: K, D and lens; `normalise` and `project` between pixels and rays.
        joints: at the exposure, interpolated by stamp.
        world_T_camera: (4, 4) at the exposure, by kinematics ("world" is the arm's base).
        moments: of the segmented target, normalised coordinates.
        contour: (n, 2) outline of the target, normalised, below a pixel exact.
        corners: (n, 2) of that outline, in its order, normalised.
        corner_accuracy: normalised length to which they are found, noise apart, rms; 0: exactly.
        corner_deviation: the part of it that the scatter of the outline about its sides makes,
            which shrinks with the distance from a goal shown by the same camera; 0: not known.
        corner_unshared: the part of it that a goal shown by the same camera does not share.
        corner_noise: standard deviation of noise in corners and contour, normalised, where their
            source declares it.
        numbered: whether each corner is known by itself, as a marker's is; None: they are exact,
            and a scheme takes them as it needs.
        marker: `DICTIONARY:number` of the marker whose corners they are; '' where there is none.
        pixel_count: pixels of the target, 0 where not known.
        touches: borders of the image that the target touches: left, right, top, bottom.
        image: (rows, columns) or (rows, columns, 3) RGB, uint8.
        depth: (rows, columns) float32, m along the optical axis.
        plane: of the target: by the depth image where that is asked for, else where goal and
            kinematics have it; None where neither tells it.
        plane_measured: whether it does not come from goal and kinematics, which are wrong where the
            camera is not as believed, or the target elsewhere.
        kernel: (20,) the original's camera/data of this very image.
        previous_T_camera: (4, 4) motion executed since the previous observation, from the joints;
            None at the first, and where the joints at one of the two are guessed.
        commands: what was commanded since the exposure.
        name: of the camera.
        others: of the other cameras of a scheme of several, by name.
        of_control: (6, 6) of another camera than the first one of a scheme, the control camera: its
            twist, relative to what it looks at, is of_control @ that of the control camera, each in
            its own frame. Zero where the arm moves neither; None: it is the control camera.
        moved: (6,) its motion from its own exposure to the control camera's, in its own frame, as
            the twist that makes it in one second; None where that is not known, or it is that one.
        apart: whether what it looks at is carried where the control camera's target stands, or the
            reverse: world_T_camera and plane are then those of another target.
    """

    stamp: float
    dt: float
    valid: bool
    reason: str
    camera: CameraModel
    joints: JointSample | None = None
    world_T_camera: np.ndarray | None = None
    moments: Moments | None = None
    contour: np.ndarray | None = None
    corners: np.ndarray | None = None
    corner_accuracy: float = 0.0
    corner_deviation: float = 0.0
    corner_unshared: float = 0.0
    corner_noise: float = 0.0
    numbered: bool | None = None
    marker: str = ""
    pixel_count: int = 0
    touches: tuple[str, ...] = ()
    image: np.ndarray | None = None
    depth: np.ndarray | None = None
    plane: Plane | None = None
    plane_measured: bool = False
    kernel: np.ndarray | None = None
    previous_T_camera: np.ndarray | None = None
    commands: tuple[JointSample, ...] = ()
    name: str = CAMERA
    others: Mapping[str, Observation] = field(default_factory=dict)
    of_control: np.ndarray | None = None
    moved: np.ndarray | None = None
    apart: bool = False

    @property
    def cameras(self) -> dict[str, Observation]:
        """What each camera of the scheme saw, by name; the first, this one, is the control camera.

        Their stamps are the same where they were exposed together.
        """
        return {self.name: self, **self.others}

    @property
    def pictured(self) -> bool:
        """Whether what is seen comes from a picture, and not from exact geometry."""
        return self.image is not None or self.depth is not None or self.pixel_count > 0

    def with_noise(self) -> Observation:
        """The same with noise as a part of the accuracy that the corners have in each image."""
        if not self.corner_noise:
            return self
        return replace(
            self, corner_accuracy=float(np.hypot(self.corner_accuracy, self.corner_noise)),
            corner_unshared=max(self.corner_unshared, self.corner_noise),
            others={name: view.with_noise() for name, view in self.others.items()},
        )  # fmt: skip

    def brought(self, L: np.ndarray) -> np.ndarray:
        """L (k, 6) of features of this camera, for the twist of the control camera."""
        return L if self.of_control is None else L @ self.of_control

    def up_to_now(self, L: np.ndarray) -> np.ndarray | float:
        """What features of this camera with L (k, 6) have changed by since its exposure up to the
        control camera's, to first order; 0 where the two were exposed together."""
        return 0.0 if self.moved is None else L @ self.moved

    @cached_property
    def motion(self) -> np.ndarray | None:
        """(6,) previous_T_camera as the twist that makes it in one second."""
        return None if self.previous_T_camera is None else logarithm(self.previous_T_camera)


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
                    corners, deviation = fit_corners(contour)
                    seen["corners"], seen["corner_deviation"] = _frozen(corners), deviation
                    seen["corner_accuracy"] = hypot(CORNER_ACCURACY / camera.K[0], deviation)
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
