"""Panels of curves over time, which a report shows on its page and in its figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..metrics.metrics import condition_number, error_settled, settled
from ..recording.run import Run, normalize_errors

MAX_CURVES = 24  # per panel; a reader cannot distinguish more curves
MAX_FEATURES = 6  # with more features, runs are compared only by the norm of the errors
SETTLING_BAND = 0.02
FLOOR = 1e-6  # lower end of logarithmic axes, relative to the first value
UNLIMITED = 100.0  # rad or m; larger limits are ignored
# A curve is interrupted at time steps that exceed both limits (in s, and in median steps).
MAX_GAP_TIME, MAX_GAP_PERIODS = 0.3, 5.0
MIN_POSE_ERROR = 1e-4  # lower end of logarithmic axes, mm and degrees
TIME_BEFORE_START = -0.1  # s; joints are shown from this time relative to the start of servoing


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a panel.

    Attributes:
        name: name of the quantity or of the run.
        time: (n,) s since servoing started.
        values: (n,), NaN where unknown.
        run: index of the run.
        colour_index: index of the colour.
        dashed: True for a desired value, next to the achieved one.
        is_pale: True for a measured value, next to the filtered one.
    """

    name: str
    time: np.ndarray
    values: np.ndarray
    run: int = 0
    colour_index: int = 0
    dashed: bool = False
    is_pale: bool = False

    def insert_gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Return time and values with a NaN inside each step that is much longer than the others.
        """
        steps = np.diff(self.time)
        if not len(steps):
            return self.time, self.values
        indices = np.flatnonzero(
            steps > max(MAX_GAP_TIME, MAX_GAP_PERIODS * float(np.median(steps)))
        )
        middles = self.time[indices] + 0.5 * steps[indices]
        return np.insert(self.time, indices + 1, middles), np.insert(
            self.values, indices + 1, np.nan
        )


Texts = tuple[tuple[float, str], ...]  # values with their labels


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over time that share an axis.

    Attributes:
        title: title of the quantity, without its unit.
        axis: short label of the axis in figures.
        unit: unit of the values.
        curves: the curves.
        is_logarithmic: True for a logarithmic axis.
        is_dotted: True if the values are drawn as dots without lines.
        dashed: meaning of the dashed curves.
        band: half width of the band about 0 that counts as reached.
        levels: values for comparison.
        limits: values that must not be exceeded.
        marks: instants, s.
        span: lower and upper value that the axis includes at least; None for the curves' own.
        omitted_curves: number of curves that are not shown.
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
    """Return a panel of the curves that have values, or an empty list if there are none.

    Of more than MAX_CURVES curves, those with the largest range are shown.
    """
    known = [curve for curve in curves if np.isfinite(curve.values).any()]
    if not known:
        return []
    shown = known
    if len(known) > MAX_CURVES:
        changes = [-float(np.nanmax(c.values) - np.nanmin(c.values)) for c in known]
        shown = [known[i] for i in sorted(np.argsort(changes, kind="stable")[:MAX_CURVES])]
    return [Panel(title, axis, unit, tuple(shown), omitted_curves=len(known) - len(shown), **more)]


def group_by_unit(run: Run) -> list[tuple[str, list[int]]]:
    """Group the features that share an axis, as (unit, indices)."""
    groups: dict[str, list[int]] = {}
    for index, unit in enumerate(run.units):
        groups.setdefault(unit, []).append(index)
    return list(groups.items())


def _make_curves(
    run: Run, names: Sequence[str], table: np.ndarray, members: Iterable[int], more: str = "",
    **look: bool,
) -> list[Curve]:  # fmt: skip
    """Return curves of columns of an array (n, k) at the images; `more` is appended to their names.
    """
    return [Curve(names[i] + more, run.time, table[:, i], colour_index=shade, **look)
            for shade, i in enumerate(members)]  # fmt: skip


def _make_run_curves(
    runs: Sequence[Run], what: str, values: Callable[[Run], np.ndarray],
    time: Callable[[Run], np.ndarray] = lambda run: run.time,
) -> list[Curve]:  # fmt: skip
    """Return one curve per run; the curve of a single run is named after the quantity."""
    return [Curve(run.name if len(runs) > 1 else what, time(run), values(run), number, number)
            for number, run in enumerate(runs)]  # fmt: skip


def make_error_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the error s - s* and of its norm.

    A single run has a panel per unit; several runs have a panel per feature.
    """
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
    """Compute the norm (n,) of the normalised errors, relative to the first norm.

    Each error is divided by its largest value.
    """
    size = np.linalg.norm(normalize_errors(run.error), axis=1)
    known = size[np.isfinite(size)]
    return np.maximum(size / ((known[0] if known.size else 1.0) or 1.0), FLOOR)


def _mark_settling(
    runs: Sequence[Run], when: Callable[[Run], float]
) -> tuple[tuple[float, str], ...]:
    """Return a mark at the settling time if there is a single run that settles."""
    time = when(runs[0]) if len(runs) == 1 else np.nan
    return ((float(time), "settled"),) if np.isfinite(time) else ()


def make_pose_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the distance and angle between the true camera and its goal."""
    errors = {id(run): run.pose_error_history() for run in runs}
    found: list[Panel] = []
    for k, (title, unit, factor) in enumerate((("distance", "mm", 1e3),
                                               ("angle", "degrees", 180.0 / np.pi))):
        def compute_remaining(run: Run, k: int = k, factor: float = factor) -> np.ndarray:
            return np.maximum(factor * errors[id(run)][k][run.servoing], MIN_POSE_ERROR)

        curves = _make_run_curves(
            runs, title, compute_remaining, lambda run: run.joint_time[run.servoing]
        )
        found += make_panel(f"{title} to the goal", title, unit, curves, is_logarithmic=True,
                       marks=() if k else _mark_settling(runs, settled.measure))  # fmt: skip
    return found


def make_feature_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of s and s* of one run, one per unit."""
    run = runs[0]
    found: list[Panel] = []
    for unit, members in group_by_unit(run) if len(runs) == 1 else ():
        desired = _make_curves(run, run.names, run.desired_features, members, "*", dashed=True)
        measured = _make_curves(run, run.names, run.features, members)
        found += make_panel("feature", "feature", unit, measured + desired, dashed="desired s*")
    return found


