"""Pictures of the page of schemes: ways through the image, and where a scheme converges from."""

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

COLUMNS, WIDTH, HEIGHT = 4, 3.0, 2.8  # panels in a row, and inches of each
LETTERS = 38  # across a panel


@contextmanager
def _page(count: int, path: Path) -> Iterator[list[Axes]]:
    """So many axes, whose picture is written when they are drawn."""
    with apply_style():
        figure, axes = make_axes(count, HEIGHT, min(count, COLUMNS), width=WIDTH)
        yield axes
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=100)
        plt.close(figure)


def _title(axis: Axes, *lines: str) -> None:
    """Lines above an axis, folded to its width."""
    axis.set_title("\n".join(fill(line, LETTERS) for line in lines), fontsize=8)


def ways(study: Study, start: str, path: Path) -> None:
    """How the target's corners went through the image, a panel for each scheme, from one start."""
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
            seen = np.array([_projected(corners, pose) for pose in result.pose])
            goal = _projected(corners, result.goal_pose)
            axis.plot(seen[:, :, 0], seen[:, :, 1], linewidth=1.0)
            axis.plot(seen[0, :, 0], seen[0, :, 1], "o", color="white", mec=INK, ms=3.5)
            axis.plot(goal[:, 0], goal[:, 1], "x", color=INK, ms=5.0)
            axis.plot(seen[-1, :, 0], seen[-1, :, 1], "o", color=INK, ms=3.0)
            _title(axis, study.find_combination(point).names["scheme"], result.outcome)
            axis.set_xlim(-0.4, 0.4)
            axis.set_ylim(0.3, -0.3)
            axis.set_aspect("equal")


def _projected(corners: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Normalised (n, 2) of corners (n, 3) from world_T_camera; NaN behind the camera."""
    seen = inverse(pose)
    points = corners @ seen[:3, :3].T + seen[:3, 3]
    return np.where(points[:, 2:] > 0.0, points[:, :2] / points[:, 2:], np.nan)


def success_map(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Starts by distance and angle from the goal, a panel for each scheme and condition."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row.get("start_distance") not in ("", "nan", None):
            groups.setdefault((row["scheme"], row["condition"]), []).append(row)
    with _page(len(groups), path) as axes:
        for axis, ((case, condition), found) in zip(axes, groups.items(), strict=True):
            for wanted, colour, marker in ((True, BLUE, "o"), (False, VERMILION, "x")):
                some = [row for row in found if row["hit"] is wanted]
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
