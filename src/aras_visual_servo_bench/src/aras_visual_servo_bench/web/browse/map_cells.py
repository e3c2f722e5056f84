"""Cells into which the values of a column are divided for a map, and values as JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

# largest number of distinct values of a column for which each value has its own cell of a map
MAX_CELLS = 24
BINS = 12  # number of cells of a map for a numeric column with more than MAX_CELLS distinct values
MAX_EXACT_INTEGER = 2**53  # largest magnitude of integers that are exact in JavaScript
# ratio of a column's maximum to its minimum above which its cells have a logarithmic scale
WIDE_RATIO = 100.0


def to_json_value(value: Any) -> Any:
    """Convert a value for JSON: NaN to null; infinity and integers above 2^53 to text."""
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if isinstance(value, int) and abs(value) > MAX_EXACT_INTEGER:
        return str(value)
    return value


def is_number(column: pa.ChunkedArray) -> bool:
    """Return whether a column contains numbers."""
    return pa.types.is_integer(column.type) or pa.types.is_floating(column.type)


@dataclass(frozen=True)
class MapCells:
    """Cells (single values, or intervals) into which the values of a column are divided for a map.

    Attributes:
        labels: value of each cell, or its lower and upper bound.
        bounds: conditions (operator, value) that select the runs in each cell.
        at: (n,) index of the cell of each row; -1 if the row is in no cell.
    """

    labels: list[Any]
    bounds: list[list[tuple[str, Any]]]
    at: np.ndarray


def divide_into_cells(
    column: pa.ChunkedArray, max_cells: int = MAX_CELLS, bins: int = BINS
) -> MapCells:
    """Divide the values of a column into cells, each a single value or an interval.

    If there are at most `max_cells` distinct values, each value has its own cell. If there are
    more, the range of a numeric column is divided into `bins` cells, and only the most frequent
    values of a text column have cells.
    """
    encoded = column.combine_chunks().dictionary_encode()
    codes = encoded.indices.fill_null(-1).to_numpy(zero_copy_only=False).astype(int)
    values = encoded.dictionary.to_pylist()
    known = [i for i, v in enumerate(values) if to_json_value(v) is not None]
    if len(known) <= max_cells or not is_number(column):
        if len(known) > max_cells:  # only the most frequent values have their own cell
            counts = np.bincount(codes[codes >= 0], minlength=len(values))
            known = sorted(known, key=lambda i: -counts[i])[:max_cells]
        known.sort(key=lambda i: values[i])
        # the last element is the cell of unknown values, because their index is -1
        cell_of_value = np.full(len(values) + 1, -1)
        cell_of_value[known] = np.arange(len(known))
        labels = [to_json_value(values[i]) for i in known]
        return MapCells(labels, [[("=", label)] for label in labels], cell_of_value[codes])
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
    return MapCells([list(pair) for pair in ranges], bounds, at)
