"""Queries of the results browser: rows, groups, success map, points and single runs.

The answers can be encoded as JSON. Unknown values become null.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import scipy

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import format_value

from ...errors import StudyError
from ...metrics.formatting import choose_unit
from ...metrics.metrics import success
from ...metrics.statistics import Estimate, proportion
from .map_cells import divide_into_cells, is_number, to_json_value
from .queries import ColumnFilter, GroupQuery, MapQuery, PointQuery, RowQuery, RunSelection
from .studies import END, SETTING, STUDY, StudiesSnapshot

MAX_GROUPS = 200  # largest number of groups in the answer to one query of the page
# largest number of distinct values of a column up to which the page lists all of them
MAX_LISTED_VALUES = 60
# largest number of a column's values that have their own colour; all others share one colour
MAX_SHADES = 7


def select_rows(snapshot: StudiesSnapshot, query: RunSelection) -> np.ndarray:
    """Return the indices (n,) of the selected rows, in ascending order.

    Raises:
        StudyError: a filter or a study's name is invalid.
    """
    table = snapshot.table
    mask = np.ones(table.num_rows, bool)
    if query.studies and STUDY in table.column_names:
        for name in query.studies:
            snapshot.find_study(name)
        mask &= _to_mask(pc.is_in(table[STUDY], pa.array(query.studies, pa.string())))
    for one in query.filters:
        mask &= _apply_filter(find_column(snapshot, one.column), one)
    return np.flatnonzero(mask)


def find_column(snapshot: StudiesSnapshot, name: str) -> pa.ChunkedArray:
    """Return the column of the results with the name `name`.

    Raises:
        StudyError: the column does not exist; the message suggests the nearest name.
    """
    if name not in snapshot.table.column_names:
        raise StudyError(
            f"there is no column {format_value(name)}: "
            f"{suggest(name, snapshot.table.column_names)}"
        )
    return snapshot.table[name]


def _to_mask(values: pa.ChunkedArray) -> np.ndarray:
    return pc.fill_null(values, False).to_numpy().astype(bool)


def _apply_filter(column: pa.ChunkedArray, condition: ColumnFilter) -> np.ndarray:
    if condition.operator == "contains":
        return _to_mask(
            pc.match_substring(column.cast(pa.string()), str(condition.value), ignore_case=True)
        )
    if condition.operator.startswith("is"):
        is_known = _to_mask(pc.is_valid(column))
        if pa.types.is_floating(column.type):
            is_known &= ~_to_mask(pc.is_nan(column))
        if pa.types.is_string(column.type):
            is_known &= _to_mask(pc.not_equal(column, ""))
        return is_known if condition.operator == "is known" else ~is_known
    if pa.types.is_string(column.type):
        value: Any = condition.value if isinstance(condition.value, str) else str(condition.value)
    elif pa.types.is_boolean(column.type):
        value = condition.value in (True, 1.0, "true", "True")
        if condition.operator not in ("=", "≠"):
            raise StudyError(
                f"{condition.column} is true or false; use the operator = or ≠, not "
                f"{condition.operator}"
            )
    else:
        try:
            value = float(condition.value)
        except (TypeError, ValueError):
            raise StudyError(
                f"{condition.column} contains numbers, and {format_value(condition.value)} is not "
                "a number"
            ) from None
    compare = {"=": pc.equal, "≠": pc.not_equal, "<": pc.less, "≤": pc.less_equal,
               ">": pc.greater, "≥": pc.greater_equal}[condition.operator]  # fmt: skip
    return _to_mask(compare(column, pa.scalar(value)))


def describe_columns(snapshot: StudiesSnapshot) -> list[dict[str, Any]]:
    """Return a description of each column of the results.

    It contains the name, the role ('setting', 'metric' or 'run'), the kind ('number' or 'word'),
    the number of distinct values, and the number of known values. If there are few distinct values,
    `values` lists them. The page shows each value divided by `size`, in the unit `unit`, which
    suits the magnitude of the values. Settings have the unit in which they are given.
    """
    found = []
    for name in snapshot.table.column_names:
        column = snapshot.table[name]
        values = pc.unique(column)
        few = len(values) <= MAX_LISTED_VALUES
        kind = "number" if is_number(column) else "word"
        listed = (
            [to_json_value(v) for v in values.to_pylist() if to_json_value(v) is not None]
            if few
            else []
        )
        role = snapshot.roles.get(name, "")
        unit, size = snapshot.units.get(name, ""), 1.0
        if unit and kind == "number" and role != SETTING:
            unit, size = choose_unit(unit, column.cast(pa.float64()).to_numpy())
        found.append({
            "name": name, "unit": unit, "size": size, "role": role,
            "is_binary": name == success.name or name in snapshot.binary,
            "kind": kind, "count": len(values),
            "known_count": len(column) - column.null_count,
            "values": sorted(listed, key=lambda v: (isinstance(v, str), v)),
        })  # fmt: skip
    return found


def list_rows(snapshot: StudiesSnapshot, query: RowQuery) -> dict[str, Any]:
    """Return the number of selected runs, how many succeeded, and the requested rows."""
    at = select_rows(snapshot, query)
    total = len(at)
    if total == 0:
        return {"total": 0, "success_count": 0, "rows": []}
    success_count = int(np.nansum(snapshot.table[success.name].to_numpy()[at]))
    if query.sort:
        order = "descending" if query.descending else "ascending"
        values = find_column(snapshot, query.sort).take(pa.array(at))
        at = at[pc.sort_indices(values, sort_keys=[("", order)]).to_numpy()]
    part = snapshot.table.take(pa.array(at[query.first : query.first + query.count])).to_pylist()
    rows = [[to_json_value(value) for value in row.values()] for row in part]
    return {"total": total, "success_count": success_count, "rows": rows}


def find_run_row(snapshot: StudiesSnapshot, study: str, run: int) -> dict[str, Any]:
    """Return all stored values of a run, by the names of their columns.

    Raises:
        StudyError: the study or the run does not exist.
    """
    entry = snapshot.find_study(study)
    table = snapshot.table
    if entry.results is not None:
        mask = pc.and_(pc.equal(table[STUDY], study), pc.equal(table["run"], run))
        found = table.filter(mask).slice(0, 1).to_pylist()
        if found:
            own = {STUDY, END, success.name, *entry.results.table.column_names}
            return {name: to_json_value(value) for name, value in found[0].items() if name in own}
    raise StudyError(f"study {study} has no stored result of run {run} yet")


def compute_medians(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Return the median of the finite values in each group.

    Args:
        values: (n,) values.
        group: (n,) index of the group of each value; -1 for no group.
        count: number of groups.

    Returns:
        (count,) medians; NaN for a group without finite values.
    """
    is_valid = np.isfinite(values) & (group >= 0)
    medians = np.full(count, np.nan)
    if is_valid.any():
        known = np.unique(group[is_valid])
        medians[known] = scipy.ndimage.median(values[is_valid], group[is_valid], known)
    return medians


