"""What arm and machine did over time: joints, conditioning, timing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..numbers.metrics import condition
from ..pictures.palette import BAD, COLOURS, SOFT
from ..pictures.style import TIME, heading, is_paper, legend, literal, logarithmic, panels
from ..recording.run import Run
from .time_axes import curve, end, looks, times, zero

UNLIMITED = 100.0  # rad or m beyond which a limit is none


def joint_positions(runs: Sequence[Run]) -> Figure | None:
    """Each joint's position with its command and limits, and its speed with its limit beside."""
    runs = [r for r in runs if r.joint_names]
    if not runs:
        return None
    names, single = runs[0].joint_names, len(runs) == 1
    figure, axes = panels(2 * len(names), each=1.25, columns=2, wide=True)
    for j, name in enumerate(names):
        place, speed = axes[2 * j : 2 * j + 2]
        for run, look in zip(runs, looks(len(runs)), strict=True):
            if name not in run.joint_names:
                continue
            i = run.joint_names.index(name)
            shown = run.joint_time >= -0.1
            time = run.joint_time[shown]
            style = {"color": COLOURS[0], "label": "measured"} if single else \
                {"label": literal(run.name), **look}  # fmt: skip
            place.plot(time, run.measured[shown, i], **style)
            if single:
                place.plot(time, run.commanded[shown, i], color=COLOURS[1], lw=1.0, ls="--",
                           label="command")  # fmt: skip
            speed.plot(time, run.measured_speed[shown, i], **style)
            if single and is_paper():
                speed.plot([], [], color=COLOURS[1], lw=1.0, ls="--", label="command")
        unit = dict(zip(names, runs[0].joint_units, strict=False)).get(name, "rad")
        place.set_ylabel(f"{literal(name)} ({unit})")
        speed.set_ylabel(f"({unit}/s)")
        zero(speed)
        _limits(place, *(bounds[j : j + 1] for bounds in runs[0].limits))
        top = runs[0].speed[j : j + 1]
        _limits(speed, -top, top)
    if single:
        heading(axes[0], "Positions  (dashed: commanded)")
        heading(axes[1], "Speeds")
    else:  # beside a second title there is no room for the names of runs
        heading(axes[0], "Positions and speeds")
    if is_paper() or not single:
        legend(axes[1], 2 if single else 3, handlelength=1.2, columnspacing=0.8)
    for column in (0, 1):
        times(axes[column::2], runs, "time (s)" if is_paper() else TIME)
    return figure


