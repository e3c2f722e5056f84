"""When the rows of a picture are exposed: all at once, or one after the other."""

from __future__ import annotations

from dataclasses import dataclass

from .effects import Effects


@dataclass(frozen=True)
class RowBand:
    """Rows first ... last - 1 of a picture, seen at one instant: offset_ns after the stamp."""

    offset_ns: int
    first: int
    last: int


def make_row_bands(effects: Effects, height: int) -> tuple[RowBand, ...]:
    """What a picture of `height` rows is put together from, in the order of time.

    Row r is exposed for exposure_time about stamp + (r - (height - 1) / 2) row_time: the stamp is
    the middle of the exposure of the picture's middle. exposure_samples instants stand for an
    exposure, and the middle of rows_together rows for each of them.
    """
    e = effects
    samples = e.exposure_samples if e.exposure_time > 0.0 else 1
    opened = [e.exposure_time * ((n + 0.5) / samples - 0.5) for n in range(samples)]
    together = min(e.rows_together, height) if e.row_time > 0.0 else height
    found = []
    for first in range(0, height, together):
        last = min(first + together, height)
        read = e.row_time * (0.5 * (first + last - 1) - 0.5 * (height - 1))
        found += [RowBand(round(1e9 * (read + at)), first, last) for at in opened]
    return tuple(sorted(found, key=lambda part: part.offset_ns))


def compute_duration(effects: Effects, height: int) -> float:
    """From the first row's opening to the last row's closing, s, and one row_time."""
    return effects.exposure_time + effects.row_time * height
