"""Exposure times of the rows of an image, for global and rolling shutters."""

from __future__ import annotations

from dataclasses import dataclass

from .effects import Effects


@dataclass(frozen=True)
class RowBand:
    """Rows first ... last - 1 of an image, exposed together `offset_ns` after the stamp."""

    offset_ns: int
    first: int
    last: int


def make_row_bands(effects: Effects, height: int) -> tuple[RowBand, ...]:
    """Return the partial exposures of an image of `height` rows, in temporal order.

    Row r is exposed for exposure_time around stamp + (r - (height - 1) / 2) row_time, so the stamp
    is the middle of the exposure of the central row. An exposure is approximated by
    exposure_samples instants, and a group of rows_together rows by its central row.
    """
    e = effects
    samples = e.exposure_samples if e.exposure_time > 0.0 else 1
    offsets = [e.exposure_time * ((n + 0.5) / samples - 0.5) for n in range(samples)]
    band_rows = min(e.rows_together, height) if e.row_time > 0.0 else height
    found = []
    for first in range(0, height, band_rows):
        last = min(first + band_rows, height)
        row_offset = e.row_time * (0.5 * (first + last - 1) - 0.5 * (height - 1))
        found += [RowBand(round(1e9 * (row_offset + at)), first, last) for at in offsets]
    return tuple(sorted(found, key=lambda part: part.offset_ns))


def compute_duration(effects: Effects, height: int) -> float:
    """Return the time from the first row's opening to the last row's closing plus row_time, s."""
    return effects.exposure_time + effects.row_time * height