def read_numbers(snapshot: StudiesSnapshot, name: str, at: np.ndarray) -> np.ndarray:
    """Return the values (n,) of the numeric column `name` in the rows with the indices `at` (n,).

    Raises:
        StudyError: the column contains text.
    """
    column = find_column(snapshot, name)
    if pa.types.is_string(column.type):
        raise StudyError(f"column {name} contains text; choose a column with numbers")
    return column.cast(pa.float64()).to_numpy()[at]


def compute_rates(values: np.ndarray, group: np.ndarray, count: int) -> list[Estimate]:
    """Estimate the rate of 1 among the known values of each group, with Wilson's interval."""
    is_valid = np.isfinite(values) & (group >= 0)
    values, group = values[is_valid], group[is_valid]
    sizes = np.bincount(group, minlength=count)
    hits = np.bincount(group, values, minlength=count)
    return [proportion(int(h), int(size)) for h, size in zip(hits, sizes, strict=True)]


def _summarize_values(
    snapshot: StudiesSnapshot, name: str, at: np.ndarray, group: np.ndarray, count: int
) -> list[list[float]]:
    """Return, for each group, the median; or the rate of a binary metric with Wilson's interval."""
    values = read_numbers(snapshot, name, at)
    if name == success.name:
        values = np.nan_to_num(values)
    elif name in snapshot.binary:
        # a study that does not compute the metric has no value, so its runs are not failures
        studies = [entry.name for entry in snapshot.studies if entry.results is not None
                   and any(one.name == name for one in entry.results.metrics)]  # fmt: skip
        is_computed = pc.is_in(snapshot.table[STUDY], pa.array(studies, pa.string())).to_numpy()[at]
        values[is_computed] = snapshot.binary[name].complete_values(values[is_computed])
    else:
        return [[float(middle)] for middle in compute_medians(values, group, count)]
    return [[e.value, e.low, e.high] for e in compute_rates(values, group, count)]