def _limits(axis: Axes, lower: np.ndarray, upper: np.ndarray) -> None:
    """Limits as lines where they are near to what is shown, as numbers where they are far."""
    low, high = axis.get_ylim()
    if high - low < 0.004:  # what stands still shall look like it
        middle = 0.5 * (low + high)
        low, high = middle - 0.002, middle + 0.002
    room, far = 0.6 * (high - low), []
    bounds = [(float(side[0]), sign) for side, sign in ((lower, -1.0), (upper, 1.0))
              if side.size and abs(side[0]) < UNLIMITED]  # fmt: skip
    for bound, outward in bounds:
        if low - room <= bound <= high + room:
            axis.axhline(bound, color=BAD, lw=1.0, ls=(0, (5, 2)))
            low, high = min(low, bound - 0.05 * room), max(high, bound + 0.05 * room)
            axis.axhspan(bound, bound + outward * 10.0 * room, color=BAD, alpha=0.08, lw=0)
        else:
            far.append(f"{bound:.3g}")
    axis.set_ylim(low, high)
    if len(far) == len(bounds) > 0 and not is_paper():
        # Where the curve is not at its end, most of the picture.
        last = np.concatenate([line.get_ydata()[len(line.get_ydata()) // 2 :] for line in axis.lines
                               if len(line.get_ydata()) > 2] or [[low]])  # fmt: skip
        below = np.nanmean(last) > 0.5 * (low + high)
        axis.annotate(f"limits {' to '.join(far)}", (1.0, 0.0 if below else 1.0), ha="right",
                      xycoords="axes fraction", va="bottom" if below else "top", fontsize=7.5,
                      xytext=(-3, 3 if below else -2), textcoords="offset points",
                      color=SOFT)  # fmt: skip


def conditioning(runs: Sequence[Run]) -> Figure | None:
    """Condition numbers of L and of L J, manipulability, and how much limits slowed the task."""
    runs = [r for r in runs if np.isfinite(r.singular_L).any()]
    if not runs:
        return None
    single = len(runs) == 1
    figure, axes = panels(3 if single else 4, each=1.5)
    ratios = axes[:-2]  # of one run in one panel, of several in a panel for L and one for L J
    for run, look in zip(runs, looks(len(runs)), strict=True):
        for axis, values, name, shade, style in (
            (ratios[0], run.singular_L, "$L$", COLOURS[0], "-"),
            (ratios[-1], run.singular_LJ, r"$L\,J$", COLOURS[1], "--"),
        ):
            own = {"color": shade, "ls": style, "label": name} if single else \
                {"label": literal(run.name), **look}  # fmt: skip
            curve(axis, run.time, condition(values), **own)
        curve(axes[-2], run.time, run.manipulability, **look)
        curve(axes[-1], run.time, run.scale, **look)
    for axis, name in zip(ratios, ("",) if single else (" of $L$", r" of $L\,J$"), strict=True):
        axis.set_yscale("log")
        axis.set_ylabel("condition" + (name or " number"))
        logarithmic(axis)
    axes[-2].set_ylabel("manipulability")
    axes[-1].set_ylabel("scale")
    axes[-1].set_ylim(-0.05, 1.1)
    heading(axes[0], "Conditioning")
    heading(axes[-1], "Factor by which limits slowed the task")
    legend(axes[0])
    times(axes, runs)
    return figure


def timing(runs: Sequence[Run]) -> Figure | None:
    """Intervals between images, delays, and the pace of simulated time, as far as recorded."""
    runs = [r for r in runs if len(r.time) > 2]
    kinds = [panel for panel in (intervals, delays, paces) if any(map(panel, runs))]
    if not kinds:
        return None
    figure, axes = panels(len(kinds), each=1.5)
    for axis, panel in zip(axes, kinds, strict=True):
        for run, look in zip(runs, looks(len(runs)), strict=True):
            for i, (name, time, values) in enumerate(panel(run)):
                single = len(runs) == 1
                own = {"color": COLOURS[i], "label": name, "marker": ".", "ms": 3} if single else \
                    {**look, "markevery": None, "ms": 2.0 * look["lw"],
                     "label": literal(run.name) if i == 0 else None}  # fmt: skip
                axis.plot(time, values, **{**own, "lw": 1.0}, ls="-" if panel is paces else "")
        low, high = axis.get_ylim()
        axis.set_ylim(min(low, 0.0), 1.15 * high)
        axis.set_ylabel({intervals: "interval (ms)", delays: "delay (ms)",
                         paces: "real-time factor"}[panel])  # fmt: skip
        if len(runs) == 1 and panel is delays:
            legend(axis)
    heading(axes[0], "Time between images")
    if len(runs) > 1:
        legend(axes[0])
    times(axes, runs)
    return figure


Dots = list[tuple[str, np.ndarray, np.ndarray]]


def intervals(run: Run) -> Dots:
    stamp = run.images.stamp if len(run.images.stamp) > 2 else run.stamp
    time = stamp[1:] - run.began
    return [("interval", time[time >= 0.0], 1e3 * np.diff(stamp)[time >= 0.0])]


def delays(run: Run) -> Dots:
    images, found = run.images, []
    shown = images.stamp >= run.began
    if np.any(images.arrival != images.stamp):
        delay = 1e3 * (images.arrival - images.stamp)
        found.append(("exposure to recorder", images.stamp[shown] - run.began, delay[shown]))
    if np.isfinite(run.computing).any():
        found.append(("scheme computing", run.time, 1e3 * run.computing))
    return found


def paces(run: Run) -> Dots:
    if not len(run.pace):
        return []
    stamp, factor = run.pace.T
    time = stamp - run.began
    shown = (time >= 0.0) & (time <= end([run])) & np.isfinite(factor)
    return [("pace", time[shown], factor[shown])] if shown.any() else []
