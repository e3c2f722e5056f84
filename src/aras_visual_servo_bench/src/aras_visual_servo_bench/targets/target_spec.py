"""Settings of a target: shape, pose, motion, occluder and box."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_camera.errors import VisionError

from ..errors import ExperimentError, catch_setting_errors, require
from .geometry import PlacedTarget, PoseHistory, TargetMotion
from .shapes import SHAPES
from .target_factory import find_shape, is_solid, list_parameters, make_target

MAX_TARGET_SIZE = 2.0  # maximum size of a target, m: the side of the table
Vector2 = tuple[float, float]
PoseValues = tuple[float, float, float, float, float, float]


def check_times(intervals: tuple[Vector2, ...] | None, name: str) -> None:
    """Check that the end of each time interval (s) is after its start.

    name: key of the intervals, for the error message.

    Raises:
        ExperimentError: an interval starts before 0, or does not end after its start.
    """
    for begin, end in intervals or ():
        require(0.0 <= begin < end,
                f"{name} has the interval {begin:g} to {end:g} s, must be 0 <= start < end")


@dataclass(frozen=True)
class SupportBoxSpec:
    """Movable box under a target, which can be pushed and grasped.

    size: size along the x, y and z axes of the target frame, m; the target lies on its top face.
    mass: mass, kg.
    friction: friction coefficient of the surface.
    """

    size: tuple[float, float, float] = parameter(above=0.0, most=MAX_TARGET_SIZE)
    mass: float = parameter(0.2, "kg", above=0.0)
    friction: float = parameter(1.0, least=0.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "target.box")


@dataclass(frozen=True)
class TargetSpec:
    """Settings of a target: shape, pose and motion.

    shape: one of: 'aras', the two plates of the demo; another name in `targets.shapes.SHAPES`; a
        class of your own, 'package.module:Class'; corners (x, y), m, of a flat polygon; the path of
        an image; the path of an SVG with an outline; the path of a mesh of a solid (STL, OBJ, DAE,
        glTF; lengths in m).
    size: size along x and y, m; for a solid along x, y and z. For an SVG, this is the size of its
        page. None: the size in the file (mesh; SVG with units), else 0.2 along each axis.
    scale: factor on the lengths of a mesh, instead of size, such as 0.001 for mm.
    marker: ArUco or AprilTag marker, or board of markers, that is tracked, such as 5 or
        'DICT_5X5_100:5'; '': the marker with which the goal was taught. The shape 'marker' is drawn
        with this marker.
    pose: pose of the target frame in the world: x, y, z (m), roll, pitch, yaw (rad). The z axis is
        the normal of the target. The plates of 'aras' are at (0, 0, 0.59) in this frame.
    motion: motion of the target; see Motion.
    occluder: lower and upper corner (x, y), m, of an opaque rectangle on the target.
    occluded: intervals (start, end) in which the occluder is present, s of simulated time, with a
        resolution of 1 ms, the physics step; the goal is taught without the occluder. None: the
        occluder is always present, also when the goal is taught.
    perturbed: whether the texture of the target is changed after the goal has been taught:
        brightness, contrast, noise and an erased patch, all drawn with the seed.
    box: movable white box under the target, on plant 'bullet'; None: the target is fixed and has no
        collision shape.
    model: name of a model in the world file; the target is a link of this model, which the
        simulation moves, and has the shape of this link.
    link: name of the link that is the target. It is a link of `model`; without `model`, it is a
        fixed link of the robot description. '': the only link of `model` with visuals.
    """

    shape: str | tuple[Vector2, ...] = parameter("aras", shorthand=True, importable=True)
    size: tuple[float, ...] | None = parameter(None, "m", above=0.0)
    pose: PoseValues = (0.0,) * 6
    motion: TargetMotion = TargetMotion()
    occluder: tuple[Vector2, Vector2] | None = None
    occluded: tuple[Vector2, ...] | None = None
    perturbed: bool = False
    box: SupportBoxSpec | None = None
    model: str = ""
    link: str = ""
    scale: float | None = parameter(None, above=0.0)
    marker: str | Mapping[str, Any] = parameter("", name=True)

    @property
    def placed_target(self) -> PlacedTarget:
        """Target with these settings, at its pose in the world.

        Raises:
            ExperimentError: the shape of the target cannot be read.
        """
        marker = self.marker if "marker" in list_parameters(self.shape) else ""
        shape = make_target(self.shape, self.size, self.scale, marker)
        pose_history = PoseHistory() if self.model else None
        pose = matrix_from_xyz_rpy(self.pose[:3], self.pose[3:])
        return PlacedTarget(shape, pose, self.motion, pose_history)

    @property
    def is_plain(self) -> bool:
        """True if the target has no box, occluder or perturbed texture, and is not a link."""
        has_object = self.box is not None or self.occluder is not None
        return not (has_object or self.perturbed or self.is_link)

    @property
    def is_link(self) -> bool:
        """True if the target is a link, of a model in the world or of the robot."""
        return bool(self.model or self.link)

    @property
    def is_provided(self) -> bool:
        """True if the robot or the world already contains the target, so it need not be spawned."""
        return self.is_in_description or self.is_link

    @property
    def is_mountable(self) -> bool:
        """True if the target can be fixed to a link, because it is plain and does not move."""
        return self.is_plain and self.motion.is_static

    @property
    def is_in_description(self) -> bool:
        """True if the robot description already contains the target.

        This is assumed if the setting `shape` lists corners and the setting `pose` is zero.
        """
        return isinstance(self.shape, tuple) and not any(self.pose)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "target")
        has_name = find_shape(self.shape) is not None
        draws_marker = "marker" in list_parameters(self.shape)
        if not (isinstance(self.shape, tuple) or has_name or Path(self.shape).suffix):
            raise ExperimentError(
                f"target.shape is '{self.shape}', must be a list of corners, the path of an "
                "image, an SVG or a mesh, 'package.module:Class', or a name: "
                f"{suggest(self.shape, SHAPES)}"
            )
        if self.marker != "":
            self._check_marker(draws_marker, has_name)
        require(self.occluded is None or self.occluder is not None,
                "target.occluded needs an occluder: set target.occluder, too")
        check_times(self.occluded, "target.occluded")
        require(
            not is_solid(self.shape) or self.box is None and self.occluder is None
            and not self.perturbed,
            "target.box, target.occluder and target.perturbed apply only to flat targets, but the "
            "shape is a solid: leave them out",
        )
        require(
            not self.is_link
            or (self.shape == "aras" or is_solid(self.shape))
            and self.motion.is_static
            and self.box is None
            and self.occluder is None,
            "a target that is a link has the link's shape and motion: leave out target.shape, "
            "motion, box and occluder",
        )
        in_description = self.shape == "aras" or self.is_in_description
        require(
            self.box is None or not in_description and self.motion == TargetMotion(),
            "target.box needs a target with a pose, without motion, and with a shape other than "
            "'aras': change the target, or leave out target.box",
        )

    def _check_marker(self, draws_marker: bool, has_name: bool) -> None:
        """Check that the marker exists and that the target can contain it.

        Args:
            draws_marker: whether the shape has a parameter `marker`.
            has_name: whether the shape is given by a name or a class.

        Raises:
            ExperimentError: the marker is invalid, or the target cannot contain markers.
        """
        from aras_visual_servo_camera.markers import MarkerChoice

        with catch_setting_errors(VisionError):
            choice = MarkerChoice.read(self.marker, "target.marker")
        require(
            not draws_marker or choice.board is None,
            f"target.marker of the shape '{self.shape}' must be a single marker: for a board, give "
            "an image of the board as the shape",
        )
        require(
            not self.marker or not is_solid(self.shape) and not self.is_link
            and (draws_marker or not has_name) and isinstance(self.shape, str),
            f"target.marker applies only to a target that shows markers, such as an image, but "
            f"{self.shape} shows none: leave out target.marker",
        )
