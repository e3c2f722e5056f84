"""What a report shows over time: panels of curves, drawn by over_time and by the page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..metrics.metrics import condition_number, error_settled, settled
from ..recording.run import Run, normalize_errors

MAX_CURVES = 24  # of one panel; more cannot be told apart
MAX_FEATURES = 6  # that several runs are compared in, a panel each
SETTLING_BAND = 0.02
FLOOR = 1e-6  # of logarithmic axes, parts of the first value
UNLIMITED = 100.0  # rad or m beyond which a limit is none
# s, and median steps, after which a curve is not joined any more
MAX_GAP_TIME, MAX_GAP_PERIODS = 0.3, 5.0
MIN_POSE_ERROR = 1e-4  # mm and degrees of logarithmic axes
TIME_BEFORE_START = -0.1  # s before servoing begins, from which on joints are shown


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
    colour_index: int = 0
    dashed: bool = False
    is_pale: bool = False

    def insert_gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Time and values, with a NaN within each step that is long beside the others."""
        steps = np.diff(self.time)
        if not len(steps):
            return self.time, self.values
        at = np.flatnonzero(steps > max(MAX_GAP_TIME, MAX_GAP_PERIODS * float(np.median(steps))))
        middles = self.time[at] + 0.5 * steps[at]
        return np.insert(self.time, at + 1, middles), np.insert(self.values, at + 1, np.nan)