def make_twist_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the camera's velocity.

    A single run has the desired and the achieved twist by axis; several runs have the achieved
    speed.
    """
    found: list[Panel] = []
    several = len(runs) > 1
    for title, letter, part, unit in (
        ("linear velocity of the camera", "v", slice(0, 3), "m/s"),
        ("angular velocity of the camera", "ω", slice(3, 6), "rad/s"),
    ):
        if several:
            curves = _make_run_curves(
                runs, letter, lambda r, part=part: np.linalg.norm(r.achieved_twist[:, part], axis=1)
            )
        else:
            names, run = [f"{letter}{axis}" for axis in "xyz"], runs[0]
            curves = _make_curves(run, names, run.achieved_twist[:, part], range(3))
            curves += _make_curves(
                run, names, run.desired_twist[:, part], range(3), " desired", dashed=True
            )
        found += make_panel(
            title, f"|{letter}|" if several else letter, unit, curves, dashed="desired"
        )
    return found


def make_joint_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of each joint's position, with command and limits, and of its speed."""
    found: list[Panel] = []
    first, is_single = runs[0], len(runs) == 1
    for j, name in enumerate(first.joint_names):
        unit = first.joint_units[j] if first.joint_units else "rad"
        positions: list[Curve] = []
        speeds: list[Curve] = []
        for number, run in enumerate(runs):
            if name not in run.joint_names:
                continue
            i, shown = run.joint_names.index(name), run.joint_time >= TIME_BEFORE_START
            label, time = "measured" if is_single else run.name, run.joint_time[shown]
            positions.append(Curve(label, time, run.measured_positions[shown, i], number, number))
            speeds.append(Curve(label, time, run.measured_velocities[shown, i], number, number))
            if is_single:
                positions.append(
                    Curve(
                        "command", time, run.joint_commands[shown, i], colour_index=1, dashed=True
                    )
                )
        ends = [(side[j], text) for side, text in zip(first.position_limits, ("least", "greatest"),
                                                      strict=True) if len(side) > j]  # fmt: skip
        tops = [
            (sign * top, "limit") for top in first.speed_limits[j : j + 1] for sign in (-1.0, 1.0)
        ]
        found += make_panel(
            name, name, unit, positions, limits=_select_limits(ends), dashed="command"
        )
        found += make_panel(f"{name}, speed", "", f"{unit}/s", speeds, limits=_select_limits(tops))
    return found


def _select_limits(lines: Iterable[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """Return the limits that are smaller than UNLIMITED."""
    return tuple((float(value), text) for value, text in lines if abs(value) < UNLIMITED)


def make_conditioning_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of condition numbers, manipulability and scale factor.

    The condition numbers are those of L and L J. The scale factor is that by which limits slow the
    task.
    """
    ratios = [
        _make_run_curves(runs, name, lambda run, key=key: condition_number(getattr(run, key)))
        for name, key in (("L", "singular_L"), ("L J", "singular_LJ"))
    ]
    if len(runs) == 1:
        both = [replace(curve, colour_index=shade) for shade, (curve,) in enumerate(ratios)]
        found = make_panel("condition number", "condition", "", both, is_logarithmic=True)
    else:
        found = [
            panel
            for name, curves in zip(("L", "L J"), ratios, strict=True)
            for panel in make_panel(
                f"condition number of {name}", f"condition of {name}", "", curves,
                is_logarithmic=True,
            )
        ]  # fmt: skip
    for title, name, key, span in (
        ("manipulability", "manipulability", "manipulability", (None, None)),
        ("factor by which limits slowed the task", "scale", "scale", (-0.05, 1.1)),
    ):  # fmt: skip
        curves = _make_run_curves(runs, name, lambda run, key=key: getattr(run, key))
        found += make_panel(title, name, "", curves, span=span)
    return found


def make_timing_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of image intervals, delays and the real-time factor, as far as recorded.

    If several runs are compared, each quantity has its own panel.
    """
    found: list[Panel] = []
    end = find_last_time(runs)
    for title, axis, unit, of, dots in (
        ("interval between images", "interval", "ms", _compute_intervals, True),
        ("delay", "delay", "ms", _compute_delays, True),
        ("real-time factor", "real-time factor", "", lambda run: _read_real_time_factors(run, end),
            False),
    ):  # fmt: skip
        series = [(number, data) for number, run in enumerate(runs) if len(run.time) > 2
               for data in of(run)]  # fmt: skip
        options = {"is_dotted": dots, "span": (0.0, None)}
        if len(runs) == 1:
            curves = [Curve(*data, colour_index=i) for i, (_, data) in enumerate(series)]
            found += make_panel(title, axis, unit, curves, **options)
            continue
        names = dict.fromkeys(name for _, (name, *_) in series)
        for name in names:
            curves = [Curve(runs[number].name, time, values, number, number)
                      for number, (kind, time, values) in series if kind == name]  # fmt: skip
            found += make_panel(f"{title}, {name}" if len(names) > 1 else title, axis, unit, curves,
                           **options)  # fmt: skip
    return found


def find_last_time(runs: Sequence[Run]) -> float:
    """Return the time of the last image of all runs, s since servoing started."""
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