def compute_groups(snapshot: StudiesSnapshot, query: GroupQuery) -> dict[str, Any]:
    """Return the groups of the selected runs.

    A group is described by the values of its columns, the number of its runs, the success rate with
    Wilson's interval, an estimate of each requested column, and the most frequent failure. An
    estimate is a list: the median; or, for a binary metric, the rate and the bounds of Wilson's
    interval. At most MAX_GROUPS groups are listed; `count` is the number of all groups.
    """
    at = select_rows(snapshot, query)
    cut = [
        divide_into_cells(find_column(snapshot, key).take(pa.array(at)), MAX_GROUPS)
        for key in query.by
    ]
    group = np.zeros(len(at), int)
    for one in cut:
        group = np.where((group < 0) | (one.at < 0), -1, group * max(len(one.labels), 1) + one.at)
    group_ids, index = np.unique(group, return_inverse=True)
    index = np.where(group < 0, -1, index)
    sizes = np.bincount(index[index >= 0], minlength=len(group_ids))
    successes = np.nan_to_num(read_numbers(snapshot, success.name, at)) if len(at) else np.zeros(0)
    rates = compute_rates(successes, index, len(group_ids))
    estimates = [
        _summarize_values(snapshot, name, at, index, len(group_ids)) for name in query.values
    ]
    failures = _find_failures(snapshot, at, index, successes)
    listed = []
    shown = [i for i in range(len(group_ids)) if sizes[i]][:MAX_GROUPS]
    for i in shown:
        rest, cells = int(group_ids[i]), []
        for one in reversed(cut):
            rest, cell = divmod(rest, max(len(one.labels), 1))
            cells.append(cell)
        cells.reverse()
        rate = rates[i]
        listed.append({
            "values": [one.labels[p] for one, p in zip(cut, cells, strict=True)],
            "bounds": [[key, *bound] for key, one, p in zip(query.by, cut, cells, strict=True)
                       for bound in one.bounds[p]],
            "runs": int(sizes[i]), "rate": [to_json_value(v)
                for v in (rate.value, rate.low, rate.high)],
            "estimates": [[to_json_value(v) for v in own[i]] for own in estimates],
            "failure": failures.get(i, ""),
        })  # fmt: skip
    return {"count": int((sizes > 0).sum()), "groups": listed}