Texts = tuple[tuple[float, str], ...]  # values, each with what it is


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over time that share an axis.

    Attributes:
        title: what they are, without their unit. axis: the same in a word or two, for a figure.
        unit: of the values. log: whether the axis is logarithmic. dots: no line joins the values.
        dashed: what the dashed curves are, in words.
        band: half of a band about 0 that counts as reached.
        levels: values to compare with. limits: values that must not be passed. marks: instants, s.
        span: least and greatest value that the axis shows at any rate; None: its curves' own.
        left_out: how many curves more there are.
    """

    title: str
    axis: str
    unit: str
    curves: tuple[Curve, ...]
    is_logarithmic: bool = False
    is_dotted: bool = False
    dashed: str = ""
    band: float | None = None
    levels: Texts = ()
    limits: Texts = ()
    marks: Texts = ()
    span: tuple[float | None, float | None] = (None, None)
    omitted_curves: int = 0


def make_panel(
    title: str, axis: str, unit: str, curves: Iterable[Curve], **more: object
) -> list[Panel]:
    """A panel of the curves that have values, of too many those that change most; none of none."""
    known = [curve for curve in curves if np.isfinite(curve.values).any()]
    if not known:
        return []
    kept = known
    if len(known) > MAX_CURVES:
        changes = [-float(np.nanmax(c.values) - np.nanmin(c.values)) for c in known]
        kept = [known[i] for i in sorted(np.argsort(changes, kind="stable")[:MAX_CURVES])]
    return [Panel(title, axis, unit, tuple(kept), omitted_curves=len(known) - len(kept), **more)]


def group_by_unit(run: Run) -> list[tuple[str, list[int]]]:
    """Features that share an axis, those of one unit: (unit, indexes)."""
    groups: dict[str, list[int]] = {}
    for index, unit in enumerate(run.units):
        groups.setdefault(unit, []).append(index)
    return list(groups.items())


def _make_curves(
    run: Run, names: Sequence[str], table: np.ndarray, members: Iterable[int], more: str = "",
    **look: bool,
) -> list[Curve]:  # fmt: skip
    """Curves of these columns of an array (n, k) at the images; `more`: behind their names."""
    return [Curve(names[i] + more, run.time, table[:, i], colour_index=shade, **look)
            for shade, i in enumerate(members)]  # fmt: skip


def _make_run_curves(
    runs: Sequence[Run], what: str, values: Callable[[Run], np.ndarray],
    time: Callable[[Run], np.ndarray] = lambda run: run.time,
) -> list[Curve]:  # fmt: skip
    """A curve a run; that of a single run has the name of `what` it is."""
    return [Curve(run.name if len(runs) > 1 else what, time(run), values(run), number, number)
            for number, run in enumerate(runs)]  # fmt: skip


def make_error_panels(runs: Sequence[Run]) -> list[Panel]:
    """s - s*: of one run a panel a unit, of several a panel a feature; and their norm."""
    found: list[Panel] = []
    run = runs[0]
    if len(runs) == 1:
        smoothed = not np.allclose(run.filtered_error, run.error, equal_nan=True)
        for unit, members in group_by_unit(run):
            bounds = {run.tolerances[i] for i in members} if run.tolerances else set()
            measured = _make_curves(run, run.names, run.error, members,
                                " as measured" if smoothed else "", is_pale=smoothed)  # fmt: skip
            filtered = _make_curves(run, run.names, run.filtered_error, members) if smoothed else []
            found += make_panel("error", "error", unit, filtered + measured,
                           band=min(bounds) if len(bounds) == 1 else None)  # fmt: skip
    elif len(run.names) <= MAX_FEATURES and all(r.names == run.names for r in runs):
        for i, name in enumerate(run.names):
            found += make_panel(f"error of {name}", name, run.units[i],
                           _make_run_curves(runs, name, lambda r, i=i: r.error[:, i]))  # fmt: skip
    return found + make_panel(
        "norm of the errors, relative", "norm, relative", "",
        _make_run_curves(runs, "norm, relative", _compute_error_norm), is_logarithmic=True,
        levels=((SETTLING_BAND, "2 %"),),
        marks=_mark_settling(runs, error_settled.measure),
    )  # fmt: skip


def _compute_error_norm(run: Run) -> np.ndarray:
    """(n,) of the errors, each in parts of its largest, in parts of the first."""
    size = np.linalg.norm(normalize_errors(run.error), axis=1)
    known = size[np.isfinite(size)]
    return np.maximum(size / ((known[0] if known.size else 1.0) or 1.0), FLOOR)


def _mark_settling(
    runs: Sequence[Run], when: Callable[[Run], float]
) -> tuple[tuple[float, str], ...]:
    """The mark of a single run that settles."""
    time = when(runs[0]) if len(runs) == 1 else np.nan
    return ((float(time), "settled"),) if np.isfinite(time) else ()


def make_pose_panels(runs: Sequence[Run]) -> list[Panel]:
    """Distance and angle of the true camera from its goal."""
    ways = {id(run): run.pose_error_history() for run in runs}
    found: list[Panel] = []
    for k, (title, unit, factor) in enumerate((("distance", "mm", 1e3),
                                               ("angle", "degrees", 180.0 / np.pi))):
        def compute_remaining(run: Run, k: int = k, factor: float = factor) -> np.ndarray:
            return np.maximum(factor * ways[id(run)][k][run.servoing], MIN_POSE_ERROR)

        curves = _make_run_curves(
            runs, title, compute_remaining, lambda run: run.joint_time[run.servoing]
        )
        found += make_panel(f"{title} to the goal", title, unit, curves, is_logarithmic=True,
                       marks=() if k else _mark_settling(runs, settled.measure))  # fmt: skip
    return found


def make_feature_panels(runs: Sequence[Run]) -> list[Panel]:
    """s and s* of one run, a panel a unit."""
    run = runs[0]
    found: list[Panel] = []
    for unit, members in group_by_unit(run) if len(runs) == 1 else ():
        wanted = _make_curves(run, run.names, run.desired_features, members, "*", dashed=True)
        measured = _make_curves(run, run.names, run.features, members)
        found += make_panel("feature", "feature", unit, measured + wanted, dashed="desired s*")
    return found


def make_twist_panels(runs: Sequence[Run]) -> list[Panel]:
    """Of one run asked and achieved by axis, of several the achieved speed."""
    found: list[Panel] = []
    several = len(runs) > 1
    for title, letter, part, unit in (("velocity of the camera", "v", slice(0, 3), "m/s"),
                                      ("turning of the camera", "ω", slice(3, 6), "rad/s")):
        if several:
            curves = _make_run_curves(
                runs, letter, lambda r, part=part: np.linalg.norm(r.achieved_twist[:, part], axis=1)
            )
        else:
            names, run = [f"{letter}{axis}" for axis in "xyz"], runs[0]
            curves = _make_curves(run, names, run.achieved_twist[:, part], range(3))
            curves += _make_curves(
                run, names, run.desired_twist[:, part], range(3), " asked", dashed=True
            )
        found += make_panel(
            title, f"|{letter}|" if several else letter, unit, curves, dashed="asked"
        )
    return found


def make_joint_panels(runs: Sequence[Run]) -> list[Panel]:
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
            i, shown = run.joint_names.index(name), run.joint_time >= TIME_BEFORE_START
            label, time = "measured" if alone else run.name, run.joint_time[shown]
            places.append(Curve(label, time, run.measured_positions[shown, i], number, number))
            speeds.append(Curve(label, time, run.measured_velocities[shown, i], number, number))
            if alone:
                places.append(
                    Curve(
                        "command", time, run.joint_commands[shown, i], colour_index=1, dashed=True
                    )
                )
        ends = [(side[j], text) for side, text in zip(first.position_limits, ("least", "greatest"),
                                                      strict=True) if len(side) > j]  # fmt: skip
        tops = [
            (sign * top, "limit") for top in first.speed_limits[j : j + 1] for sign in (-1.0, 1.0)
        ]
        found += make_panel(name, name, unit, places, limits=_select_limits(ends), dashed="command")
        found += make_panel(f"{name}, speed", "", f"{unit}/s", speeds, limits=_select_limits(tops))
    return found


def _select_limits(lines: Iterable[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """Those that limit anything."""
    return tuple((float(value), text) for value, text in lines if abs(value) < UNLIMITED)


def make_conditioning_panels(runs: Sequence[Run]) -> list[Panel]:
    """Condition numbers of L and L J, manipulability, and the factor of limits."""
    ratios = [
        _make_run_curves(runs, name, lambda run, key=key: condition_number(getattr(run, key)))
        for name, key in (("L", "singular_L"), ("L J", "singular_LJ"))
    ]
    if len(runs) == 1:
        both = [replace(curve, colour_index=shade) for shade, (curve,) in enumerate(ratios)]
        found = make_panel("condition number", "condition", "", both, is_logarithmic=True)
    else:
        found = make_panel("condition number of L", "condition of L", "", ratios[0], is_logarithmic=True)
        found += make_panel("condition number of L J", "condition of L J", "", ratios[1], is_logarithmic=True)
    for title, name, key, span in (
        ("manipulability", "manipulability", "manipulability", (None, None)),
        ("factor by which limits slowed the task", "scale", "scale", (-0.05, 1.1)),
    ):  # fmt: skip
        curves = _make_run_curves(runs, name, lambda run, key=key: getattr(run, key))
        found += make_panel(title, name, "", curves, span=span)
    return found


def make_timing_panels(runs: Sequence[Run]) -> list[Panel]:
    """Intervals between images, delays, and the pace of simulated time, as far as recorded.

    What one run has in one panel has a panel each where several runs are compared.
    """
    found: list[Panel] = []
    end = find_last_time(runs)
    for title, axis, unit, of, dots in (
        ("interval between images", "interval", "ms", _compute_intervals, True),
        ("delay", "delay", "ms", _compute_delays, True),
        ("real-time factor", "real-time factor", "", lambda run: _read_real_time_factors(run, end),
            False),
    ):  # fmt: skip
        own = [(number, one) for number, run in enumerate(runs) if len(run.time) > 2
               for one in of(run)]  # fmt: skip
        look = {"is_dotted": dots, "span": (0.0, None)}
        if len(runs) == 1:
            curves = [Curve(*one, colour_index=i) for i, (_, one) in enumerate(own)]
            found += make_panel(title, axis, unit, curves, **look)
            continue
        names = dict.fromkeys(name for _, (name, *_) in own)
        for name in names:
            curves = [Curve(runs[number].name, time, values, number, number)
                      for number, (kind, time, values) in own if kind == name]  # fmt: skip
            found += make_panel(f"{title}, {name}" if len(names) > 1 else title, axis, unit, curves,
                           **look)  # fmt: skip
    return found


def find_last_time(runs: Sequence[Run]) -> float:
    """Of the runs' images, s since servoing began."""
    return max([1e-3, *(float(run.time[-1]) for run in runs if len(run.time))])


Dots = list[tuple[str, np.ndarray, np.ndarray]]  # name, time, values


def _compute_intervals(run: Run) -> Dots:
    stamp = run.control_record.stamp if len(run.control_record.stamp) > 2 else run.stamp
    time = stamp[1:] - run.start_stamp
    return [("interval", time[time >= 0.0], 1e3 * np.diff(stamp)[time >= 0.0])]


def _compute_delays(run: Run) -> Dots:
    images, found = run.control_record, []
    shown = images.stamp >= run.start_stamp
    if np.any(images.arrival != images.stamp):
        delay = 1e3 * (images.arrival - images.stamp)
        found.append(("exposure to recorder", images.stamp[shown] - run.start_stamp, delay[shown]))
    if np.isfinite(run.computation_time).any():
        found.append(("scheme computing", run.time, 1e3 * run.computation_time))
    return found


def _read_real_time_factors(run: Run, end: float) -> Dots:
    if not len(run.real_time_factors):
        return []
    stamp, factor = run.real_time_factors.T
    time = stamp - run.start_stamp
    shown = (time >= 0.0) & (time <= end) & np.isfinite(factor)
    return [("real-time factor", time[shown], factor[shown])] if shown.any() else []
