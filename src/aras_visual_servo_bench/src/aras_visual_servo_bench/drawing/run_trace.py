"""A run as it goes on, drawn: camera, goal, paths, twists, features, words.

Told what the graph says, it answers shapes in the arm's base. A run begins where servoing begins:
the camera's path and the features' trajectories from there on, and the straight path to the goal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.records.state import (
    APPROACHING,
    CONVERGED,
    SERVOING,
    STOPPED,
    WAITING,
    ServoState,
)

from ..plots.palette import LIVE, to_rgb
from ..recording.image_tracks import number_points
from .feature_units import find_feature_units
from .shapes import (
    ARROW,
    LINES,
    STRIP,
    TEXT,
    Rgba,
    Shape,
    compute_image_border,
    make_axes,
    make_frustum,
    place_on_image_plane,
    transform_points,
)
from .track import Track

GOAL, NOW, PATH, IDEAL, FEATURE = (
    to_rgb(LIVE[name]) for name in ("goal", "now", "path", "ideal", "feature")
)

FRUSTUM_SIZE = 0.16  # m, from the optical centre to a corner of the drawn picture
AXIS_LENGTH = 0.05  # m, an axis of a drawn frame
ARROW_SECONDS = 2.0  # an arrow is as long as the path of so many seconds, m
TURN_LENGTH = 0.1  # m for a radian
MAX_ARROW = 0.3  # m, of an arrow
MIN_ARROW = 2e-3  # m; what is no longer is not drawn
IDEAL_PATH_POINTS = 24  # points of the ideal path
MIN_SPACING = 5e-4  # m between two points of the path
MIN_IMAGE_SPACING = 2e-3  # likewise of trajectories, normalised
TEXT_OFFSET = (-0.29, 0.24, 0.19)  # m from the camera to the words, in the base: beside the arm
MAX_ERRORS = 6  # errors that are read out
LETTER_HEIGHT, LINE_HEIGHT = 0.023, 0.028  # m, height of letters, and from one line to the next
LEGEND = (  # from its lowest line up
    ("achieved rotation", to_rgb(LIVE["achieved-turn"])),
    ("desired rotation", to_rgb(LIVE["desired-turn"])),
    ("achieved velocity", to_rgb(LIVE["achieved"])), ("desired velocity", to_rgb(LIVE["desired"])),
    ("target in the picture", FEATURE), ("straight to the goal", IDEAL), ("path", PATH),
    ("goal", GOAL), ("camera", NOW),
)  # fmt: skip


NO_STATE = ServoState(0.0, "")  # before the controller has said anything


class RunTrace:
    """One robot's run.

    Attributes:
        arm: its kinematics.
        camera: what it looks through; None before it is known.
        goal: (4, 4) base_T_camera; None before it is known.
        outline: (n, 2) of the target at the goal, normalised.
        state: the latest of what the controller said.
        factor: real-time factor, None while it is not known.
        target: its shapes in the arm's base; none where nothing is known of it.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.camera: CameraModel | None = None
        self.goal: np.ndarray | None = None
        self.outline = np.empty((0, 2))
        self.state = NO_STATE
        self.factor: float | None = None
        self.target: tuple[Shape, ...] = ()
        self._pose: np.ndarray | None = None
        self._image_border: tuple[CameraModel, np.ndarray] | None = None
        self.clear()

    def clear(self) -> None:
        """Forget the run, not the robot: for a clock that went back."""
        self.state = NO_STATE
        self.start_pose: np.ndarray | None = None
        self._path = Track(3, MIN_SPACING)
        self._trajectories: dict[str, Track] = {}

    @property
    def pose(self) -> np.ndarray | None:
        """(4, 4) base_T_camera, None before joints were heard."""
        return self._pose

    @property
    def path(self) -> np.ndarray:
        """(n, 3) the camera's places since servoing began, m."""
        return self._path.points

    # -- what it is told -------------------------------------------------------------------

    def set_joints(self, positions: Sequence[float]) -> None:
        """Where the joints are (n,), in the arm's order."""
        self._pose = self.arm.pose(np.asarray(positions, float))

    def add_state(self, state: ServoState, positions: Sequence[float] = ()) -> None:
        """A state of the controller, with the joints (n,) that it saw, where it saw some."""
        before, self.state = self.state, state
        moving = state.phase in (SERVOING, CONVERGED)
        if not moving:
            return
        if before.phase in ("", APPROACHING, WAITING, STOPPED):
            self.start_pose, self._trajectories = None, {}
            self._path.clear()
        if len(positions) == len(self.arm.names):
            pose = self.arm.pose(np.asarray(positions, float))
            if self.start_pose is None:
                self.start_pose = np.array(pose)
            self._path.add(pose[:3, 3])
        features = () if state.scheme_output is None else state.scheme_output.features
        for number, (x, y) in number_points(state.names).items():
            self.add_image_point(f"point {number}", features[x], features[y])

    def add_image_point(self, name: str, x: float, y: float) -> None:
        """Where something of the target is in the picture, normalised."""
        if self.state.phase not in (SERVOING, CONVERGED):
            return
        if name not in self._trajectories:
            self._trajectories[name] = Track(2, MIN_IMAGE_SPACING)
        self._trajectories[name].add(np.array([x, y]))

    # -- what it answers -------------------------------------------------------------------

    def compute_ideal_path(self) -> np.ndarray:
        """Places (n, 3) of the straight path from where servoing began to the goal."""
        if self.start_pose is None or self.goal is None:
            return np.empty((0, 3))
        along = np.linspace(0.0, 1.0, IDEAL_PATH_POINTS)[:, None]
        start, end = self.start_pose[:3, 3], self.goal[:3, 3]
        return start + along * (end - start)

    def make_text_lines(self) -> list[str]:
        """What is to be read beside it."""
        told = self.state
        if not told.phase:
            return ["no controller yet"]
        lines = [" - ".join(w for w in (told.scheme.rpartition(":")[2], told.phase) if w)]
        if told.outcome not in ("", "running", told.phase):
            lines.append(told.outcome.replace("_", " "))
        if told.reason:
            lines.append(_wrap_text(told.reason))
        if told.names:
            units = find_feature_units(told.scheme, len(told.names)) or ("",) * len(told.names)
            rows = zip(told.names[:MAX_ERRORS], told.error[:MAX_ERRORS], units, strict=False)
            lines += [f"{name} {error:+z.4f} {unit}".rstrip() for name, error, unit in rows]
            if len(told.names) > MAX_ERRORS:
                lines.append(f"and {len(told.names) - MAX_ERRORS} more")
        if self.factor is not None:
            lines.append(f"real-time factor {self.factor:.2f}")
        return lines

    def make_shapes(self) -> list[Shape]:
        """Everything, in the arm's base; what cannot be drawn now has no points."""
        shapes = [*self.target, self._make_line("path", self.path, (*PATH, 1.0), 0.006)]
        ideal = self.compute_ideal_path()
        shapes.append(Shape("ideal path", LINES, ideal, (*IDEAL, 0.9), 0.003))
        border = self._find_image_border()
        if self.goal is not None:
            shapes += make_axes("desired", self.goal, 1.4 * AXIS_LENGTH, 0.9)
            if border is not None:
                shapes += make_frustum(
                    "desired camera", self.goal, border, FRUSTUM_SIZE, (*GOAL, 0.9)
                )
        if self._pose is None:
            return shapes
        shapes += make_axes("camera", self._pose, AXIS_LENGTH)
        if border is not None:
            shapes += make_frustum("camera", self._pose, border, FRUSTUM_SIZE, (*NOW, 0.9))
            shapes += self._make_image_shapes(border)
        shapes += self._make_arrows()
        return shapes + self._make_texts()

    def _make_texts(self) -> list[Shape]:
        """The words, and above them what is drawn in which colour, beside the camera."""
        words, place = "\n".join(self.make_text_lines()), (self._pose[:3, 3] + TEXT_OFFSET)[None]
        shapes = [Shape("words", TEXT, place, (1.0, 1.0, 1.0, 1.0), LETTER_HEIGHT, words)]
        above = 0.5 * (words.count("\n") + 1)  # lines: the words stand about their place
        for line, (text, colour) in enumerate(LEGEND, 1):
            up = (0.0, 0.0, LINE_HEIGHT * (above + line))
            shapes.append(
                Shape(f"legend {text}", TEXT, place + up, (*colour, 1.0), LETTER_HEIGHT, text)
            )
        return shapes

    def _find_image_border(self) -> np.ndarray | None:
        if self.camera is None:
            return None
        if self._image_border is None or self._image_border[0] != self.camera:
            self._image_border = self.camera, compute_image_border(self.camera)
        return self._image_border[1]

    def _make_image_shapes(self, border: np.ndarray) -> list[Shape]:
        """Trajectories of what is seen, and the desired outline, on the drawn picture."""
        shapes = []
        outline = self.outline
        if len(outline):
            closed = place_on_image_plane(border, np.vstack([outline, outline[:1]]), FRUSTUM_SIZE)
            shapes.append(self._make_line("desired outline", transform_points(self._pose, closed),
                (*GOAL, 1.0),
                                     0.002))  # fmt: skip
        for name, track in self._trajectories.items():
            points = transform_points(
                self._pose, place_on_image_plane(border, track.points, FRUSTUM_SIZE)
            )
            shapes.append(self._make_line(f"trajectory {name}", points, (*FEATURE, 1.0), 0.002))
        return shapes

    def _make_arrows(self) -> list[Shape]:
        told, shapes = self.state, []
        for what, twist in (("desired", told.desired_twist), ("achieved", told.achieved_twist)):
            width = 0.008 if what == "desired" else 0.012
            ways = np.array(twist[:3]) * ARROW_SECONDS, np.array(twist[3:]) * TURN_LENGTH
            for part, way, name in (("velocity", ways[0], what), ("turn", ways[1], f"{what}-turn")):
                points, length = np.empty((0, 3)), float(np.linalg.norm(way))
                if np.isfinite(length) and length > MIN_ARROW:
                    tip = way * min(1.0, MAX_ARROW / length)
                    points = transform_points(self._pose, np.array([np.zeros(3), tip]))
                opacity = 1.0 if what == "desired" else 0.55
                shapes.append(Shape(f"{what} {part}", ARROW, points, (*to_rgb(LIVE[name]), opacity),
                                    width))  # fmt: skip
        return shapes

    @staticmethod
    def _make_line(name: str, points: np.ndarray, colour: Rgba, width: float) -> Shape:
        """A curve; one point alone is none."""
        return Shape(name, STRIP, points if len(points) > 1 else points[:0], colour, width)


def _wrap_text(text: str, width: int = 44) -> str:
    """Long words in lines of a width."""
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    return "\n".join(lines[:3])
