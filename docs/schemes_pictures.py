"""Figures of the page of schemes: paths in the image, and starts from which schemes converge."""

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

COLUMNS, WIDTH, HEIGHT = 4, 3.0, 2.8  # panels in a row; width and height of a panel, inches
LINE_LENGTH = 38  # characters of a title per line


@contextmanager
def _figure(count: int, path: Path) -> Iterator[list[Axes]]:
    """Provide `count` axes, and write the figure to `path` at the end of the block."""
    with apply_style():
        figure, axes = make_axes(count, HEIGHT, min(count, COLUMNS), width=WIDTH)
        yield axes
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=100)
        plt.close(figure)


def _set_title(axis: Axes, *lines: str) -> None:
    """Set the title of an axis, with lines wrapped to its width."""
    axis.set_title("\n".join(fill(line, LINE_LENGTH) for line in lines), fontsize=8)


def draw_paths(study: Study, start: str, path: Path) -> None:
    """Draw the paths of the target's corners in the image from one start, a panel per scheme."""
    condition = next(iter(study.case_axes.get("condition", ())), None)
    points = [
        point for point in range(study.point_count)
        if (names := study.find_combination(point).names)["start"] == start
        and (condition is None or names["condition"] == condition.name)
    ]  # fmt: skip
    with _figure(len(points), path) as axes:
        for axis, point in zip(axes, points, strict=True):
            experiment = study.make_experiment(point * study.repeats)
            result = run(experiment)
            corners = make_target(experiment.target.shape, experiment.target.size).vertices()
            paths = np.array([_project(corners, pose) for pose in result.pose])
            goal = _project(corners, result.goal_pose)
            axis.plot(paths[:, :, 0], paths[:, :, 1], linewidth=1.0)
            axis.plot(paths[0, :, 0], paths[0, :, 1], "o", color="white", mec=INK, ms=3.5)
            axis.plot(goal[:, 0], goal[:, 1], "x", color=INK, ms=5.0)
            axis.plot(paths[-1, :, 0], paths[-1, :, 1], "o", color=INK, ms=3.0)
            _set_title(axis, study.find_combination(point).names["scheme"], result.outcome)
            axis.set_xlim(-0.4, 0.4)
            axis.set_ylim(0.3, -0.3)
            axis.set_aspect("equal")


def _project(corners: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Project corners (n, 3) to normalised coordinates (n, 2), NaN behind the camera.

    `pose` is world_T_camera (4, 4).
    """
    camera_T_world = inverse(pose)
    points = corners @ camera_T_world[:3, :3].T + camera_T_world[:3, 3]
    return np.where(points[:, 2:] > 0.0, points[:, :2] / points[:, 2:], np.nan)


def draw_success_map(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw the distance and angle of all starts, a panel for each scheme and condition."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row.get("start_distance") not in ("", "nan", None):
            groups.setdefault((row["scheme"], row["condition"]), []).append(row)
    with _figure(len(groups), path) as axes:
        for axis, ((case, condition), found) in zip(axes, groups.items(), strict=True):
            for is_hit, colour, marker in ((True, BLUE, "o"), (False, VERMILION, "x")):
                some = [row for row in found if row["hit"] is is_hit]
                axis.scatter(
                    [float(row["start_distance"]) for row in some],
                    [math.degrees(float(row["start_angle"])) for row in some],
                    s=12, c=colour, marker=marker, linewidths=1.0,
                )  # fmt: skip
            hits = sum(row["hit"] for row in found)
            _set_title(axis, case, f"{condition}: {hits} of {len(found)}")
            axis.set_xlim(0.0, 0.9)
            axis.set_ylim(0.0, None)
            axis.set_xlabel("distance (m)", fontsize=8)
            axis.set_ylabel("angle (degrees)", fontsize=8)
