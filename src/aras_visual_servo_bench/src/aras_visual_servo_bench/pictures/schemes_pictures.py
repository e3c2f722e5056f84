"""Pictures of the page of schemes: ways through the image, and where a scheme converges from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aras_visual_servo_base.poses import inverse

from ..running.loop import run
from ..study.study import Study
from ..targets.outlines import shape_of

PANELS = 4  # in a row
BLUE, RED = "#2166ac", "#b2182b"


def _panels(count: int, width: float, height: float) -> tuple:
    """A figure and so many axes, the rest of the last row switched off."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = -(-count // PANELS)
    size = (width * min(count, PANELS), height * rows)
    figure, axes = pyplot.subplots(rows, min(count, PANELS), figsize=size, squeeze=False)
    for axis in axes.ravel()[count:]:
        axis.set_axis_off()
    return figure, axes.ravel()[:count]


def _save(figure: object, path: Path) -> None:
    from matplotlib import pyplot

    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def ways(study: Study, start: str, path: Path) -> None:
    """How the target's corners went through the image, a panel for each scheme, from one start."""
    condition = next(iter(study.case_axes.get("condition", ())), None)
    points = [
        point for point in range(study.points)
        if (names := study.combination(point).names)["start"] == start
        and (condition is None or names["condition"] == condition.name)
    ]  # fmt: skip
    figure, axes = _panels(len(points), 3.0, 2.6)
    for axis, point in zip(axes, points, strict=True):
        experiment = study.experiment_of(point * study.repeats)
        result = run(experiment)
        corners = shape_of(experiment.target.shape, experiment.target.size).vertices()
        seen = np.array([_projected(corners, pose) for pose in result.pose])
        goal = _projected(corners, result.goal_pose)
        axis.plot(seen[:, :, 0], seen[:, :, 1], linewidth=1.0)
        axis.plot(seen[0, :, 0], seen[0, :, 1], "o", color="white", mec="black", ms=3.5)
        axis.plot(goal[:, 0], goal[:, 1], "x", color="black", ms=5.0)
        axis.plot(seen[-1, :, 0], seen[-1, :, 1], "o", color="black", ms=3.0)
        axis.set_title(f"{study.combination(point).names['scheme']}\n{result.outcome}", fontsize=7)
        axis.set_xlim(-0.4, 0.4)
        axis.set_ylim(0.3, -0.3)
        axis.set_aspect("equal")
        axis.tick_params(labelsize=6)
    _save(figure, path)


def _projected(corners: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Normalised (n, 2) of corners (n, 3) from world_T_camera; NaN behind the camera."""
    seen = inverse(pose)
    points = corners @ seen[:3, :3].T + seen[:3, 3]
    return np.where(points[:, 2:] > 0.0, points[:, :2] / points[:, 2:], np.nan)


def success_map(
    rows: Sequence[Mapping[str, Any]], path: Path
) -> None:
    """Starts by distance and angle from the goal, a panel for each scheme and condition."""
    panels: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row.get("start_distance") not in ("", "nan", None):
            panels.setdefault((row["scheme"], row["condition"]), []).append(row)
    figure, axes = _panels(len(panels), 2.8, 2.4)
    for axis, ((case, condition), found) in zip(axes, panels.items(), strict=True):
        for wanted, colour, marker in ((True, BLUE, "o"), (False, RED, "x")):
            some = [row for row in found if row["hit"] is wanted]
            axis.scatter(
                [float(row["start_distance"]) for row in some],
                [math.degrees(float(row["start_angle"])) for row in some],
                s=12, c=colour, marker=marker, linewidths=1.0,
            )  # fmt: skip
        hits = sum(row["hit"] for row in found)
        axis.set_title(f"{case}, {condition}: {hits} of {len(found)}", fontsize=7)
        axis.set_xlim(0.0, 0.9)
        axis.set_ylim(0.0, None)
        axis.set_xlabel("distance, m", fontsize=7)
        axis.set_ylabel("angle, degrees", fontsize=7)
        axis.tick_params(labelsize=6)
    _save(figure, path)
