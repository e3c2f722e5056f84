"""Panels of curves over time, for the report page and for the figures of a report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..metrics.condition_number import compute_condition_numbers
from ..metrics.metrics import error_settled, settled
from ..recording.run import SETTLING_BAND, Run, normalize_errors
from .panel import Curve, Panel, Texts, make_panel

# If runs have more features than this number, panels that compare them show only the norm of the
# errors; otherwise, they show the error of each feature.
MAX_FEATURES = 6
FLOOR = 1e-6  # lower end of the logarithmic axis of the error norm, relative to the initial norm
UNLIMITED = 100.0  # joint limit above which a joint counts as unlimited, rad or m
MIN_POSE_ERROR = 1e-4  # lower end of the logarithmic axes of the pose error, mm and degrees
# time at which the curves of the joints start, relative to the start of servoing, s
TIME_BEFORE_START = -0.1


def group_by_unit(run: Run) -> list[tuple[str, list[int]]]:
    """Group the features of a run by unit; return each unit with the indices of its features."""
    groups: dict[str, list[int]] = {}
    for index, unit in enumerate(run.units):
        groups.setdefault(unit, []).append(index)
    return list(groups.items())


def _make_curves(
    run: Run, names: Sequence[str], table: np.ndarray, members: Iterable[int], more: str = "",
    **look: bool,
) -> list[Curve]:  # fmt: skip
    """Return one curve for each of the selected columns of a table.

    Args:
        run: run whose images define the times.
        names: names of the columns.
        table: (n, k) values at the run's n images.
        members: indices of the selected columns.
        more: text that is appended to each name.
        look: other attributes of Curve, such as `dashed`.
    """
    return [Curve(names[i] + more, run.time, table[:, i], colour_index=shade, **look)
            for shade, i in enumerate(members)]  # fmt: skip


def _make_run_curves(
    runs: Sequence[Run], what: str, values: Callable[[Run], np.ndarray],
    time: Callable[[Run], np.ndarray] = lambda run: run.time,
) -> list[Curve]:  # fmt: skip
    """Return one curve for each run.

    Args:
        runs: one or several runs.
        what: name of the quantity, which is the name of the curve if there is one run. If there are
            several, each curve has the name of its run.
        values: function that returns the values (n,) of a run.
        time: function that returns the times (n,) of a run, s.
    """
    return [Curve(run.name if len(runs) > 1 else what, time(run), values(run), number, number)
            for number, run in enumerate(runs)]  # fmt: skip


def make_error_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the error s - s* and of its norm.

    A single run has one panel of errors for each unit. Several runs have one for each feature.
    There is no panel if no run has features.
    """
    if not any(run.names for run in runs):
        return []
    found: list[Panel] = []
    run = runs[0]
    if len(runs) == 1:
        smoothed = not np.allclose(run.filtered_error, run.error, equal_nan=True)
        for unit, members in group_by_unit(run):
            bounds = {run.tolerances[i] for i in members} if run.tolerances else set()
            ending = " as measured" if smoothed else ""
            curves = _make_curves(run, run.names, run.error, members, ending, is_pale=smoothed)
            if smoothed:
                curves = _make_curves(run, run.names, run.filtered_error, members) + curves
            band = min(bounds) if len(bounds) == 1 else None
            found += make_panel("error", "error", unit, curves, band=band)
    elif len(run.names) <= MAX_FEATURES and all(r.names == run.names for r in runs):
        for i, name in enumerate(run.names):
            curves = _make_run_curves(runs, name, lambda r, i=i: r.error[:, i])
            found += make_panel(f"error of {name}", name, run.units[i], curves)
    return found + make_panel(
        "norm of the errors, relative", "norm, relative", "",
        _make_run_curves(runs, "norm, relative", _compute_error_norm), is_logarithmic=True,
        levels=((SETTLING_BAND, "2 %"),),
        marks=_mark_settling(runs, error_settled.measure),
    )  # fmt: skip


def _compute_error_norm(run: Run) -> np.ndarray:
    """Compute the norm (n,) of the errors at each image, relative to its initial value.

    The error of each feature is divided by the maximum of its absolute value over all images. The
    initial value is the norm at the first image with a measurement.
    """
    size = np.linalg.norm(normalize_errors(run.error), axis=1)
    known = size[np.isfinite(size)]
    return np.maximum(size / ((known[0] if known.size else 1.0) or 1.0), FLOOR)


def _mark_settling(
    runs: Sequence[Run], when: Callable[[Run], float]
) -> Texts:
    """Return a mark at the settling time of a single run; return no mark for several runs.

    when: function that returns the settling time of a run, or NaN if the run does not settle.
    """
    time = when(runs[0]) if len(runs) == 1 else np.nan
    return ((float(time), "settled"),) if np.isfinite(time) else ()


def make_pose_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the distance and the angle between the camera's true pose and its goal."""
    errors = {id(run): run.pose_error_history() for run in runs}
    found: list[Panel] = []
    for k, (title, unit, factor) in enumerate((("distance", "mm", 1e3),
                                               ("angle", "degrees", 180.0 / np.pi))):
        def compute_remaining(run: Run, k: int = k, factor: float = factor) -> np.ndarray:
            return np.maximum(factor * errors[id(run)][k][run.servoing], MIN_POSE_ERROR)

        curves = _make_run_curves(
            runs, title, compute_remaining, lambda run: run.joint_time[run.servoing]
        )
        marks = () if k else _mark_settling(runs, settled.measure)
        found += make_panel(
            f"{title} to the goal", title, unit, curves, is_logarithmic=True, marks=marks
        )
    return found


