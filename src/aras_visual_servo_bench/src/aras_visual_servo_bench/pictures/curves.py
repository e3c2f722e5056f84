"""What the scheme did over time: errors, features, the camera's twist and the way that is left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..numbers.metrics import error_settled, settled
from ..recording.run import Run, scaled
from ..report.time_axes import curve, looks, settled_mark, times, zero
from .palette import COLOURS, GOAL, GOOD
from .style import heading, legend, literal, logarithmic, panels

SYMBOLS = {
    "xn": "$x_n$", "yn": "$y_n$", "an": "$a_n$", "alpha": r"$\alpha$", "theta": r"$\theta$",
    "rho": r"$\rho$",
}  # fmt: skip
# Joints and curves of a panel that can still be told apart.
MOST_CURVES = 12
SETTLED = 0.02
FLOOR = 1e-6  # of logarithmic axes, parts of the first value


def symbol(name: str) -> str:
    """A feature's name as a formula has it."""
    stem = name.rstrip("0123456789").rstrip("_")
    number = name[len(stem) :].lstrip("_")
    if number and stem.isalpha() and len(stem) == 1:
        return f"${stem}_{{{number}}}$"
    return SYMBOLS.get(name, literal(name.replace("_", " ")))


def unit_groups(run: Run) -> list[tuple[str, list[int]]]:
    """Features that share an axis, those of one unit: (unit, indexes)."""
    groups: dict[str, list[int]] = {}
    for index, unit in enumerate(run.units):
        groups.setdefault(unit, []).append(index)
    return list(groups.items())


def with_unit(what: str, unit: str) -> str:
    """An axis' label; what has no unit says so."""
    return f"{what} ({literal(unit)})" if unit else f"{what} (no unit)"


