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

from aras_visual_servo_base.names import nearest
from aras_visual_servo_base.setting_values import said
from aras_visual_servo_base.settings import parameter

from ...errors import StudyError
from ...numbers.metrics import success
from ...numbers.statistics import proportion
from .studies import END, STUDY, Snapshot

OPERATORS = ("=", "≠", "<", "≤", ">", "≥", "contains", "is known", "is not known")
MOST_ROWS, MOST_GROUPS = 200, 200  # of one answer
LISTED = 60  # values of a column that are offered to choose from
CELLS = 24  # different values that make as many rows of a map
BINS = 12  # rows of a map, of a number that takes more values
SHADES = 7  # classes of points; what is beyond them is one more
EXACT = 2**53  # greatest whole number that a script's numbers hold
WIDE = 100.0  # greatest over least number, from which on bins grow by a factor


@dataclass(frozen=True)
class Filter:
    """A condition on a column. value: a number or a text, as the column has."""

    column: str
    operator: str = parameter("=", choices=OPERATORS)
    value: float | str | bool | None = None


@dataclass(frozen=True)
class Chosen:
    """Which runs: those of the studies that meet all filters. studies: names; empty: all."""

    studies: tuple[str, ...] = ()
    filters: tuple[Filter, ...] = ()


@dataclass(frozen=True)
class RowsAsked(Chosen):
    """Runs in order of a column, `count` of them from `first` on."""

    sort: str = ""
    descending: bool = False
    first: int = parameter(0, least=0)
    count: int = parameter(50, least=1, most=MOST_ROWS)


@dataclass(frozen=True)
class GroupsAsked(Chosen):
    """Success and medians by each combination of the values of some columns."""

    by: tuple[str, ...] = ()
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class MapAsked(Chosen):
    """A field of cells. value: column whose median, of success its rate, is in each."""

    x: str = ""
    y: str = ""
    value: str = success.name


@dataclass(frozen=True)
class PointsAsked(Chosen):
    """A point a run. shade: column by which they are coloured, '' for none."""

    x: str = ""
    y: str = ""
    shade: str = ""


def plain(value: Any) -> Any:
    """As JSON may hold it."""
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if isinstance(value, int) and abs(value) > EXACT:
        return str(value)
    return value


def chosen_rows(look: Snapshot, asked: Chosen) -> np.ndarray:
    """(n,) rows of the table, in order.

    Raises:
        StudyError: a filter that cannot be.
    """
    table = look.table
    mask = np.ones(table.num_rows, bool)
    if asked.studies and STUDY in table.column_names:
        for name in asked.studies:
            look.study(name)
        mask &= _mask(pc.is_in(table[STUDY], pa.array(asked.studies, pa.string())))
    for one in asked.filters:
        mask &= _met(column_of(look, one.column), one)
    return np.flatnonzero(mask)


def column_of(look: Snapshot, name: str) -> pa.ChunkedArray:
    """A column; StudyError with the nearest name where there is none."""
    if name not in look.table.column_names:
        raise StudyError(f"no column {said(name)}: {nearest(name, look.table.column_names)}")
    return look.table[name]


def _mask(found: pa.ChunkedArray) -> np.ndarray:
    return pc.fill_null(found, False).to_numpy().astype(bool)


def _met(column: pa.ChunkedArray, one: Filter) -> np.ndarray:
    if one.operator == "contains":
        return _mask(pc.match_substring(_words(column), str(one.value), ignore_case=True))
    if one.operator.startswith("is"):
        known = _mask(pc.is_valid(column))
        if pa.types.is_floating(column.type):
            known &= ~_mask(pc.is_nan(column))
        if pa.types.is_string(column.type):
            known &= _mask(pc.not_equal(column, ""))
        return known if one.operator == "is known" else ~known
    if pa.types.is_string(column.type):
        value: Any = one.value if isinstance(one.value, str) else str(one.value)
    elif pa.types.is_boolean(column.type):
        value = one.value in (True, 1.0, "true", "True")
        if one.operator not in ("=", "≠"):
            raise StudyError(f"{one.column} is true or false: write = or ≠")
    else:
        try:
            value = float(one.value)
        except (TypeError, ValueError):
            raise StudyError(f"{one.column} holds numbers, and {said(one.value)} is none") from None
    compare = {"=": pc.equal, "≠": pc.not_equal, "<": pc.less, "≤": pc.less_equal,
               ">": pc.greater, "≥": pc.greater_equal}[one.operator]  # fmt: skip
    return _mask(compare(column, pa.scalar(value)))


def _words(column: pa.ChunkedArray) -> pa.ChunkedArray:
    return column if pa.types.is_string(column.type) else column.cast(pa.string())


def is_number(column: pa.ChunkedArray) -> bool:
    """Whether a column has an order and a size."""
    return pa.types.is_integer(column.type) or pa.types.is_floating(column.type)


