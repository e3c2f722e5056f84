"""What the page asks of the studies, and the answers: rows, groups, a map, points, one run.

Answers are plain values for JSON, where null is what is not known.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import format_value
from aras_visual_servo_base.settings import parameter

from ...errors import StudyError
from ...metrics.metrics import success
from ...metrics.statistics import proportion
from .studies import END, STUDY, Snapshot

OPERATORS = ("=", "≠", "<", "≤", ">", "≥", "contains", "is known", "is not known")
MAX_ROWS, MAX_GROUPS = 200, 200  # of one answer
MAX_LISTED_VALUES = 60  # values of a column that are offered to choose from
MAX_CELLS = 24  # different values that make as many rows of a map
BINS = 12  # rows of a map, of a number that takes more values
MAX_SHADES = 7  # classes of points; what is beyond them is one more
MAX_EXACT_INTEGER = 2**53  # greatest whole number that a script's numbers hold
WIDE_RATIO = 100.0  # greatest over least number, from which on bins grow by a factor


@dataclass(frozen=True)
class Filter:
    """A condition on a column. value: a number or a text, as the column has."""

    column: str
    operator: str = parameter("=", choices=OPERATORS)
    value: float | str | bool | None = None


@dataclass(frozen=True)
class RunSelection:
    """Which runs: those of the studies that meet all filters. studies: names; empty: all."""

    studies: tuple[str, ...] = ()
    filters: tuple[Filter, ...] = ()


@dataclass(frozen=True)
class RowQuery(RunSelection):
    """Runs in order of a column, `count` of them from `first` on."""

    sort: str = ""
    descending: bool = False
    first: int = parameter(0, least=0)
    count: int = parameter(50, least=1, most=MAX_ROWS)


@dataclass(frozen=True)
class GroupQuery(RunSelection):
    """Success and medians by each combination of the values of some columns."""

    by: tuple[str, ...] = ()
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class MapQuery(RunSelection):
    """A field of cells. value: column whose median, of success its rate, is in each."""

    x: str = ""
    y: str = ""
    value: str = success.name


@dataclass(frozen=True)
class PointQuery(RunSelection):
    """A point a run. shade: column by which they are coloured, '' for none."""

    x: str = ""
    y: str = ""
    shade: str = ""


def to_json_value(value: Any) -> Any:
    """As JSON may hold it."""
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if isinstance(value, int) and abs(value) > MAX_EXACT_INTEGER:
        return str(value)
    return value


def select_rows(snapshot: Snapshot, query: RunSelection) -> np.ndarray:
    """(n,) rows of the table, in order.

    Raises:
        StudyError: a filter that cannot be.
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


def find_column(snapshot: Snapshot, name: str) -> pa.ChunkedArray:
    """A column; StudyError with the nearest name where there is none."""
    if name not in snapshot.table.column_names:
        raise StudyError(
            f"no column {format_value(name)}: {suggest(name, snapshot.table.column_names)}"
        )
    return snapshot.table[name]


def _to_mask(values: pa.ChunkedArray) -> np.ndarray:
    return pc.fill_null(values, False).to_numpy().astype(bool)


def _apply_filter(column: pa.ChunkedArray, condition: Filter) -> np.ndarray:
    if condition.operator == "contains":
        return _to_mask(
            pc.match_substring(_to_text(column), str(condition.value), ignore_case=True)
        )
    if condition.operator.startswith("is"):
        known = _to_mask(pc.is_valid(column))
        if pa.types.is_floating(column.type):
            known &= ~_to_mask(pc.is_nan(column))
        if pa.types.is_string(column.type):
            known &= _to_mask(pc.not_equal(column, ""))
        return known if condition.operator == "is known" else ~known
    if pa.types.is_string(column.type):
        value: Any = condition.value if isinstance(condition.value, str) else str(condition.value)
    elif pa.types.is_boolean(column.type):
        value = condition.value in (True, 1.0, "true", "True")
        if condition.operator not in ("=", "≠"):
            raise StudyError(f"{condition.column} is true or false: write = or ≠")
    else:
        try:
            value = float(condition.value)
        except (TypeError, ValueError):
            raise StudyError(
                f"{condition.column} holds numbers, and {format_value(condition.value)} is none"
            ) from None
    compare = {"=": pc.equal, "≠": pc.not_equal, "<": pc.less, "≤": pc.less_equal,
               ">": pc.greater, "≥": pc.greater_equal}[condition.operator]  # fmt: skip
    return _to_mask(compare(column, pa.scalar(value)))


