"""Curves over time: errors, features, twist, joints, the way that is left, conditioning, timing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .record import Record, scaled
from .style import (
    COLOURS,
    FAINT,
    GOAL,
    INK,
    LIMIT,
    TIME,
    canvas,
    heading,
    is_paper,
    legend,
    logarithmic,
)

SYMBOLS = {
    "xn": "$x_n$", "yn": "$y_n$", "an": "$a_n$", "alpha": r"$\alpha$", "theta": r"$\theta$",
    "rho": r"$\rho$",
}  # fmt: skip
# Joints and curves of a panel that can still be told apart.
MOST_CURVES = 12
SETTLED = 0.02
UNLIMITED = 100.0  # rad or m beyond which a limit is none
FLOOR = 1e-6  # of logarithmic axes, parts of the first value


def symbol(name: str) -> str:
    """A feature's name as a formula has it."""
    stem = name.rstrip("0123456789").rstrip("_")
    number = name[len(stem) :].lstrip("_")
    if number and len(stem) == 1:
        return f"${stem}_{{{number}}}$"
    return SYMBOLS.get(name, name.replace("_", " "))


def unit_groups(record: Record) -> list[tuple[str, list[int]]]:
    """Features that share an axis, those of one unit: (unit, indexes)."""
    groups: dict[str, list[int]] = {}
    for index, unit in enumerate(record.units):
        groups.setdefault(unit, []).append(index)
    return list(groups.items())


def with_unit(what: str, unit: str) -> str:
    """An axis' label; what has no unit says so."""
    return f"{what} ({unit})" if unit else f"{what} (no unit)"


