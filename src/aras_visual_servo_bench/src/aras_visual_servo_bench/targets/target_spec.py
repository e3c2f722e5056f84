"""What is looked at: a target's shape, place, motion and what lies on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_camera.errors import VisionError

from ..errors import ExperimentError, require
from .geometry import Motion, PlacedTarget, PoseHistory
from .shapes import SHAPES
from .target_factory import find_shape, is_solid, list_parameters, make_target

MAX_TARGET_SIZE = 2.0  # m, the table's
Vector2 = tuple[float, float]
PoseValues = tuple[float, float, float, float, float, float]


def check_times(intervals: tuple[Vector2, ...] | None, name: str) -> None:
    """ExperimentError where a time, s, from which something is there is not before its end."""
    for begin, end in intervals or ():
        require(0.0 <= begin < end,
                f"{name} is from {begin:g} to {end:g} s, must rise from 0 on")


@dataclass(frozen=True)
class BoxSpec:
    """A box on which a target lies, loose: it can be pushed and grasped.

    size: along the target's x, y and z, m; its top is the target's plane. mass: kg. friction: of
    its surface.
    """

    size: tuple[float, float, float] = parameter(above=0.0, most=MAX_TARGET_SIZE)
    mass: float = parameter(0.2, "kg", above=0.0)
    friction: float = parameter(1.0, least=0.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "target.box")


@dataclass(frozen=True)
class TargetSpec:
    """The target: what it is, where, and how it moves.

    shape: 'aras', the demo's two plates; another name of `targets.shapes.SHAPES`, or
        'package.module:Class' of your own; corners (x, y), m, of a flat polygon; the path of a
        picture, of an SVG with an outline, or of a mesh (STL, OBJ, DAE, glTF; m), which is a solid.
    size: of a named shape, a picture or an SVG's page, along x and y, of a solid along z too, m;
        None: that of the file (a mesh; an SVG with units), else 0.2 along each.
    scale: factor on the lengths of a mesh, in place of size: 0.001 where they are in mm.
    marker: number of the ArUco or AprilTag marker that is followed (5, 'DICT_5X5_100:5'), or a
        board of several, where the shape shows them; '': the one that the goal was taught by. The
        shape 'marker' is drawn as the one that is given.
    pose: x, y, z (m), roll, pitch, yaw (rad) of its frame in the world; its z axis is its normal.
        The plates of 'aras' lie at (0, 0, 0.59) in that frame. motion: see Motion.
    occluder: low and high corner (x, y), m, of an opaque rectangle that lies on the target.
    occluded: from when and until when it lies there, s of simulated time, as often as it comes (to
        a step of the physics, 1 ms); the goal is taught without it. None: it always lies there,
        when the goal is taught too.
    perturbed: a target with a picture has another one in the run than when the goal was taught:
        brighter or darker, of other contrast, grained, with a patch erased, by the seed.
    box: a white box under it that is loose; None: it stands and touches nothing (bullet).
    model: of the world file, one of whose links is the target, in place of a shape; it is where the
        simulation has it. link: of it; '': the only one that is seen. Without a model it is a link
        of the robot's own description, which no joint moves.
    """

    shape: str | tuple[Vector2, ...] = parameter("aras", shorthand=True, importable=True)
    size: tuple[float, ...] | None = parameter(None, "m", above=0.0)
    pose: PoseValues = (0.0,) * 6
    motion: Motion = Motion()
    occluder: tuple[Vector2, Vector2] | None = None
    occluded: tuple[Vector2, ...] | None = None
    perturbed: bool = False
    box: BoxSpec | None = None
    model: str = ""
    link: str = ""
    scale: float | None = parameter(None, above=0.0)
    marker: str | Mapping[str, Any] = parameter("", name=True)

    @property
    def placed_target(self) -> PlacedTarget:
        """The target in the world; ExperimentError where its shape cannot be read."""
        shape = make_target(self.shape, self.size, self.scale, self.shape_marker)
        course = PoseHistory() if self.model else None
        pose = matrix_from_xyz_rpy(self.pose[:3], self.pose[3:])
        return PlacedTarget(shape, pose, self.motion, course)

    @property
    def shape_marker(self) -> str:
        """The marker that the target is drawn with; '': it is not drawn by one."""
        return self.marker if "marker" in list_parameters(self.shape) else ""

    @property
    def is_plain(self) -> bool:
        """Whether it is nothing but a shape, its place and its motion."""
        lies = self.box is not None or self.occluder is not None
        return not (lies or self.perturbed or self.is_link)

    @property
    def is_link(self) -> bool:
        """Whether it is a link of the world's or of the robot's, which brings shape and place."""
        return bool(self.model or self.link)

    @property
    def is_provided(self) -> bool:
        """Whether it is there without being put into the simulated world."""
        return self.is_in_description or self.is_link

    @property
    def is_mountable(self) -> bool:
        """Whether a link can carry it: it moves with that alone."""
        return self.is_plain and self.motion.is_static

    @property
    def is_in_description(self) -> bool:
        """Whether it is part of the simulated robot's description: corners in the world's own
        frame, which a robot of one's own brings with it."""
        return isinstance(self.shape, tuple) and not any(self.pose)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "target")
        named = find_shape(self.shape) is not None
        draws_marker = "marker" in list_parameters(self.shape)
        if not (isinstance(self.shape, tuple) or named or Path(self.shape).suffix):
            raise ExperimentError(
                f"target.shape is '{self.shape}', must be a list of corners, the path of a "
                "picture, an SVG or a mesh, 'package.module:Class', or a name: "
                f"{suggest(self.shape, SHAPES)}"
            )
        if self.marker != "":
            self._check_marker(draws_marker, named)
        require(self.occluded is None or self.occluder is not None,
                "target.occluded says when an occluder lies there: give target.occluder")
        check_times(self.occluded, "target.occluded")
        require(
            not is_solid(self.shape) or self.box is None and self.occluder is None
            and not self.perturbed,
            "target.box, occluder and perturbed are for flat targets, and this is a solid of its "
            "own: leave them out",
        )
        require(
            not self.is_link
            or (self.shape == "aras" or is_solid(self.shape))
            and self.motion.is_static
            and self.box is None
            and self.occluder is None,
            "a link that is the target brings its shape, and moves as the simulation has it: leave "
            "out target.shape, motion, box and occluder",
        )
        given = self.shape == "aras" or self.is_in_description
        require(
            self.box is None or not given and self.motion == Motion(),
            "target.box is for a target of its own that does not move by itself: give it another "
            "shape, a pose, and no motion",
        )

    def _check_marker(self, draws_marker: bool, named: bool) -> None:
        """ExperimentError for a marker that there is not, or of a target that shows none."""
        from aras_visual_servo_camera.markers import MarkerChoice

        try:
            choice = MarkerChoice.read(self.marker, "target.marker")
        except VisionError as error:
            raise ExperimentError(str(error)) from None
        require(
            not draws_marker or choice.board is None,
            f"target.marker of the shape '{self.shape}' is one that is drawn: a board is for an "
            "image of it, as a PNG",
        )
        require(
            not self.marker or not is_solid(self.shape) and not self.is_link
            and (draws_marker or not named) and isinstance(self.shape, str),
            f"target.marker is for a target that shows markers, as an image, and {self.shape} has "
            "none: leave it out",
        )
