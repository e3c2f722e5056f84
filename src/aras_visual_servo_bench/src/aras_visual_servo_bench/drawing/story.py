"""A run as it goes on, drawn: camera, goal, paths, twists, features, words.

Told what the graph says, it answers shapes in the arm's base. A run begins where servoing begins:
the camera's path and the features' trajectories from there on, and the straight path to the goal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.records.state import (
    APPROACHING,
    CONVERGED,
    SERVOING,
    STOPPED,
    WAITING,
    ServoState,
)

from ..pictures.palette import LIVE, rgb
from ..recording.tracks import numbered
from .shapes import (
    ARROW,
    LINES,
    STRIP,
    TEXT,
    Rgba,
    Shape,
    axes,
    carried,
    frustum,
    on_picture,
    picture_border,
)
from .track import Track
from .units import feature_units

GOAL, NOW, PATH, IDEAL, FEATURE = (
    rgb(LIVE[name]) for name in ("goal", "now", "path", "ideal", "feature")
)

FRUSTUM = 0.16  # m, from the optical centre to a corner of the drawn picture
FRAME = 0.05  # m, an axis of a drawn frame
SECONDS = 2.0  # an arrow is as long as the path of so many seconds, m
TURN_LENGTH = 0.1  # m for a radian
LONGEST = 0.3  # m, of an arrow
SHORTEST = 2e-3  # m; what is no longer is not drawn
STEPS = 24  # points of the ideal path
NEAR = 5e-4  # m between two points of the path
NEAR_IN_PICTURE = 2e-3  # likewise of trajectories, normalised
BESIDE = (-0.29, 0.24, 0.19)  # m from the camera to the words, in the base: beside the arm
MOST = 6  # errors that are read out
LETTERS, LINE = 0.023, 0.028  # m, height of letters, and from one line to the next
LEGEND = (  # from its lowest line up
    ("turn achieved", rgb(LIVE["achieved-turn"])), ("turn asked", rgb(LIVE["asked-turn"])),
    ("velocity achieved", rgb(LIVE["achieved"])), ("velocity asked", rgb(LIVE["asked"])),
    ("target in the picture", FEATURE), ("straight to the goal", IDEAL), ("path", PATH),
    ("goal", GOAL), ("camera", NOW),
)  # fmt: skip


NOTHING = ServoState(0.0, "")  # before the controller has said anything


class Story:
    """One robot's run.

    Attributes:
        arm: its kinematics.
        camera: what it looks through; None before it is known.
        goal: (4, 4) base_T_camera; None before it is known.
        outline: (n, 2) of the target at the goal, normalised.
        told: the latest of what the controller said.
        factor: real-time factor, None while it is not known.
        target: its shapes in the arm's base; none where nothing is known of it.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.camera: CameraModel | None = None
        self.goal: np.ndarray | None = None
        self.outline = np.empty((0, 2))
        self.told = NOTHING
        self.factor: float | None = None
        self.target: tuple[Shape, ...] = ()
        self._pose: np.ndarray | None = None
        self._border: tuple[CameraModel, np.ndarray] | None = None
        self.clear()

    def clear(self) -> None:
        """Forget the run, not the robot: for a clock that went back."""
        self.told = NOTHING
        self.began: np.ndarray | None = None
        self._path = Track(3, NEAR)
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

    def joints(self, positions: Sequence[float]) -> None:
        """Where the joints are (n,), in the arm's order."""
        self._pose = self.arm.pose(np.asarray(positions, float))

    def say(self, told: ServoState, positions: Sequence[float] = ()) -> None:
        """A state of the controller, with the joints (n,) that it saw, where it saw some."""
        before, self.told = self.told, told
        moving = told.phase in (SERVOING, CONVERGED)
        if not moving:
            return
        if before.phase in ("", APPROACHING, WAITING, STOPPED):
            self.began, self._trajectories = None, {}
            self._path.clear()
        if len(positions) == len(self.arm.names):
            pose = self.arm.pose(np.asarray(positions, float))
            if self.began is None:
                self.began = np.array(pose)
            self._path.add(pose[:3, 3])
        features = () if told.decision is None else told.decision.features
        for number, (x, y) in numbered(told.names).items():
            self.see(f"point {number}", features[x], features[y])

    def see(self, name: str, x: float, y: float) -> None:
        """Where something of the target is in the picture, normalised."""
        if self.told.phase not in (SERVOING, CONVERGED):
            return
        if name not in self._trajectories:
            self._trajectories[name] = Track(2, NEAR_IN_PICTURE)
        self._trajectories[name].add(np.array([x, y]))

    # -- what it answers -------------------------------------------------------------------

    def ideal(self) -> np.ndarray:
        """Places (n, 3) of the straight path from where servoing began to the goal."""
        if self.began is None or self.goal is None:
            return np.empty((0, 3))
        along = np.linspace(0.0, 1.0, STEPS)[:, None]
        start, end = self.began[:3, 3], self.goal[:3, 3]
        return start + along * (end - start)

    def words(self) -> list[str]:
        """What is to be read beside it."""
        told = self.told
        if not told.phase:
            return ["no controller yet"]
        lines = [" - ".join(w for w in (told.scheme.rpartition(":")[2], told.phase) if w)]
        if told.outcome not in ("", "running", told.phase):
            lines.append(told.outcome.replace("_", " "))
        if told.reason:
            lines.append(_folded(told.reason))
        if told.names:
            units = feature_units(told.scheme, len(told.names)) or ("",) * len(told.names)
            rows = zip(told.names[:MOST], told.error[:MOST], units, strict=False)
            lines += [f"{name} {error:+z.4f} {unit}".rstrip() for name, error, unit in rows]
            if len(told.names) > MOST:
                lines.append(f"and {len(told.names) - MOST} more")
        if self.factor is not None:
            lines.append(f"real-time factor {self.factor:.2f}")
        return lines

    def shapes(self) -> list[Shape]:
        """Everything, in the arm's base; what cannot be drawn now has no points."""
        shapes = [*self.target, self._line("path", self.path, (*PATH, 1.0), 0.006)]
        ideal = self.ideal()
        shapes.append(Shape("ideal path", LINES, ideal, (*IDEAL, 0.9), 0.003))
        border = self._picture()
        if self.goal is not None:
            shapes += axes("desired", self.goal, 1.4 * FRAME, 0.9)
            if border is not None:
                shapes += frustum("desired camera", self.goal, border, FRUSTUM, (*GOAL, 0.9))
        if self._pose is None:
            return shapes
        shapes += axes("camera", self._pose, FRAME)
        if border is not None:
            shapes += frustum("camera", self._pose, border, FRUSTUM, (*NOW, 0.9))
            shapes += self._seen(border)
        shapes += self._arrows()
        return shapes + self._texts()

    def _texts(self) -> list[Shape]:
        """The words, and above them what is drawn in which colour, beside the camera."""
        words, place = "\n".join(self.words()), (self._pose[:3, 3] + BESIDE)[None]
        shapes = [Shape("words", TEXT, place, (1.0, 1.0, 1.0, 1.0), LETTERS, words)]
        above = 0.5 * (words.count("\n") + 1)  # lines: the words stand about their place
        for line, (text, colour) in enumerate(LEGEND, 1):
            up = (0.0, 0.0, LINE * (above + line))
            shapes.append(Shape(f"legend {text}", TEXT, place + up, (*colour, 1.0), LETTERS, text))
        return shapes

    def _picture(self) -> np.ndarray | None:
        if self.camera is None:
            return None
        if self._border is None or self._border[0] != self.camera:
            self._border = self.camera, picture_border(self.camera)
        return self._border[1]

    def _seen(self, border: np.ndarray) -> list[Shape]:
        """Trajectories of what is seen, and the desired outline, on the drawn picture."""
        shapes = []
        outline = self.outline
        if len(outline):
            closed = on_picture(border, np.vstack([outline, outline[:1]]), FRUSTUM)
            shapes.append(self._line("desired outline", carried(self._pose, closed), (*GOAL, 1.0),
                                     0.002))  # fmt: skip
        for name, track in self._trajectories.items():
            points = carried(self._pose, on_picture(border, track.points, FRUSTUM))
            shapes.append(self._line(f"trajectory {name}", points, (*FEATURE, 1.0), 0.002))
        return shapes

    def _arrows(self) -> list[Shape]:
        told, shapes = self.told, []
        for what, twist in (("asked", told.twist), ("achieved", told.achieved)):
            width = 0.008 if what == "asked" else 0.012
            ways = np.array(twist[:3]) * SECONDS, np.array(twist[3:]) * TURN_LENGTH
            for part, way, name in (("velocity", ways[0], what), ("turn", ways[1], f"{what}-turn")):
                points, length = np.empty((0, 3)), float(np.linalg.norm(way))
                if np.isfinite(length) and length > SHORTEST:
                    tip = way * min(1.0, LONGEST / length)
                    points = carried(self._pose, np.array([np.zeros(3), tip]))
                opacity = 1.0 if what == "asked" else 0.55
                shapes.append(Shape(f"{what} {part}", ARROW, points, (*rgb(LIVE[name]), opacity),
                                    width))  # fmt: skip
        return shapes

    @staticmethod
    def _line(name: str, points: np.ndarray, colour: Rgba, width: float) -> Shape:
        """A curve; one point alone is none."""
        return Shape(name, STRIP, points if len(points) > 1 else points[:0], colour, width)


def _folded(text: str, width: int = 44) -> str:
    """Long words in lines of a width."""
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    return "\n".join(lines[:3])