def _paint(axis: Axes, count: int) -> list[dict[str, object]]:
    """A style for each of so many curves: colours first, then dashes."""
    dashes = ("-", (0, (4, 1.5)), (0, (1, 1.2)))
    return [
        {"color": COLOURS[i % len(COLOURS)], "ls": dashes[i // len(COLOURS) % len(dashes)]}
        for i in range(count)
    ]


def feature_errors(runs: Sequence[Run]) -> Figure | None:
    """s - s*: of one run a panel a unit, raw and filtered; of several a panel a feature."""
    runs = [r for r in runs if r.names]
    if not runs:
        return None
    if len(runs) > 1:
        return _compared_errors(runs)
    run = runs[0]
    groups = unit_groups(run)
    figure, axes = panels(len(groups) + 1, each=1.75)
    error, filtered = run.error, run.filtered
    smoothed = filtered.shape == error.shape and not np.allclose(filtered, error, equal_nan=True)
    told = ["pale: as measured, full: filtered"] if smoothed else []
    told += ["band: counts as reached"] if run.tolerances else []
    heading(axes[0], "Feature errors s − s*" + (f"  ({'; '.join(told)})" if told else ""))
    for axis, (unit, members) in zip(axes, groups, strict=False):
        bounds = {run.tolerances[i] for i in members} if run.tolerances else set()
        if len(bounds) == 1:
            axis.axhspan(-min(bounds), min(bounds), color=GOAL, alpha=0.13, lw=0)
        zero(axis)
        for i, style in zip(members, _paint(axis, len(members)), strict=True):
            if smoothed:
                curve(axis, run.time, error[:, i], **{**style, "alpha": 0.35, "lw": 0.8})
            curve(axis, run.time, filtered[:, i] if smoothed else error[:, i],
                  label=symbol(run.names[i]), **style)  # fmt: skip
        axis.set_ylabel(with_unit("error", unit))
        if len(members) <= MOST_CURVES:
            legend(axis, 6)
    _norm(axes[-1], [run])
    settled_mark(axes[-1], run, error_settled.measure(run))
    times(axes, runs)
    return figure


def _norm(axis: Axes, runs: Sequence[Run]) -> None:
    """Norm of the errors, each in parts of its largest: several units have no norm."""
    for run, look in zip(runs, looks(len(runs)), strict=True):
        size = np.linalg.norm(scaled(run.error), axis=1)
        known = np.isfinite(size)
        if known.any():
            first = size[known][0] or 1.0
            curve(axis, run.time, np.maximum(size / first, FLOOR),
                  label=literal(run.name), **look)  # fmt: skip
    axis.set_yscale("log")
    logarithmic(axis)
    axis.axhline(SETTLED, color=GOAL, ls="--", lw=0.9)
    axis.annotate("2 %", (1.0, SETTLED), xycoords=("axes fraction", "data"), ha="right",
                  xytext=(-2, 3), textcoords="offset points", color=GOOD)  # fmt: skip
    axis.set_ylabel("norm, relative")


def _compared_errors(runs: Sequence[Run]) -> Figure:
    """A panel a feature where all runs have the same few, and the norm of each."""
    names = runs[0].names
    same = all(r.names == names for r in runs) and len(names) <= 6
    figure, axes = panels(1 + (len(names) if same else 0), each=1.5)
    if same:
        for i, axis in enumerate(axes[:-1]):
            zero(axis)
            for run, look in zip(runs, looks(len(runs)), strict=True):
                curve(axis, run.time, run.error[:, i], label=literal(run.name), **look)
            axis.set_ylabel(with_unit(symbol(names[i]), runs[0].units[i]))
    _norm(axes[-1], runs)
    heading(axes[0], "Feature errors s − s*" if same else "Feature errors, norm of each run")
    legend(axes[0])
    times(axes, runs)
    return figure


def features(runs: Sequence[Run]) -> Figure | None:
    """s (full) and s* (dashed), a panel a unit."""
    if len(runs) > 1 or not runs[0].names:
        return None
    run = runs[0]
    groups = unit_groups(run)
    figure, axes = panels(len(groups), each=2.0)
    heading(axes[0], "Features s  (dashed: desired s*)")
    for axis, (unit, members) in zip(axes, groups, strict=True):
        for i, style in zip(members, _paint(axis, len(members)), strict=True):
            curve(axis, run.time, run.desired[:, i],
                  **{**style, "ls": "--", "lw": 1.0, "alpha": 0.8})  # fmt: skip
            curve(axis, run.time, run.features[:, i],
                  label=symbol(run.names[i]), **style)  # fmt: skip
        axis.set_ylabel(with_unit("feature", unit))
        if len(members) <= MOST_CURVES:
            legend(axis, 6)
    times(axes, runs)
    return figure


def camera_twist(runs: Sequence[Run]) -> Figure | None:
    """Twist of the camera in its own frame, asked and achieved: linear above, angular below."""
    figure, axes = panels(2, each=2.1)
    for axis, begin, letter, unit in ((axes[0], 0, "v", "m/s"), (axes[1], 3, r"\omega", "rad/s")):
        zero(axis)
        for run, look in zip(runs, looks(len(runs)), strict=True):
            part = slice(begin, begin + 3)
            if len(runs) > 1:
                size = np.linalg.norm(run.achieved[:, part], axis=1)
                curve(axis, run.time, size, label=literal(run.name), **look)
                continue
            for i in range(3):
                curve(axis, run.time, run.asked[:, begin + i], color=COLOURS[i], ls="--",
                      lw=0.9, alpha=0.8)  # fmt: skip
                curve(axis, run.time, run.achieved[:, begin + i], color=COLOURS[i],
                      label=f"${letter}_{'xyz'[i]}$")  # fmt: skip
        symbols = f"|{letter}|" if len(runs) > 1 else letter
        axis.set_ylabel(f"${symbols}$ ({unit})")
    heading(axes[0], "Speed of the camera" if len(runs) > 1 else
            "Twist  (dashed: asked, full: given)")  # fmt: skip
    legend(axes[0])
    if len(runs) == 1:
        legend(axes[1])
    times(axes, runs)
    return figure


def pose_errors(runs: Sequence[Run]) -> Figure | None:
    """How far the camera is from its goal: distance above, angle below, logarithmic."""
    runs = [r for r in runs if np.isfinite(r.goal_pose).all() and r.servoing.any()]
    if not runs:
        return None
    figure, axes = panels(2, each=1.9)
    for run, look in zip(runs, looks(len(runs)), strict=True):
        distance, angle = run.way()
        time, after = run.joint_time, run.servoing
        axes[0].semilogy(time[after], np.maximum(1e3 * distance[after], 1e-4),
                         label=literal(run.name), **look)  # fmt: skip
        axes[1].semilogy(time[after], np.maximum(np.degrees(angle[after]), 1e-4), **look)
    axes[0].set_ylabel("distance (mm)")
    axes[1].set_ylabel("angle (degrees)")
    for axis in axes:
        logarithmic(axis)
    heading(axes[0], "Distance of the camera from its goal")
    if len(runs) > 1:
        legend(axes[0])
    else:
        settled_mark(axes[0], runs[0], settled.measure(runs[0]))
    times(axes, runs)
    return figure