def _to_text(column: pa.ChunkedArray) -> pa.ChunkedArray:
    return column if pa.types.is_string(column.type) else column.cast(pa.string())


def is_number(column: pa.ChunkedArray) -> bool:
    """Whether a column has an order and a size."""
    return pa.types.is_integer(column.type) or pa.types.is_floating(column.type)


# -- columns, rows, one run -----------------------------------------------------------------------


def describe_columns(snapshot: Snapshot) -> list[dict[str, Any]]:
    """What there is: name, unit, role, kind, how many values and how many rows have one; and the
    values of those that take few."""
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
        found.append({
            "name": name, "unit": snapshot.units.get(name, ""),
            "role": snapshot.roles.get(name, ""),
            "kind": kind, "count": len(values),
            "known": len(column) - column.null_count,
            "values": sorted(listed, key=lambda v: (isinstance(v, str), v)),
        })  # fmt: skip
    return found


def list_rows(snapshot: Snapshot, query: RowQuery) -> dict[str, Any]:
    """How many are chosen, how many of them succeeded, and some of them with all columns."""
    at = select_rows(snapshot, query)
    total = len(at)
    if total == 0:
        return {"total": 0, "succeeded": 0, "rows": []}
    succeeded = int(np.nansum(snapshot.table[success.name].to_numpy()[at]))
    if query.sort:
        order = "descending" if query.descending else "ascending"
        keys = pa.table({"key": find_column(snapshot, query.sort).take(pa.array(at))})
        at = at[pc.sort_indices(keys, sort_keys=[("key", order)]).to_numpy()]
    part = snapshot.table.take(pa.array(at[query.first : query.first + query.count]))
    return {"total": total, "succeeded": succeeded, "rows": _to_lists(part)}


def _to_lists(table: pa.Table) -> list[list[Any]]:
    return [[to_json_value(v) for v in row.values()] for row in table.to_pylist()]


def find_run_row(snapshot: Snapshot, study: str, run: int) -> dict[str, Any]:
    """All that was kept of a run, by column; StudyError where it was not run."""
    seen = snapshot.find_study(study)
    table = snapshot.table
    if seen.results is not None:
        mask = pc.and_(pc.equal(table[STUDY], study), pc.equal(table["run"], run))
        kept = table.filter(mask).slice(0, 1).to_pylist()
        if kept:
            own = {STUDY, END, success.name, *seen.results.table.column_names}
            return {name: to_json_value(value) for name, value in kept[0].items() if name in own}
    raise StudyError(f"{study} has no run {run} yet")


# -- groups and maps ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cells:
    """A column cut into cells.

    labels: of each. bounds: of each, filters that choose its runs. at: (n,) cell of each row, -1
    for none. left: rows in no cell.
    """

    labels: list[Any]
    bounds: list[list[tuple[str, Any]]]
    at: np.ndarray

    @property
    def uncounted_rows(self) -> int:
        """Rows in no cell."""
        return int((self.at < 0).sum())


