"""Things made once for each key, of which only those used last are kept."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Recent(Generic[K, V]):
    """The `most` values that were asked for last."""

    def __init__(self, most: int, release: Callable[[V], None] = lambda _value: None) -> None:
        """release: called with each value that is dropped."""
        self._most = most
        self._release = release
        self._values: OrderedDict[K, V] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The value of a key, made if it is not there."""
        if key in self._values:
            self._values.move_to_end(key)
        else:
            self._values[key] = make()
            if len(self._values) > self._most:
                self._release(self._values.popitem(last=False)[1])
        return self._values[key]
