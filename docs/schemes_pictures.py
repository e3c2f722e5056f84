"""Pictures of the page on schemes: image trajectories and maps of successful starts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from aras_visual_servo_base.poses import inverse
from aras_visual_servo_bench.plots.palette import BLUE, INK, VERMILION
from aras_visual_servo_bench.plots.style import apply_style, make_axes
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.targets.target_factory import make_target

COLUMNS, WIDTH, HEIGHT = 4, 3.0, 2.8  # panels per row, and their size in inches
LETTERS = 38  # width of a title


@contextmanager
def _page(count: int, path: Path) -> Iterator[list[Axes]]:
    """Yield `count` axes, and save their figure at the end of the block."""
    with apply_style():
        figure, axes = make_axes(count, HEIGHT, min(count, COLUMNS), width=WIDTH)
        yield axes
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=100)
        plt.close(figure)


def _title(axis: Axes, *lines: str) -> None:
    """Set a title of several lines, wrapped at the width of the panel."""
    axis.set_title("\n".join(fill(line, LETTERS) for line in lines), fontsize=8)


def draw_trajectories(study: Study, start: str, path: Path) -> None:
    """Draw the image trajectories of the target's corners from one start, one panel per scheme."""
    condition = next(iter(study.case_axes.get("condition", ())), None)
    points = [
        point for point in range(study.point_count)
        if (names := study.find_combination(point).names)["start"] == start
        and (condition is None or names["condition"] == condition.name)
    ]  # fmt: skip
    with _page(len(points), path) as axes:
        for axis, point in zip(axes, points, strict=True):
            experiment = study.make_experiment(point * study.repeats)
            result = run(experiment)
            corners = make_target(experiment.target.shape, experiment.target.size).vertices()
            trajectory = np.array([_project(corners, pose) for pose in result.pose])
            goal = _project(corners, result.goal_pose)
            axis.plot(trajectory[:, :, 0], trajectory[:, :, 1], linewidth=1.0)
            axis.plot(trajectory[0, :, 0], trajectory[0, :, 1], "o", color="white", mec=INK, ms=3.5)
            axis.plot(goal[:, 0], goal[:, 1], "x", color=INK, ms=5.0)
            axis.plot(trajectory[-1, :, 0], trajectory[-1, :, 1], "o", color=INK, ms=3.0)
            _title(axis, study.find_combination(point).names["scheme"], result.outcome)
            axis.set_xlim(-0.4, 0.4)
            axis.set_ylim(0.3, -0.3)
            axis.set_aspect("equal")


def _project(corners: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Project corners (n, 3) to normalised coordinates (n, 2); NaN behind the camera.

    pose: world_T_camera (4, 4).
    """
    camera_T_world = inverse(pose)
    points = corners @ camera_T_world[:3, :3].T + camera_T_world[:3, 3]
    return np.where(points[:, 2:] > 0.0, points[:, :2] / points[:, 2:], np.nan)


def draw_success_map(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw starts by distance and angle from the goal, one panel per scheme and condition."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row.get("start_distance") not in ("", "nan", None):
            groups.setdefault((row["scheme"], row["condition"]), []).append(row)
    with _page(len(groups), path) as axes:
        for axis, ((case, condition), found) in zip(axes, groups.items(), strict=True):
            for is_hit, colour, marker in ((True, BLUE, "o"), (False, VERMILION, "x")):
                some = [row for row in found if row["hit"] is is_hit]
                axis.scatter(
                    [float(row["start_distance"]) for row in some],
                    [math.degrees(float(row["start_angle"])) for row in some],
                    s=12, c=colour, marker=marker, linewidths=1.0,
                )  # fmt: skip
            hits = sum(row["hit"] for row in found)
            _title(axis, case, f"{condition}: {hits} of {len(found)}")
            axis.set_xlim(0.0, 0.9)
            axis.set_ylim(0.0, None)
            axis.set_xlabel("distance (m)", fontsize=8)
            axis.set_ylabel("angle (degrees)", fontsize=8)