def divide_into_cells(
    column: pa.ChunkedArray, max_cells: int = MAX_CELLS, bins: int = BINS
) -> Cells:
    """A cell for each value, or of a number with many values for each range."""
    encoded = column.combine_chunks().dictionary_encode()
    codes = encoded.indices.fill_null(-1).to_numpy(zero_copy_only=False).astype(int)
    values = encoded.dictionary.to_pylist()
    known = [i for i, v in enumerate(values) if to_json_value(v) is not None]
    if len(known) <= max_cells or not is_number(column):
        if len(known) > max_cells:  # the commonest of many words
            counts = np.bincount(codes[codes >= 0], minlength=len(values))
            known = sorted(known, key=lambda i: -counts[i])[:max_cells]
        known.sort(key=lambda i: values[i])
        place = np.full(len(values) + 1, -1)  # the last for those that are null
        place[known] = np.arange(len(known))
        labels = [to_json_value(values[i]) for i in known]
        return Cells(labels, [[("=", label)] for label in labels], place[codes])
    numbers = column.cast(pa.float64()).to_numpy()
    finite = np.isfinite(numbers)
    low, high = numbers[finite].min(), numbers[finite].max()
    if low > 0.0 and high / low > WIDE_RATIO:
        edges = np.geomspace(low, high, bins + 1)
    else:
        edges = np.linspace(low, high, bins + 1)
    edges[0], edges[-1] = low, high
    at = np.full(len(numbers), -1)
    at[finite] = np.clip(np.searchsorted(edges, numbers[finite], side="right") - 1, 0, bins - 1)
    ranges = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    bounds = [[("≥", a), ("<", b)] for a, b in ranges[:-1]]
    bounds.append([("≥", ranges[-1][0]), ("≤", ranges[-1][1])])
    return Cells([list(pair) for pair in ranges], bounds, at)


