"""Observation: a record of everything that is known of one image.

`observe` makes an observation. Features read observations and store nothing themselves. In the
camera's optical frame, z points forward, x to the right and y down. `a_T_b` (4, 4) maps b to a.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ..kinematics.free_body_kinematics import write_logarithm
from ..kinematics.joint_sample import JointSample

CAMERA = "camera"  # default name of the only camera of an experiment or a node


class Need(Enum):
    """Quantity that a scheme needs from an image; other quantities are not measured."""

    MOMENTS = "moments"
    CONTOUR = "contour"
    CORNERS = "corners"
    IMAGE = "image"
    DEPTH = "depth"
    KERNEL = "kernel"

    # The default hash of Enum is a slow Python function, which is called for each membership test
    # in a set of needs.
    __hash__ = object.__hash__


# Quantities that are measured on the segmented target. If the target is not found, the observation
# is not valid.
SEGMENTED = frozenset((Need.MOMENTS, Need.CONTOUR, Need.CORNERS, Need.KERNEL))


@dataclass(eq=False)
class Observation:
    """Everything that is known of one image; quantities that no scheme needs are None.

    An observation is made by `observe` from a frame. It contains what the scheme declares in
    `needs`; features and schemes read nothing else. Arrays are read-only.

    Lengths are in m, angles in rad, times in s; image coordinates are normalised, x = X/Z to the
    right and y = Y/Z downwards. `a_T_b` (4, 4) maps b to a.

    Attributes:
        stamp: time of the exposure, in s of simulated time.
        dt: time since the previous observation, s; 0.0 for the first one.
        valid: whether the segmentation found the target. A scheme with its own image processing
            decides this itself.
        reason: why the target was not found, as text.
        camera: camera model with K, D and lens. Its methods `normalise` and `project` convert
            between pixels and rays.
        joints: joint positions and velocities at the exposure, interpolated between joint states.
        world_T_camera: (4, 4) pose of the camera at the exposure, by kinematics ("world" is the
            arm's base).
        moments: image moments of the segmented target, in normalised coordinates.
        contour: (n, 2) outline of the target, normalised, with subpixel accuracy.
        corners: (n, 2) corners of the outline, in its order, normalised. The first corner can
            differ between images; PointFeature matches the corners to those of the goal.
        corner_accuracy: rms error of the corners in an image without noise, normalised; 0 if they
            are exact.
        corner_spread: (2n, m) errors of the corners' coordinates x_0, y_0, x_1, ... due to m
            independent causes, each as one standard deviation, normalised. They are estimated from
            the distances of edge points to their fitted lines. None if they are unknown.
        corner_repeatability: standard deviation of the part of the corners' error that changes from
            image to image even if the camera is at rest, normalised.
        corner_noise: standard deviation of the noise in corners and contour, normalised, as
            declared by their source.
        is_numbered: whether each corner is identified individually, as the corners of a marker are;
            None if exact corners can be treated either way.
        marker: `DICTIONARY:number` of the marker that has these corners; empty if there is none.
        pixel_count: number of pixels of the target; 0 if unknown.
        touched_borders: borders of the image that the target touches: left, right, top, bottom.
        image: (rows, columns) or (rows, columns, 3) RGB, uint8.
        depth: (rows, columns) float32, m along the optical axis.
        plane: plane of the target, from the depth image if the scheme needs it, otherwise from goal
            and kinematics; None if it is unknown.
        is_plane_measured: whether the plane comes from the depth image. A plane from goal and
            kinematics is wrong if the camera model is wrong or the target was moved.
        kernel: (20,) kernel features, as on the topic camera/data.
        previous_T_camera: (4, 4) motion since the previous observation, from the joints; None for
            the first observation, or if the joints at one of the two exposures are uncertain.
        commands: joint commands that were sent since the exposure.
        name: name of the camera.
        other_cameras: observations of the scheme's other cameras, by name.
        twist_from_control: (6, 6) matrix that maps the twist of the control camera (the first
            camera of the scheme) to the twist of this camera. Each twist is relative to the
            camera's own target and in its own frame. The matrix is zero if the arm moves neither
            this camera nor its target; None if this is the control camera.
        motion_since_exposure: (6,) motion of this camera between its own exposure and that of the
            control camera, as the twist in its own frame that causes this motion in one second;
            None if it is unknown, or if this is the control camera.
        has_other_target: whether this camera and the control camera view different targets, only
            one of which the arm carries. Then world_T_camera and plane refer to the target of this
            camera.
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
    corner_spread: np.ndarray | None = None
    corner_repeatability: float = 0.0
    corner_noise: float = 0.0
    is_numbered: bool | None = None
    marker: str = ""
    pixel_count: int = 0
    touched_borders: tuple[str, ...] = ()
    image: np.ndarray | None = None
    depth: np.ndarray | None = None
    plane: Plane | None = None
    is_plane_measured: bool = False
    kernel: np.ndarray | None = None
    previous_T_camera: np.ndarray | None = None
    commands: tuple[JointSample, ...] = ()
    name: str = CAMERA
    other_cameras: Mapping[str, Observation] = field(default_factory=dict)
    twist_from_control: np.ndarray | None = None
    motion_since_exposure: np.ndarray | None = None
    has_other_target: bool = False

    @property
    def cameras(self) -> dict[str, Observation]:
        """Return the observation of each camera by name, this one first.

        The observations have the same stamp if the images were exposed together.
        """
        return {self.name: self, **self.other_cameras}

    @property
    def is_from_image(self) -> bool:
        """Return whether the data come from an image, not from the geometry of the target."""
        return self.image is not None or self.depth is not None or self.pixel_count > 0

    def without_pixels(self) -> Observation:
        """Return the observation without images and depth images, for the record of a run."""
        if self.image is None and self.depth is None and not self.other_cameras:
            return self
        others = {name: view.without_pixels() for name, view in self.other_cameras.items()}
        return replace(self, image=None, depth=None, other_cameras=others)

    def with_noise(self) -> Observation:
        """Return the observation with `corner_noise` added to the accuracy of the corners."""
        return replace(
            self, corner_accuracy=float(np.hypot(self.corner_accuracy, self.corner_noise)),
            corner_repeatability=max(self.corner_repeatability, self.corner_noise),
            other_cameras={name: view.with_noise() for name, view in self.other_cameras.items()},
        )  # fmt: skip

    def transform_to_control(self, L: np.ndarray) -> np.ndarray:
        """Convert L (k, 6) of this camera's features to apply to the control camera's twist."""
        return L if self.twist_from_control is None else L @ self.twist_from_control

    def compute_change_since_exposure(self, L: np.ndarray) -> np.ndarray | float:
        """Return the change (k,) of features from this camera's exposure to the control camera's.

        It is L (k, 6) times the camera's motion between the two exposures; 0 if they are
        simultaneous.
        """
        return 0.0 if self.motion_since_exposure is None else L @ self.motion_since_exposure

    @cached_property
    def motion(self) -> np.ndarray | None:
        """Motion since the previous observation, as the twist (6,) that causes it in one second."""
        if self.previous_T_camera is None:
            return None
        motion = np.empty(6)
        write_logarithm(self.previous_T_camera, motion)
        return motion
