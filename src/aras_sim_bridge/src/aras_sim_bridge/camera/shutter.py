"""Times at which the rows of an image are exposed, for global and rolling shutters."""

from __future__ import annotations

from dataclasses import dataclass

from .effects import Effects


@dataclass(frozen=True)
class RowBand:
    """Rows first ... last - 1 of an image, which are exposed `offset_ns` after the stamp."""

    offset_ns: int
    first: int
    last: int


def make_row_bands(effects: Effects, height: int) -> tuple[RowBand, ...]:
    """Return the partial exposures of an image of `height` rows, in temporal order.

    A partial exposure is a band of rows, rendered for one instant. The rows are divided into bands
    of rows_together rows; with a row_time of 0, there is a single band. Each band has
    exposure_samples partial exposures, spread evenly over exposure_time. They are centred at the
    time stamp + (r - (height - 1) / 2) row_time, where r is the central row of the band.
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
    """Return the time that the camera needs for an image, s.

    It is exposure_time + height * row_time: the read-out of each row takes row_time.
    """
    return effects.exposure_time + effects.row_time * height