def compute_medians(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """(count,) of the finite values of each group; NaN where there is none."""
    known = np.isfinite(values) & (group >= 0)
    values, group = values[known], group[known]
    order = np.lexsort((values, group))
    values = values[order]
    sizes = np.bincount(group, minlength=count)
    first = np.cumsum(sizes) - sizes
    found = np.full(count, np.nan)
    there = sizes > 0
    low = first[there] + (sizes[there] - 1) // 2
    high = first[there] + sizes[there] // 2
    found[there] = 0.5 * (values[low] + values[high])
    return found


def read_numbers(snapshot: Snapshot, name: str, at: np.ndarray) -> np.ndarray:
    """(n,) of a column that holds numbers; StudyError where it holds words."""
    column = find_column(snapshot, name)
    if pa.types.is_string(column.type):
        raise StudyError(f"{name} holds words, not numbers")
    return column.cast(pa.float64()).to_numpy()[at]


def compute_groups(snapshot: Snapshot, query: GroupQuery) -> dict[str, Any]:
    """Of each group: its values, runs, success with Wilson's interval, medians, commonest failure.

    The largest are listed, as many as fit; `count` says how many there are.
    """
    at = select_rows(snapshot, query)
    cut = [
        divide_into_cells(find_column(snapshot, key).take(pa.array(at)), MAX_GROUPS)
        for key in query.by
    ]
    group = np.zeros(len(at), int)
    for one in cut:
        group = np.where((group < 0) | (one.at < 0), -1, group * max(len(one.labels), 1) + one.at)
    there, inside = np.unique(group, return_inverse=True)
    inside = np.where(group < 0, -1, inside)
    sizes = np.bincount(inside[inside >= 0], minlength=len(there))
    good = np.nan_to_num(read_numbers(snapshot, success.name, at)) if len(at) else np.zeros(0)
    hits = np.bincount(inside[inside >= 0], good[inside >= 0], minlength=len(there))
    middle = [
        compute_medians(read_numbers(snapshot, name, at), inside, len(there))
        for name in query.values
    ]
    failures = _find_failures(snapshot, at, inside, good)
    listed = []
    shown = [i for i in range(len(there)) if sizes[i]][:MAX_GROUPS]
    for i in shown:
        rest, places = int(there[i]), []
        for one in reversed(cut):
            rest, place = divmod(rest, max(len(one.labels), 1))
            places.append(place)
        places.reverse()
        rate = proportion(int(hits[i]), int(sizes[i]))
        listed.append({
            "values": [one.labels[p] for one, p in zip(cut, places, strict=True)],
            "bounds": [[key, *bound] for key, one, p in zip(query.by, cut, places, strict=True)
                       for bound in one.bounds[p]],
            "runs": int(sizes[i]), "rate": [to_json_value(v)
                for v in (rate.value, rate.low, rate.high)],
            "medians": [to_json_value(float(m[i])) for m in middle], "failure": failures.get(i, ""),
        })  # fmt: skip
    return {"count": int((sizes > 0).sum()), "groups": listed}


def _find_failures(
    snapshot: Snapshot, at: np.ndarray, group: np.ndarray, good: np.ndarray
) -> dict[int, str]:
    """By group, how most of its runs without success ended, and how many; -1: in no group."""
    failed = good != 1.0
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


def compute_success_map(snapshot: Snapshot, query: MapQuery) -> dict[str, Any]:
    """Cells by row and column: how many runs, and the rate of success or the median."""
    at = select_rows(snapshot, query)
    x, y = (
        divide_into_cells(find_column(snapshot, name).take(pa.array(at)))
        for name in (query.x, query.y)
    )
    width, height = len(x.labels), len(y.labels)
    group = np.where((x.at < 0) | (y.at < 0), -1, y.at * width + x.at)
    count = width * height
    sizes = np.bincount(group[group >= 0], minlength=count)
    if query.value == success.name:
        good = np.nan_to_num(read_numbers(snapshot, success.name, at))
        hits = np.bincount(group[group >= 0], good[group >= 0], minlength=count)
        values = np.divide(hits, sizes, out=np.full(count, np.nan), where=sizes > 0)
    else:
        values = compute_medians(read_numbers(snapshot, query.value, at), group, count)
    return {
        "x": {"labels": x.labels, "bounds": x.bounds},
        "y": {"labels": y.labels, "bounds": y.bounds},
        "runs": sizes.reshape(height, width).tolist(),
        "values": [[to_json_value(v) for v in row]
            for row in values.reshape(height, width).tolist()],
        "left": int((group < 0).sum()),
    }  # fmt: skip


# -- points ---------------------------------------------------------------------------------------


def find_points(snapshot: Snapshot, query: PointQuery) -> dict[str, Any]:
    """Places of all runs that have both numbers, their classes of colour, and which runs they are.

    Words have a place each, in the order of `labels`.
    """
    at = select_rows(snapshot, query)
    axes = [
        _make_axis(find_column(snapshot, name).take(pa.array(at))) for name in (query.x, query.y)
    ]
    known = np.isfinite(axes[0][0]) & np.isfinite(axes[1][0])
    at = at[known]
    shades, classes = np.zeros(len(at), np.uint8), []
    if query.shade:
        cut = divide_into_cells(
            find_column(snapshot, query.shade).take(pa.array(at)), MAX_SHADES, MAX_SHADES
        )
        shades = np.where(cut.at < 0, len(cut.labels), cut.at).astype(np.uint8)
        classes = cut.labels
    studies = [seen.name for seen in snapshot.studies]
    named = pc.index_in(snapshot.table[STUDY].take(pa.array(at)), pa.array(studies, pa.string()))
    return {
        "count": len(at), "left": int((~known).sum()), "classes": classes, "studies": studies,
        **{axis: {"values": _encode_base64(values[known], "<f4"), "labels": labels}
           for axis, (values, labels) in zip("xy", axes, strict=True)},
        "shades": _encode_base64(shades, "u1"), "study": _encode_base64(named.to_numpy(), "<i4"),
        "run": _encode_base64(snapshot.table["run"].to_numpy()[at], "<i4"),
    }  # fmt: skip


def _make_axis(column: pa.ChunkedArray) -> tuple[np.ndarray, Sequence[Any]]:
    """(n,) numbers; of words the number of each, and the words."""
    if is_number(column):
        return column.cast(pa.float64()).to_numpy(), []
    cut = divide_into_cells(column, MAX_LISTED_VALUES)
    return np.where(cut.at < 0, np.nan, cut.at).astype(float), cut.labels


def _encode_base64(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