def _find_failures(
    snapshot: StudiesSnapshot, at: np.ndarray, group: np.ndarray, successes: np.ndarray
) -> dict[int, str]:
    """Return a text with the most frequent outcome of the failed runs, and its count, by group.

    Args:
        snapshot: all studies.
        at: (n,) indices of the selected rows.
        group: (n,) index of the group of each row; -1 for no group.
        successes: (n,) 1 for a successful run.
    """
    failed = successes != 1.0
    if not failed.any():
        return {}
    ends = snapshot.table[END].take(pa.array(at[failed]))
    counted = pa.table({"group": group[failed], "end": ends}).group_by(["group", "end"]).aggregate(
        [("end", "count")]
    )
    found: dict[int, tuple[int, str]] = {}
    for row in counted.to_pylist():
        found[row["group"]] = max(found.get(row["group"], (0, "")),
                                  (row["end_count"], row["end"] or "unknown"))  # fmt: skip
    return {key: f"{count} × {end}" for key, (count, end) in found.items()}


def compute_success_map(snapshot: StudiesSnapshot, query: MapQuery) -> dict[str, Any]:
    """Return the number of runs, and the success rate or the median, in each cell of a map."""
    at = select_rows(snapshot, query)
    x, y = (
        divide_into_cells(find_column(snapshot, name).take(pa.array(at)))
        for name in (query.x, query.y)
    )
    width, height = len(x.labels), len(y.labels)
    group = np.where((x.at < 0) | (y.at < 0), -1, y.at * width + x.at)
    count = width * height
    sizes = np.bincount(group[group >= 0], minlength=count)
    summaries = _summarize_values(snapshot, query.value, at, group, count)
    values = np.array([first for first, *_ in summaries]).reshape(count)
    return {
        "x": {"labels": x.labels, "bounds": x.bounds},
        "y": {"labels": y.labels, "bounds": y.bounds},
        "runs": sizes.reshape(height, width).tolist(),
        "values": [[to_json_value(v) for v in row]
            for row in values.reshape(height, width).tolist()],
        "uncounted": int((group < 0).sum()),
    }  # fmt: skip


def find_points(snapshot: StudiesSnapshot, query: PointQuery) -> dict[str, Any]:
    """Return a point for each selected run whose values of x and y are known.

    A point has two coordinates, the index of its colour, and the study and number of its run. For a
    column of text, the coordinate is the index of the text in `labels`.
    """
    at = select_rows(snapshot, query)
    axes = [
        _make_axis(find_column(snapshot, name).take(pa.array(at))) for name in (query.x, query.y)
    ]
    has_both = np.isfinite(axes[0][0]) & np.isfinite(axes[1][0])
    at = at[has_both]
    colours, classes = np.zeros(len(at), np.uint8), []
    if query.colour_by:
        cut = divide_into_cells(
            find_column(snapshot, query.colour_by).take(pa.array(at)), MAX_SHADES, MAX_SHADES
        )
        colours = np.where(cut.at < 0, len(cut.labels), cut.at).astype(np.uint8)
        classes = cut.labels
    studies = [entry.name for entry in snapshot.studies]
    names = snapshot.table[STUDY].take(pa.array(at))
    study_index = pc.index_in(names, pa.array(studies, pa.string()))
    return {
        "count": len(at), "uncounted": int((~has_both).sum()),
        "classes": classes, "studies": studies,
        **{axis: {"values": _encode_base64(values[has_both], "<f4"), "labels": labels}
           for axis, (values, labels) in zip("xy", axes, strict=True)},
        "colours": _encode_base64(colours, "u1"),
        "study": _encode_base64(study_index.to_numpy(), "<i4"),
        "run": _encode_base64(snapshot.table["run"].to_numpy()[at], "<i4"),
    }  # fmt: skip


def _make_axis(column: pa.ChunkedArray) -> tuple[np.ndarray, Sequence[Any]]:
    """Return the coordinates (n,) of a column's n values, and the labels of a text column."""
    if is_number(column):
        return column.cast(pa.float64()).to_numpy(), []
    cut = divide_into_cells(column, MAX_LISTED_VALUES)
    return np.where(cut.at < 0, np.nan, cut.at).astype(float), cut.labels


def _encode_base64(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