def make_feature_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the measured and the desired features of a single run, one for each unit.

    For several runs, the result is empty.
    """
    run = runs[0]
    found: list[Panel] = []
    for unit, members in group_by_unit(run) if len(runs) == 1 else ():
        desired = _make_curves(run, run.names, run.desired_features, members, "*", dashed=True)
        measured = _make_curves(run, run.names, run.features, members)
        found += make_panel("feature", "feature", unit, measured + desired, dashed="desired s*")
    return found


def make_twist_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the camera's linear and angular velocity.

    For a single run, they contain the desired and the achieved velocity along each axis. For
    several runs, they contain the norm of the achieved velocity.
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
    """Return panels of the position and the velocity of each joint, with their limits.

    For a single run, the panels of the positions also contain the commands.
    """
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
            time = run.joint_time[shown]
            label = "measured" if is_single else run.name
            positions.append(Curve(label, time, run.measured_positions[shown, i], number, number))
            speeds.append(Curve(label, time, run.measured_velocities[shown, i], number, number))
            if is_single:
                positions.append(Curve("commanded position", time, run.joint_commands[shown, i],
                                       colour_index=1, dashed=True))  # fmt: skip
        ends = [(side[j], text) for side, text in zip(first.position_limits, ("least", "greatest"),
                                                      strict=True) if len(side) > j]  # fmt: skip
        tops = [
            (sign * top, "limit") for top in first.speed_limits[j : j + 1] for sign in (-1.0, 1.0)
        ]
        found += make_panel(
            name, name, unit, positions, limits=_select_limits(ends), dashed="commanded position"
        )
        found += make_panel(f"{name}, speed", "", f"{unit}/s", speeds, limits=_select_limits(tops))
    return found


def _select_limits(lines: Iterable[tuple[float, str]]) -> Texts:
    """Return the limits whose absolute value is smaller than UNLIMITED."""
    return tuple((float(value), text) for value, text in lines if abs(value) < UNLIMITED)


def make_conditioning_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the condition numbers of L and L J, the manipulability and the scale factor.

    The scale factor, 0 to 1, is the factor by which the loop reduces the desired twist because of
    speed and acceleration limits.
    """
    ratios = [
        _make_run_curves(
            runs, name, lambda run, key=key: compute_condition_numbers(getattr(run, key))
        )
        for name, key in (("L", "singular_L"), ("L J", "singular_LJ"))
    ]
    found: list[Panel] = []
    if len(runs) == 1:
        both = [replace(curve, colour_index=shade) for shade, (curve,) in enumerate(ratios)]
        found += make_panel("condition number", "condition", "", both, is_logarithmic=True)
    for name, curves in zip(("L", "L J"), ratios, strict=True) if len(runs) > 1 else ():
        found += make_panel(f"condition number of {name}", f"condition of {name}", "", curves,
                            is_logarithmic=True)  # fmt: skip
    for title, name, key, span in (
        ("manipulability", "manipulability", "manipulability", (None, None)),
        ("factor by which limits reduced the twist", "scale", "scale", (-0.05, 1.1)),
    ):  # fmt: skip
        curves = _make_run_curves(runs, name, lambda run, key=key: getattr(run, key))
        found += make_panel(title, name, "", curves, span=span)
    return found


def make_timing_panels(runs: Sequence[Run]) -> list[Panel]:
    """Return panels of the intervals between images, the delays and the real-time factor.

    A quantity that was not recorded has no panel. For several runs, each kind of delay has its own
    panel.
    """
    found: list[Panel] = []
    end = find_last_time(runs)
    for title, axis, unit, read, is_dotted in (
        ("interval between images", "interval", "ms", _compute_intervals, True),
        ("delay", "delay", "ms", _compute_delays, True),
        ("real-time factor", "real-time factor", "",
         lambda run: _read_real_time_factors(run, end), False),
    ):  # fmt: skip
        series = [(number, data) for number, run in enumerate(runs) if len(run.time) > 2
                  for data in read(run)]  # fmt: skip
        options = {"is_dotted": is_dotted, "span": (0.0, None)}
        if len(runs) == 1:
            curves = [Curve(*data, colour_index=i) for i, (_, data) in enumerate(series)]
            found += make_panel(title, axis, unit, curves, **options)
            continue
        names = dict.fromkeys(name for _, (name, *_) in series)
        for name in names:
            curves = [Curve(runs[number].name, time, values, number, number)
                      for number, (kind, time, values) in series if kind == name]  # fmt: skip
            own_title = f"{title}, {name}" if len(names) > 1 else title
            found += make_panel(own_title, axis, unit, curves, **options)
    return found


def find_last_time(runs: Sequence[Run]) -> float:
    """Return the time of the last image in any run, s since servoing started."""
    return max([1e-3, *(float(run.time[-1]) for run in runs if len(run.time))])


# series of a scatter plot: name, times (n,), values (n,)
Dots = list[tuple[str, np.ndarray, np.ndarray]]


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
