"""3-D drawing of a run in progress: camera, goal, paths, twists, features and text.

A RunDrawing receives the values of ROS messages, and returns shapes in the frame of the arm's base.
It records the camera's path and the trajectories of the features from the start of servoing, and
draws the straight path from this start to the goal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.records.state import (
    CONVERGED,
    SERVOING,
    RunStartDetector,
    ServoState,
)

from ..plots.palette import LIVE, to_rgb
from ..recording.image_tracks import number_points
from .drawing_shapes import (
    ARROW,
    LINES,
    STRIP,
    TEXT,
    DrawingShape,
    Rgba,
    compute_image_border,
    make_axes,
    make_frustum,
    place_on_image_plane,
    transform_points,
)
from .feature_units import find_feature_units
from .point_trajectory import PointTrajectory

GOAL, NOW, PATH, IDEAL, FEATURE = (
    to_rgb(LIVE[name]) for name in ("goal", "now", "path", "ideal", "feature")
)

FRUSTUM_SIZE = 0.16  # distance from the optical centre to the farthest corner of the drawn image, m
AXIS_LENGTH = 0.05  # length of the axes of a drawn frame, m
# The length of a linear velocity's arrow is the speed, m/s, multiplied by this time, s.
ARROW_SECONDS = 2.0
# The length of an angular velocity's arrow, m, is the angular speed, rad/s, multiplied by this
# factor, m s/rad.
TURN_LENGTH = 0.1
MAX_ARROW = 0.3  # largest length of an arrow, m
MIN_ARROW = 2e-3  # smallest length of an arrow that is drawn, m
IDEAL_PATH_POINTS = 24
MIN_SPACING = 5e-4  # smallest distance between two points of the camera's path, m
# Smallest distance between two points of a feature's trajectory, normalised coordinates.
MIN_IMAGE_SPACING = 2e-3
# Offset of the text from the camera in the base frame, m. In the rviz view of the project, the text
# is then left of the arm; on the right, it would cover the robot.
TEXT_OFFSET = (0.24, -0.2, 0.19)
MAX_ERRORS = 6  # largest number of feature errors that the text lists
LETTER_HEIGHT, LINE_HEIGHT = 0.023, 0.028  # height of letters and distance between lines of text, m
LEGEND = (  # text and colour of each line of the legend, from bottom to top
    ("achieved rotation", to_rgb(LIVE["achieved-turn"])),
    ("desired rotation", to_rgb(LIVE["desired-turn"])),
    ("achieved velocity", to_rgb(LIVE["achieved"])), ("desired velocity", to_rgb(LIVE["desired"])),
    ("target in the image", FEATURE), ("straight path to the goal", IDEAL), ("path", PATH),
    ("goal", GOAL), ("camera", NOW),
)  # fmt: skip


NO_STATE = ServoState(0.0, "")  # placeholder until the controller reports its first state


class RunDrawing:
    """Drawing of the run of one robot.

    Attributes:
        arm: kinematics of the robot.
        camera: calibration of the camera; None until it is known.
        goal: (4, 4) base_T_camera at the goal; None until it is known.
        outline: (n, 2) desired outline of the target, in normalised image coordinates; empty until
            it is known.
        state: latest state of the controller.
        factor: real-time factor of the simulation; None until it is known.
        target: shapes that draw the target in the frame of the arm's base; empty if the target is
            unknown.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.camera: CameraModel | None = None
        self.goal: np.ndarray | None = None
        self.outline = np.empty((0, 2))
        self.state = NO_STATE
        self.factor: float | None = None
        self.target: tuple[DrawingShape, ...] = ()
        self._pose: np.ndarray | None = None
        self._image_border: tuple[CameraModel, np.ndarray] | None = None
        self.clear()

    def clear(self) -> None:
        """Delete the data of the run but not the robot, for example after a reset of the clock."""
        self.state = NO_STATE
        self._run_starts = RunStartDetector()
        self.start_pose: np.ndarray | None = None
        self._path = PointTrajectory(3, MIN_SPACING)
        self._trajectories: dict[str, PointTrajectory] = {}

    @property
    def pose(self) -> np.ndarray | None:
        """Current pose base_T_camera (4, 4); None before the first joint state."""
        return self._pose

    @property
    def path(self) -> np.ndarray:
        """Positions (n, 3) of the camera since servoing started, m."""
        return self._path.points

    def set_joints(self, positions: Sequence[float]) -> None:
        """Set the joint positions (n,), in the order of the arm's joints."""
        self._pose = self.arm.pose(np.asarray(positions, float))

    def add_state(self, state: ServoState, positions: Sequence[float] = ()) -> None:
        """Add a state of the controller.

        positions: (n,) joint positions at the time of this state; empty if they are unknown.
        """
        self.state = state
        if self._run_starts.is_start(state.phase):
            self.start_pose, self._trajectories = None, {}
            self._path.clear()
        if state.phase not in (SERVOING, CONVERGED):
            return
        if len(positions) == len(self.arm.names):
            pose = self.arm.pose(np.asarray(positions, float))
            if self.start_pose is None:
                self.start_pose = np.array(pose)
            self._path.add(pose[:3, 3])
        features = () if state.scheme_output is None else state.scheme_output.features
        for number, (x, y) in number_points(state.names).items():
            self.add_image_point(f"point {number}", features[x], features[y])

    def add_image_point(self, name: str, x: float, y: float) -> None:
        """Add a point (x, y), in normalised image coordinates, to the trajectory `name`."""
        if self.state.phase not in (SERVOING, CONVERGED):
            return
        if name not in self._trajectories:
            self._trajectories[name] = PointTrajectory(2, MIN_IMAGE_SPACING)
        self._trajectories[name].add(np.array([x, y]))

    def compute_ideal_path(self) -> np.ndarray:
        """Return points (n, 3) of the straight path from the start of servoing to the goal, m."""
        if self.start_pose is None or self.goal is None:
            return np.empty((0, 3))
        along = np.linspace(0.0, 1.0, IDEAL_PATH_POINTS)[:, None]
        start, end = self.start_pose[:3, 3], self.goal[:3, 3]
        return start + along * (end - start)

    def compute_target_depth(self) -> float | None:
        """Return the mean depth, m, of the target's corners, for a camera at the goal pose.

        Return None if the goal or the target is unknown, or the target is behind the camera.
        """
        points = [shape.points for shape in self.target if len(shape.points)]
        if self.goal is None or not points:
            return None
        middle = np.concatenate(points).mean(axis=0)
        depth = float((middle - self.goal[:3, 3]) @ self.goal[:3, 2])
        return depth if depth > 0.0 else None

    def make_text_lines(self) -> list[str]:
        """Return the lines of the text next to the camera."""
        state = self.state
        if not state.phase:
            return ["no controller yet"]
        lines = [" - ".join(w for w in (state.scheme.rpartition(":")[2], state.phase) if w)]
        if state.outcome not in ("", "running", state.phase):
            lines.append(state.outcome.replace("_", " "))
        if state.reason:
            lines.append(_wrap_text(state.reason))
        if state.names:
            units = find_feature_units(state.scheme, len(state.names)) or ("",) * len(state.names)
            rows = zip(state.names[:MAX_ERRORS], state.error[:MAX_ERRORS], units, strict=False)
            lines += [f"{name} {error:+z.4f} {unit}".rstrip() for name, error, unit in rows]
            if len(state.names) > MAX_ERRORS:
                lines.append(f"and {len(state.names) - MAX_ERRORS} more")
        if self.factor is not None:
            lines.append(f"real-time factor {self.factor:.2f}")
        return lines

    def make_shapes(self) -> list[DrawingShape]:
        """Return all shapes of the drawing, in the frame of the arm's base.

        If a shape is not visible now, such as the arrow of a camera at rest, it has no points.
        """
        shapes = [*self.target, self._make_line("path", self.path, (*PATH, 1.0), 0.006)]
        ideal = self.compute_ideal_path()
        shapes.append(DrawingShape("ideal path", LINES, ideal, (*IDEAL, 0.9), 0.003))
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

    def _make_texts(self) -> list[DrawingShape]:
        """Return the text next to the camera, and above it the legend of the colours."""
        words, place = "\n".join(self.make_text_lines()), (self._pose[:3, 3] + TEXT_OFFSET)[None]
        shapes = [DrawingShape("words", TEXT, place, (1.0, 1.0, 1.0, 1.0), LETTER_HEIGHT, words)]
        # A text is centred on its position, so half of the text's lines are above this position.
        above = 0.5 * (words.count("\n") + 1)
        for line, (text, colour) in enumerate(LEGEND, 1):
            up = (0.0, 0.0, LINE_HEIGHT * (above + line))
            shapes.append(DrawingShape(f"legend {text}", TEXT, place + up, (*colour, 1.0),
                                       LETTER_HEIGHT, text))  # fmt: skip
        return shapes

    def _find_image_border(self) -> np.ndarray | None:
        if self.camera is None:
            return None
        if self._image_border is None or self._image_border[0] != self.camera:
            self._image_border = self.camera, compute_image_border(self.camera)
        return self._image_border[1]

    def _make_image_shapes(self, border: np.ndarray) -> list[DrawingShape]:
        """Return the features' trajectories and the desired outline, drawn on the image plane.

        border: (n, 2) border of the image, from `compute_image_border`.
        """
        shapes = []
        outline = self.outline
        if len(outline):
            closed = place_on_image_plane(border, np.vstack([outline, outline[:1]]), FRUSTUM_SIZE)
            points = transform_points(self._pose, closed)
            shapes.append(self._make_line("desired outline", points, (*GOAL, 1.0), 0.002))
        for name, track in self._trajectories.items():
            points = transform_points(
                self._pose, place_on_image_plane(border, track.points, FRUSTUM_SIZE)
            )
            shapes.append(self._make_line(f"trajectory {name}", points, (*FEATURE, 1.0), 0.002))
        return shapes

    def _make_arrows(self) -> list[DrawingShape]:
        state, shapes = self.state, []
        for kind, twist, width, opacity in (
            ("desired", state.desired_twist, 0.008, 1.0),
            ("achieved", state.achieved_twist, 0.012, 0.55),
        ):
            for quantity, vector, name in (
                ("velocity", np.array(twist[:3]) * ARROW_SECONDS, kind),
                ("turn", np.array(twist[3:]) * TURN_LENGTH, f"{kind}-turn"),
            ):
                points, length = np.empty((0, 3)), float(np.linalg.norm(vector))
                if np.isfinite(length) and length > MIN_ARROW:
                    tip = vector * min(1.0, MAX_ARROW / length)
                    points = transform_points(self._pose, np.array([np.zeros(3), tip]))
                colour = (*to_rgb(LIVE[name]), opacity)
                shapes.append(DrawingShape(f"{kind} {quantity}", ARROW, points, colour, width))
        return shapes

    @staticmethod
    def _make_line(name: str, points: np.ndarray, colour: Rgba, width: float) -> DrawingShape:
        """Return a curve through points (n, 3); the curve is empty if there is only one point."""
        return DrawingShape(name, STRIP, points if len(points) > 1 else points[:0], colour, width)


def _wrap_text(text: str, width: int = 44) -> str:
    """Return the first three lines of a text that is wrapped at `width` characters."""
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    return "\n".join(lines[:3])
