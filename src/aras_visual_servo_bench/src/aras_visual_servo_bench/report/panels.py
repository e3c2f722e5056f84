"""What a report's page shows over time: panels of curves, whoever draws them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..numbers.metrics import condition, error_settled, settled
from ..numbers.printing import headed
from ..pictures.curves import FLOOR, SETTLED, unit_groups
from ..recording.run import Run, scaled
from .machine import UNLIMITED, delays, intervals, paces
from .time_axes import broken

MOST_CURVES = 24  # of one panel; more cannot be told apart
MOST_FEATURES = 6  # that several runs are compared in, a panel each
LEAST = 1e-4  # mm and degrees of logarithmic axes
BEFORE = -0.1  # s before servoing begins, from which on joints are shown


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a panel.

    Attributes:
        name: what it is. time: (n,) s since servoing began. values: (n,), NaN where none.
        run: index of its run. shade: number of its colour.
        dashed: what was wanted, beside what was. pale: as measured, beside the filtered.
    """

    name: str
    time: np.ndarray
    values: np.ndarray
    run: int = 0
    shade: int = 0
    dashed: bool = False
    pale: bool = False


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over time that share an axis.

    Attributes:
        title: what they are, with their unit. unit: of the values.
        log: whether the axis is logarithmic. band: half of a band about 0 that counts as reached.
        lines: (value, text) of levels. marks: (s, text) of instants.
        left_out: how many curves more there are.
    """

    title: str
    unit: str
    curves: tuple[Curve, ...]
    log: bool = False
    band: float | None = None
    lines: tuple[tuple[float, str], ...] = ()
    marks: tuple[tuple[float, str], ...] = ()
    left_out: int = 0


def panel(title: str, unit: str, curves: Iterable[Curve], **more: object) -> list[Panel]:
    """A panel of the curves that have values, of too many those that change most; none of none."""
    known = [curve for curve in curves if np.isfinite(curve.values).any()]
    if not known:
        return []
    kept = known
    if len(known) > MOST_CURVES:
        changes = [-float(np.nanmax(c.values) - np.nanmin(c.values)) for c in known]
        kept = [known[i] for i in sorted(np.argsort(changes, kind="stable")[:MOST_CURVES])]
    return [Panel(headed(title, unit), unit, tuple(kept), left_out=len(known) - len(kept), **more)]


def _columns(
    run: Run, names: Sequence[str], table: np.ndarray, members: Iterable[int], more: str = "",
    **look: bool,
) -> list[Curve]:  # fmt: skip
    """Curves of these columns of an array (n, k) at the images; `more`: behind their names."""
    return [Curve(names[i] + more, run.time, table[:, i], shade=shade, **look)
            for shade, i in enumerate(members)]  # fmt: skip


def _of_each(
    runs: Sequence[Run], what: str, values: Callable[[Run], np.ndarray],
    time: Callable[[Run], np.ndarray] = lambda run: run.time,
) -> list[Curve]:  # fmt: skip
    """A curve a run; that of a single run has the name of `what` it is."""
    return [Curve(run.name if len(runs) > 1 else what, time(run), values(run), number, number)
            for number, run in enumerate(runs)]  # fmt: skip


def errors(runs: Sequence[Run]) -> list[Panel]:
    """s - s*: of one run a panel a unit, of several a panel a feature; and their norm."""
    found: list[Panel] = []
    run = runs[0]
    if len(runs) == 1:
        smoothed = not np.allclose(run.filtered, run.error, equal_nan=True)
        for unit, members in unit_groups(run):
            bounds = {run.tolerances[i] for i in members} if run.tolerances else set()
            measured = _columns(run, run.names, run.error, members,
                                " as measured" if smoothed else "", pale=smoothed)  # fmt: skip
            filtered = _columns(run, run.names, run.filtered, members) if smoothed else []
            found += panel("error", unit, filtered + measured,
                           band=min(bounds) if len(bounds) == 1 else None)  # fmt: skip
    elif len(run.names) <= MOST_FEATURES and all(r.names == run.names for r in runs):
        for i, name in enumerate(run.names):
            found += panel(f"error of {name}", run.units[i],
                           _of_each(runs, name, lambda r, i=i: r.error[:, i]))  # fmt: skip
    return found + panel(
        "norm of the errors, relative", "", _of_each(runs, "norm", _norm), log=True,
        lines=((SETTLED, "2 %"),), marks=_settled(runs, error_settled.measure),
    )  # fmt: skip


def _norm(run: Run) -> np.ndarray:
    """(n,) of the errors, each in parts of its largest, in parts of the first."""
    size = np.linalg.norm(scaled(run.error), axis=1)
    known = size[np.isfinite(size)]
    return np.maximum(size / ((known[0] if known.size else 1.0) or 1.0), FLOOR)


def _settled(
    runs: Sequence[Run], when: Callable[[Run], float]
) -> tuple[tuple[float, str], ...]:
    """The mark of a single run that settles."""
    time = when(runs[0]) if len(runs) == 1 else np.nan
    return ((float(time), "settled"),) if np.isfinite(time) else ()


def poses(runs: Sequence[Run]) -> list[Panel]:
    """Distance and angle of the true camera from its goal."""
    ways = {id(run): run.way() for run in runs}
    found: list[Panel] = []
    for k, (title, unit, factor) in enumerate((("distance", "mm", 1e3),
                                               ("angle", "°", 180.0 / np.pi))):
        def left(run: Run, k: int = k, factor: float = factor) -> np.ndarray:
            return np.maximum(factor * ways[id(run)][k][run.servoing], LEAST)

        curves = _of_each(runs, title, left, lambda run: run.joint_time[run.servoing])
        found += panel(f"{title} to the goal", unit, curves, log=True,
                       marks=() if k else _settled(runs, settled.measure))  # fmt: skip
    return found


def features(runs: Sequence[Run]) -> list[Panel]:
    """s and s* of one run, a panel a unit."""
    run = runs[0]
    found: list[Panel] = []
    for unit, members in unit_groups(run) if len(runs) == 1 else ():
        wanted = _columns(run, run.names, run.desired, members, "*", dashed=True)
        found += panel("feature", unit, _columns(run, run.names, run.features, members) + wanted)
    return found


def twists(runs: Sequence[Run]) -> list[Panel]:
    """Of one run asked and achieved by axis, of several the achieved speed."""
    found: list[Panel] = []
    for title, letter, part, unit in (("velocity of the camera", "v", slice(0, 3), "m/s"),
                                      ("turning of the camera", "ω", slice(3, 6), "rad/s")):
        if len(runs) > 1:
            curves = _of_each(
                runs, letter, lambda r, part=part: np.linalg.norm(r.achieved[:, part], axis=1)
            )
        else:
            names, run = [f"{letter}{axis}" for axis in "xyz"], runs[0]
            curves = _columns(run, names, run.achieved[:, part], range(3))
            curves += _columns(run, names, run.asked[:, part], range(3), " asked", dashed=True)
        found += panel(title, unit, curves)
    return found


def joints(runs: Sequence[Run]) -> list[Panel]:
    """Of each joint its position, with command and limits, and its speed."""
    found: list[Panel] = []
    first, alone = runs[0], len(runs) == 1
    for j, name in enumerate(first.joint_names):
        unit = first.joint_units[j] if first.joint_units else "rad"
        places: list[Curve] = []
        speeds: list[Curve] = []
        for number, run in enumerate(runs):
            if name not in run.joint_names:
                continue
            i, shown = run.joint_names.index(name), run.joint_time >= BEFORE
            label, time = "measured" if alone else run.name, run.joint_time[shown]
            places.append(Curve(label, time, run.measured[shown, i], number, number))
            speeds.append(Curve(label, time, run.measured_speed[shown, i], number, number))
            if alone:
                places.append(Curve("command", time, run.commanded[shown, i], shade=1, dashed=True))
        ends = [(side[j], text) for side, text in zip(first.limits, ("least", "greatest"),
                                                      strict=True) if len(side) > j]  # fmt: skip
        tops = [(sign * top, "limit") for top in first.speed[j : j + 1] for sign in (-1.0, 1.0)]
        found += panel(name, unit, places, lines=_near(ends))
        found += panel(f"{name}, speed", f"{unit}/s", speeds, lines=_near(tops))
    return found


def _near(lines: Iterable[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """Those that limit anything."""
    return tuple((float(value), text) for value, text in lines if abs(value) < UNLIMITED)


def conditioning(runs: Sequence[Run]) -> list[Panel]:
    """Condition numbers of L and L J, manipulability, and the factor of limits."""
    ratios = [
        _of_each(runs, name, lambda run, key=key: condition(getattr(run, key)))
        for name, key in (("L", "singular_L"), ("L J", "singular_LJ"))
    ]
    if len(runs) == 1:
        both = [replace(curve, shade=shade) for shade, (curve,) in enumerate(ratios)]
        found = panel("condition number", "", both, log=True)
    else:
        found = panel("condition number of L", "", ratios[0], log=True)
        found += panel("condition number of L J", "", ratios[1], log=True)
    for title, name, key in (("manipulability", "manipulability", "manipulability"),
                             ("factor by which limits slowed the task", "factor", "scale")):
        found += panel(title, "", _of_each(runs, name, lambda run, key=key: getattr(run, key)))
    return found


def timing(runs: Sequence[Run]) -> list[Panel]:
    """Intervals between images, delays, and the pace of simulated time."""
    found: list[Panel] = []
    alone = len(runs) == 1
    for title, unit, dots in (("interval between images", "ms", intervals),
                              ("delay", "ms", delays), ("real-time factor", "", paces)):
        found += panel(title, unit, [
            Curve(name if alone else run.name, time, values, number, i if alone else number,
                  dashed=not alone and i > 0)
            for number, run in enumerate(runs) if len(run.time) > 2
            for i, (name, time, values) in enumerate(dots(run))
        ])  # fmt: skip
    return found


def joined(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """Time and values, with a gap where nothing was measured for long."""
    return broken(curve.time, curve.values)