# -- columns, rows, one run -----------------------------------------------------------------------


def columns(look: Snapshot) -> list[dict[str, Any]]:
    """What there is: name, unit, role, kind, how many values and how many rows have one; and the
    values of those that take few."""
    found = []
    for name in look.table.column_names:
        column = look.table[name]
        values = pc.unique(column)
        few = len(values) <= LISTED
        kind = "number" if is_number(column) else "word"
        listed = [plain(v) for v in values.to_pylist() if plain(v) is not None] if few else []
        found.append({
            "name": name, "unit": look.units.get(name, ""), "role": look.roles.get(name, ""),
            "kind": kind, "count": len(values),
            "known": len(column) - column.null_count,
            "values": sorted(listed, key=lambda v: (isinstance(v, str), v)),
        })  # fmt: skip
    return found


def some_rows(look: Snapshot, asked: RowsAsked) -> dict[str, Any]:
    """How many are chosen, how many of them succeeded, and some of them with all columns."""
    at = chosen_rows(look, asked)
    total = len(at)
    if total == 0:
        return {"total": 0, "succeeded": 0, "rows": []}
    succeeded = int(np.nansum(look.table[success.name].to_numpy()[at]))
    if asked.sort:
        order = "descending" if asked.descending else "ascending"
        keys = pa.table({"key": column_of(look, asked.sort).take(pa.array(at))})
        at = at[pc.sort_indices(keys, sort_keys=[("key", order)]).to_numpy()]
    part = look.table.take(pa.array(at[asked.first : asked.first + asked.count]))
    return {"total": total, "succeeded": succeeded, "rows": _listed(part)}


def _listed(table: pa.Table) -> list[list[Any]]:
    return [[plain(v) for v in row.values()] for row in table.to_pylist()]


def run_row(look: Snapshot, study: str, run: int) -> dict[str, Any]:
    """All that was kept of a run, by column; StudyError where it was not run."""
    seen = look.study(study)
    table = look.table
    if seen.results is not None:
        mask = pc.and_(pc.equal(table[STUDY], study), pc.equal(table["run"], run))
        kept = table.filter(mask).slice(0, 1).to_pylist()
        if kept:
            own = {STUDY, END, success.name, *seen.results.table.column_names}
            return {name: plain(value) for name, value in kept[0].items() if name in own}
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
    def left(self) -> int:
        """Rows in no cell."""
        return int((self.at < 0).sum())


def cells(column: pa.ChunkedArray, most: int = CELLS, bins: int = BINS) -> Cells:
    """A cell for each value, or of a number with many values for each range."""
    encoded = column.combine_chunks().dictionary_encode()
    codes = encoded.indices.fill_null(-1).to_numpy(zero_copy_only=False).astype(int)
    values = encoded.dictionary.to_pylist()
    known = [i for i, v in enumerate(values) if plain(v) is not None]
    if len(known) <= most or not is_number(column):
        if len(known) > most:  # the commonest of many words
            counts = np.bincount(codes[codes >= 0], minlength=len(values))
            known = sorted(known, key=lambda i: -counts[i])[:most]
        known.sort(key=lambda i: values[i])
        place = np.full(len(values) + 1, -1)  # the last for those that are null
        place[known] = np.arange(len(known))
        labels = [plain(values[i]) for i in known]
        return Cells(labels, [[("=", label)] for label in labels], place[codes])
    numbers = column.cast(pa.float64()).to_numpy()
    finite = np.isfinite(numbers)
    low, high = numbers[finite].min(), numbers[finite].max()
    if low > 0.0 and high / low > WIDE:
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


