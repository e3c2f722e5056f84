"""Values of records in a form that can be compared bit by bit."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np


def values(thing: Any) -> Any:
    """Return the content of a record as nested tuples, which are equal if all bits are equal.

    Records are dataclasses, mappings, sequences, arrays and numbers in any nesting. Two NaN of the
    same bits are equal, 0.0 and -0.0 differ. Of a dataclass the public fields count.
    """
    if isinstance(thing, np.ndarray):
        return thing.dtype.str, thing.shape, thing.tobytes()
    if isinstance(thing, float | np.floating):
        return struct.pack("d", thing)
    if isinstance(thing, Mapping):
        return tuple((key, values(value)) for key, value in thing.items())
    if isinstance(thing, list | tuple):
        return type(thing).__name__, *map(values, thing)
    if dataclasses.is_dataclass(thing):
        fields = [f.name for f in dataclasses.fields(thing) if not f.name.startswith("_")]
        return type(thing).__name__, *((name, values(getattr(thing, name))) for name in fields)
    if thing is None or isinstance(thing, int | str | bytes | np.generic):
        return thing
    raise TypeError(f"{type(thing).__name__} is not a record: {thing!r}")
