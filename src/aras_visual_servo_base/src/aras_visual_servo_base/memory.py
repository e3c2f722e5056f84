"""A cache with limited memory, and the release of freed memory to the operating system."""

from __future__ import annotations

import ctypes
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class ByteLimitedCache(Generic[K, V]):
    """Thread-safe cache of the most recently used values.

    It keeps as many values as fit into the capacity, but at least one.
    """

    def __init__(
        self, capacity: int, size: Callable[[V], int] = lambda value: value.nbytes,
        drop: Callable[[V], None] = lambda value: None,
    ) -> None:
        """Create an empty cache.

        Args:
            capacity: largest total size of the values, bytes.
            size: function that returns the size of a value, bytes.
            drop: function that is called with each value that is removed. It is also called with a
                new value that is not stored, because another thread has just stored a value of the
                same key.
        """
        self._capacity, self._size, self._drop = capacity, size, drop
        self._values: OrderedDict[K, V] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Return the value of a key; call `make` to create it if it is not in the cache."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        made = make()
        with self._lock:
            # another thread may have added a value of the same key in the meantime
            value = self._values.setdefault(key, made)
            dropped = [] if value is made else [made]
            total = sum(map(self._size, self._values.values()))
            while len(self._values) > 1 and total > self._capacity:
                dropped.append(self._values.popitem(last=False)[1])
                total -= self._size(dropped[-1])
        for unused in dropped:
            self._drop(unused)
        return value

    def clear(self) -> None:
        """Remove all values."""
        with self._lock:
            removed, self._values = self._values, OrderedDict()
        for value in removed.values():
            self._drop(value)


def release_freed_memory() -> None:
    """Return the memory that this process has freed to the operating system.

    Without this call, the C library keeps freed blocks for later use. After 200 runs with different
    cameras and targets, a process has 30 to 50 MB of such blocks, which looks like a memory leak.
    The call takes about 1 ms. It has no effect if the C library is not glibc.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