def medians(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
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


def numbers(look: Snapshot, name: str, at: np.ndarray) -> np.ndarray:
    """(n,) of a column that holds numbers; StudyError where it holds words."""
    column = column_of(look, name)
    if pa.types.is_string(column.type):
        raise StudyError(f"{name} holds words, not numbers")
    return column.cast(pa.float64()).to_numpy()[at]


def groups(look: Snapshot, asked: GroupsAsked) -> dict[str, Any]:
    """Of each group: its values, runs, success with Wilson's interval, medians, commonest failure.

    The largest are listed, as many as fit; `count` says how many there are.
    """
    at = chosen_rows(look, asked)
    cut = [cells(column_of(look, key).take(pa.array(at)), MOST_GROUPS) for key in asked.by]
    group = np.zeros(len(at), int)
    for one in cut:
        group = np.where((group < 0) | (one.at < 0), -1, group * max(len(one.labels), 1) + one.at)
    there, inside = np.unique(group, return_inverse=True)
    inside = np.where(group < 0, -1, inside)
    sizes = np.bincount(inside[inside >= 0], minlength=len(there))
    good = np.nan_to_num(numbers(look, success.name, at)) if len(at) else np.zeros(0)
    hits = np.bincount(inside[inside >= 0], good[inside >= 0], minlength=len(there))
    middle = [medians(numbers(look, name, at), inside, len(there)) for name in asked.values]
    failures = _failures(look, at, inside, good)
    listed = []
    shown = [i for i in range(len(there)) if sizes[i]][:MOST_GROUPS]
    for i in shown:
        rest, places = int(there[i]), []
        for one in reversed(cut):
            rest, place = divmod(rest, max(len(one.labels), 1))
            places.append(place)
        places.reverse()
        rate = proportion(int(hits[i]), int(sizes[i]))
        listed.append({
            "values": [one.labels[p] for one, p in zip(cut, places, strict=True)],
            "bounds": [[key, *bound] for key, one, p in zip(asked.by, cut, places, strict=True)
                       for bound in one.bounds[p]],
            "runs": int(sizes[i]), "rate": [plain(v) for v in (rate.value, rate.low, rate.high)],
            "medians": [plain(float(m[i])) for m in middle], "failure": failures.get(i, ""),
        })  # fmt: skip
    return {"count": int((sizes > 0).sum()), "groups": listed}


def _failures(
    look: Snapshot, at: np.ndarray, group: np.ndarray, good: np.ndarray
) -> dict[int, str]:
    """By group, how most of its runs without success ended, and how many; -1: in no group."""
    failed = good != 1.0
    if not failed.any():
        return {}
    ends = look.table[END].take(pa.array(at[failed]))
    counted = pa.table({"group": group[failed], "end": ends}).group_by(["group", "end"]).aggregate(
        [("end", "count")]
    )
    found: dict[int, tuple[int, str]] = {}
    for row in counted.to_pylist():
        found[row["group"]] = max(found.get(row["group"], (0, "")),
                                  (row["end_count"], row["end"] or "unknown"))  # fmt: skip
    return {key: f"{count} × {end}" for key, (count, end) in found.items()}


def success_map(look: Snapshot, asked: MapAsked) -> dict[str, Any]:
    """Cells by row and column: how many runs, and the rate of success or the median."""
    at = chosen_rows(look, asked)
    x, y = (cells(column_of(look, name).take(pa.array(at))) for name in (asked.x, asked.y))
    width, height = len(x.labels), len(y.labels)
    group = np.where((x.at < 0) | (y.at < 0), -1, y.at * width + x.at)
    count = width * height
    sizes = np.bincount(group[group >= 0], minlength=count)
    if asked.value == success.name:
        good = np.nan_to_num(numbers(look, success.name, at))
        hits = np.bincount(group[group >= 0], good[group >= 0], minlength=count)
        values = np.divide(hits, sizes, out=np.full(count, np.nan), where=sizes > 0)
    else:
        values = medians(numbers(look, asked.value, at), group, count)
    return {
        "x": {"labels": x.labels, "bounds": x.bounds},
        "y": {"labels": y.labels, "bounds": y.bounds},
        "runs": sizes.reshape(height, width).tolist(),
        "values": [[plain(v) for v in row] for row in values.reshape(height, width).tolist()],
        "left": int((group < 0).sum()),
    }  # fmt: skip


# -- points ---------------------------------------------------------------------------------------


def points(look: Snapshot, asked: PointsAsked) -> dict[str, Any]:
    """Places of all runs that have both numbers, their classes of colour, and which runs they are.

    Words have a place each, in the order of `labels`.
    """
    at = chosen_rows(look, asked)
    axes = [_axis(column_of(look, name).take(pa.array(at))) for name in (asked.x, asked.y)]
    known = np.isfinite(axes[0][0]) & np.isfinite(axes[1][0])
    at = at[known]
    shades, classes = np.zeros(len(at), np.uint8), []
    if asked.shade:
        cut = cells(column_of(look, asked.shade).take(pa.array(at)), SHADES, SHADES)
        shades = np.where(cut.at < 0, len(cut.labels), cut.at).astype(np.uint8)
        classes = cut.labels
    studies = [seen.name for seen in look.studies]
    named = pc.index_in(look.table[STUDY].take(pa.array(at)), pa.array(studies, pa.string()))
    return {
        "count": len(at), "left": int((~known).sum()), "classes": classes, "studies": studies,
        **{axis: {"values": _base64(values[known], "<f4"), "labels": labels}
           for axis, (values, labels) in zip("xy", axes, strict=True)},
        "shades": _base64(shades, "u1"), "study": _base64(named.to_numpy(), "<i4"),
        "run": _base64(look.table["run"].to_numpy()[at], "<i4"),
    }  # fmt: skip


def _axis(column: pa.ChunkedArray) -> tuple[np.ndarray, Sequence[Any]]:
    """(n,) numbers; of words the number of each, and the words."""
    if is_number(column):
        return column.cast(pa.float64()).to_numpy(), []
    cut = cells(column, LISTED)
    return np.where(cut.at < 0, np.nan, cut.at).astype(float), cut.labels


def _base64(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