def _paint(axis: Axes, count: int) -> list[dict[str, object]]:
    """A style for each of so many curves: colours first, then dashes."""
    dashes = ("-", (0, (4, 1.5)), (0, (1, 1.2)))
    return [
        {"color": COLOURS[i % len(COLOURS)], "ls": dashes[i // len(COLOURS) % len(dashes)]}
        for i in range(count)
    ]


def _zero(axis: Axes) -> None:
    axis.axhline(0.0, color=FAINT, lw=0.8, zorder=1)


def _times(axes: Sequence[Axes], records: Sequence[Record], label: str = TIME) -> None:
    end = max((float(r.time[-1]) for r in records if len(r.time)), default=1.0)
    axes[-1].set_xlabel(label)
    axes[-1].set_xlim(0.0, max(end, 1e-3))


def _settled_mark(axis: Axes, record: Record) -> None:
    settled = record.run.settled()
    if np.isfinite(settled):
        axis.axvline(settled, color=GOAL, ls=":", lw=1.2)
        axis.annotate(
            f"settled after {settled:.2f} s", (settled, 1.0), xycoords=("data", "axes fraction"),
            xytext=(4, -3), textcoords="offset points", color=GOAL, va="top",
        )  # fmt: skip


def feature_errors(records: Sequence[Record]) -> Figure | None:
    """s - s*: of one run a panel a unit, raw and filtered; of several a panel a feature."""
    records = [r for r in records if r.run.names]
    if not records:
        return None
    if len(records) > 1:
        return _compared_errors(records)
    record = records[0]
    groups = unit_groups(record)
    figure, axes = canvas(len(groups) + 1, each=1.75)
    axes = axes[:, 0]
    error, filtered = record.run.error, record.details.filtered
    smoothed = filtered.shape == error.shape and not np.allclose(filtered, error, equal_nan=True)
    for axis, (unit, members) in zip(axes, groups, strict=False):
        bounds = {record.tolerances[i] for i in members} if record.tolerances else set()
        if len(bounds) == 1:
            axis.axhspan(-min(bounds), min(bounds), color=GOAL, alpha=0.13, lw=0)
        _zero(axis)
        for i, style in zip(members, _paint(axis, len(members)), strict=True):
            if smoothed:
                axis.plot(record.time, error[:, i], **{**style, "alpha": 0.35, "lw": 0.8})
            axis.plot(record.time, filtered[:, i] if smoothed else error[:, i],
                      label=symbol(record.run.names[i]), **style)  # fmt: skip
        axis.set_ylabel(with_unit("error", unit))
        if len(members) <= MOST_CURVES:
            legend(axis, 6)
    told = ["pale: as measured, full: filtered"] if smoothed else []
    told += ["band: counts as reached"] if record.tolerances else []
    heading(axes[0], "Feature errors s − s*" + (f"  ({'; '.join(told)})" if told else ""))
    _norm(axes[-1], [record])
    _settled_mark(axes[-1], record)
    _times(axes, records)
    return figure


def _norm(axis: Axes, records: Sequence[Record]) -> None:
    """Norm of the errors, each in parts of its largest: several units have no norm."""
    for record, colour in zip(records, _colours(records), strict=True):
        size = np.linalg.norm(scaled(record.run.error), axis=1)
        known = np.isfinite(size)
        if known.any():
            first = size[known][0] or 1.0
            axis.semilogy(record.time[known], np.maximum(size[known] / first, FLOOR),
                          color=colour, label=record.name)  # fmt: skip
    axis.axhline(SETTLED, color=GOAL, ls="--", lw=0.9)
    axis.annotate("2 %", (1.0, SETTLED), xycoords=("axes fraction", "data"), ha="right",
                  xytext=(-2, 3), textcoords="offset points", color=GOAL)  # fmt: skip
    axis.set_ylabel("norm, relative")


def _colours(records: Sequence[Record]) -> list[str]:
    return [INK] if len(records) == 1 else [COLOURS[i % len(COLOURS)] for i in range(len(records))]


def _compared_errors(records: Sequence[Record]) -> Figure:
    """A panel a feature where all runs have the same few, and the norm of each."""
    names = records[0].run.names
    same = all(r.run.names == names for r in records) and len(names) <= 6
    figure, axes = canvas(1 + (len(names) if same else 0), each=1.5)
    axes = axes[:, 0]
    if same:
        for i, axis in enumerate(axes[:-1]):
            _zero(axis)
            for record, colour in zip(records, _colours(records), strict=True):
                axis.plot(record.time, record.run.error[:, i], color=colour, label=record.name)
            axis.set_ylabel(with_unit(symbol(names[i]), records[0].units[i]))
    _norm(axes[-1], records)
    heading(axes[0], "Feature errors s − s*" if same else "Feature errors, norm of each run")
    legend(axes[0])
    _times(axes, records)
    return figure


def features(records: Sequence[Record]) -> Figure | None:
    """s (full) and s* (dashed), a panel a unit."""
    if len(records) > 1 or not records[0].run.names:
        return None
    record = records[0]
    groups = unit_groups(record)
    figure, axes = canvas(len(groups), each=2.0)
    axes = axes[:, 0]
    for axis, (unit, members) in zip(axes, groups, strict=True):
        for i, style in zip(members, _paint(axis, len(members)), strict=True):
            axis.plot(record.time, record.run.desired[:, i],
                      **{**style, "ls": "--", "lw": 1.0, "alpha": 0.8})  # fmt: skip
            axis.plot(record.time, record.run.features[:, i],
                      label=symbol(record.run.names[i]), **style)  # fmt: skip
        axis.set_ylabel(with_unit("feature", unit))
        if len(members) <= MOST_CURVES:
            legend(axis, 6)
    heading(axes[0], "Features s  (dashed: desired s*)")
    _times(axes, records)
    return figure


def camera_twist(records: Sequence[Record]) -> Figure | None:
    """Twist of the camera in its own frame, asked and achieved: linear above, angular below."""
    figure, axes = canvas(2, each=2.1)
    axes = axes[:, 0]
    for axis, begin, letter, unit in ((axes[0], 0, "v", "m/s"), (axes[1], 3, r"\omega", "rad/s")):
        _zero(axis)
        for record, colour in zip(records, _colours(records), strict=True):
            part = slice(begin, begin + 3)
            if len(records) > 1:
                size = np.linalg.norm(record.run.achieved[:, part], axis=1)
                axis.plot(record.time, size, color=colour, label=record.name)
                continue
            for i in range(3):
                axis.plot(record.time, record.run.asked[:, begin + i], color=COLOURS[i], ls="--",
                          lw=0.9, alpha=0.8)  # fmt: skip
                axis.plot(record.time, record.run.achieved[:, begin + i], color=COLOURS[i],
                          label=f"${letter}_{'xyz'[i]}$")  # fmt: skip
        symbols = f"|{letter}|" if len(records) > 1 else letter
        axis.set_ylabel(f"${symbols}$ ({unit})")
    legend(axes[0])
    if len(records) == 1:
        legend(axes[1])
    heading(axes[0], "Speed of the camera" if len(records) > 1 else
            "Twist  (dashed: asked, full: given)")  # fmt: skip
    _times(axes, records)
    return figure


def joint_positions(records: Sequence[Record]) -> Figure | None:
    """Each joint's position with its command and limits, and its speed with its limit beside."""
    records = [r for r in records if r.run.joint_names]
    if not records:
        return None
    names, single = records[0].run.joint_names, len(records) == 1
    figure, axes = canvas(len(names), 2, each=1.25)
    for j, name in enumerate(names):
        place, speed = axes[j]
        for record, colour in zip(records, _colours(records), strict=True):
            if name not in record.run.joint_names:
                continue
            run, i = record.run, record.run.joint_names.index(name)
            shown = record.joint_time >= -0.1
            time, style = record.joint_time[shown], {"color": COLOURS[0] if single else colour}
            place.plot(time, run.measured[shown, i], label="measured" if single else record.name,
                       **style)  # fmt: skip
            if single:
                place.plot(time, run.commanded[shown, i], color=COLOURS[1], lw=1.0, ls="--",
                           label="command")  # fmt: skip
            speed.plot(time, run.measured_speed[shown, i],
                       label="measured" if single else record.name, **style)  # fmt: skip
            if single and is_paper():
                speed.plot([], [], color=COLOURS[1], lw=1.0, ls="--", label="command")
        unit = dict(zip(names, records[0].joint_units, strict=False)).get(name, "rad")
        place.set_ylabel(f"{name} ({unit})")
        speed.set_ylabel(f"({unit}/s)")
        _zero(speed)
        _limits(place, *(bounds[j : j + 1] for bounds in records[0].limits))
        top = records[0].speed[j : j + 1]
        _limits(speed, -top, top)
    if single:
        heading(axes[0, 0], "Positions  (dashed: commanded)")
        heading(axes[0, 1], "Speeds")
    else:  # beside a second title there is no room for the names of runs
        heading(axes[0, 0], "Positions and speeds")
    if is_paper() or not single:
        legend(axes[0, 1], 2 if single else 3, handlelength=1.2, columnspacing=0.8)
    for column in (0, 1):
        _times(axes[:, column], records, "time (s)" if is_paper() else TIME)
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
            axis.axhline(bound, color=LIMIT, lw=1.0, ls=(0, (5, 2)))
            low, high = min(low, bound - 0.05 * room), max(high, bound + 0.05 * room)
            axis.axhspan(bound, bound + outward * 10.0 * room, color=LIMIT, alpha=0.08, lw=0)
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
                      color=FAINT)  # fmt: skip


def pose_errors(records: Sequence[Record]) -> Figure | None:
    """How far the camera is from its goal: distance above, angle below, logarithmic."""
    records = [r for r in records if np.isfinite(r.run.goal_pose).all() and r.servoing.any()]
    if not records:
        return None
    figure, axes = canvas(2, each=1.9)
    axes = axes[:, 0]
    for record, colour in zip(records, _colours(records), strict=True):
        distance, angle = record.run.way()
        time, after = record.joint_time, record.servoing
        axes[0].semilogy(time[after], np.maximum(1e3 * distance[after], 1e-4), color=colour,
                         label=record.name)  # fmt: skip
        axes[1].semilogy(time[after], np.maximum(np.degrees(angle[after]), 1e-4), color=colour)
    axes[0].set_ylabel("distance (mm)")
    axes[1].set_ylabel("angle (degrees)")
    for axis in axes:
        logarithmic(axis)
    heading(axes[0], "Way of the camera to its goal that is left")
    if len(records) > 1:
        legend(axes[0])
    else:
        _settled_mark(axes[0], records[0])
    _times(axes, records)
    return figure


def conditioning(records: Sequence[Record]) -> Figure | None:
    """Condition numbers of L and of L J, manipulability, and how much limits slowed the task."""
    records = [r for r in records if np.isfinite(r.details.singular_L).any()]
    if not records:
        return None
    figure, axes = canvas(3, each=1.5)
    axes = axes[:, 0]
    for record, colour in zip(records, _colours(records), strict=True):
        details, single = record.details, len(records) == 1
        for values, name, shade, style in (
            (details.singular_L, "L", COLOURS[0], "-"), (details.singular_LJ, "L J", COLOURS[1],
                                                         "--"),
        ):  # fmt: skip
            number = condition(values)
            if np.isfinite(number).any():
                label = f"${name}$".replace(" ", r"\,") if single else \
                    record.name if name == "L" else None
                axes[0].semilogy(record.time, number, color=shade if single else colour, ls=style,
                                 label=label)  # fmt: skip
        axes[1].plot(record.time, details.manipulability, color=colour)
        axes[2].plot(record.time, details.scale, color=colour)
    axes[0].set_ylabel("condition number")
    logarithmic(axes[0])
    axes[1].set_ylabel("manipulability")
    axes[2].set_ylabel("scale")
    axes[2].set_ylim(-0.05, 1.1)
    heading(axes[0], "Conditioning" + ("  (full: L, dashed: L J)" if len(records) > 1 else ""))
    heading(axes[2], "Factor by which limits slowed the task")
    legend(axes[0])
    _times(axes, records)
    return figure


def condition(singular: np.ndarray) -> np.ndarray:
    """Largest over smallest singular value (n,) of rows (n, p); inf where one is 0; NaN: none."""
    if not singular.size:
        return np.full(len(singular), np.nan)
    known = np.isfinite(singular).any(axis=1)
    largest = np.where(known, np.nanmax(np.where(np.isfinite(singular), singular, -np.inf), 1),
                       np.nan)  # fmt: skip
    smallest = np.where(known, np.nanmin(np.where(np.isfinite(singular), singular, np.inf), 1),
                        np.nan)  # fmt: skip
    with np.errstate(divide="ignore", invalid="ignore"):
        return largest / smallest


def timing(records: Sequence[Record]) -> Figure | None:
    """Intervals between images, delays, and the pace of simulated time, as far as recorded."""
    records = [r for r in records if len(r.time) > 2]
    panels = [panel for panel in (_intervals, _delays, _paces) if any(map(panel, records))]
    if not panels:
        return None
    figure, axes = canvas(len(panels), each=1.5)
    axes = axes[:, 0]
    for axis, panel in zip(axes, panels, strict=True):
        for record, colour in zip(records, _colours(records), strict=True):
            for i, (name, time, values) in enumerate(panel(record)):
                single = len(records) == 1
                axis.plot(time, values, "-" if panel is _paces else ".", ms=3, lw=1.0,
                          color=COLOURS[i] if single else colour,
                          label=name if single else record.name if i == 0 else None)  # fmt: skip
        low, high = axis.get_ylim()
        axis.set_ylim(min(low, 0.0), 1.15 * high)
        axis.set_ylabel({_intervals: "interval (ms)", _delays: "delay (ms)",
                         _paces: "real-time factor"}[panel])  # fmt: skip
        if len(records) == 1 and panel is _delays:
            legend(axis)
    heading(axes[0], "Time between images")
    if len(records) > 1:
        legend(axes[0])
    _times(axes, records)
    return figure


Dots = list[tuple[str, np.ndarray, np.ndarray]]


def _intervals(record: Record) -> Dots:
    stamp = record.images.stamp if len(record.images.stamp) > 2 else record.run.stamp
    time = stamp[1:] - record.began
    return [("interval", time[time >= 0.0], 1e3 * np.diff(stamp)[time >= 0.0])]


def _delays(record: Record) -> Dots:
    images, found = record.images, []
    shown = images.stamp >= record.began
    if np.any(images.arrival > images.stamp):
        delay = 1e3 * (images.arrival - images.stamp)
        found.append(("exposure to recorder", images.stamp[shown] - record.began, delay[shown]))
    if np.isfinite(record.details.computing).any():
        found.append(("scheme computing", record.time, 1e3 * record.details.computing))
    return found


def _paces(record: Record) -> Dots:
    if not len(record.pace):
        return []
    stamp, factor = record.pace.T
    shown = stamp >= record.began
    return [("pace", stamp[shown] - record.began, factor[shown])] if shown.any() else []
