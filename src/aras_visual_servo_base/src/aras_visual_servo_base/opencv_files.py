"""Reader of OpenCV's FileStorage files, which contain numbers, texts and matrices."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SimError

LARGEST = 1000  # largest accepted number of elements of a matrix; calibrations have up to 27


def read_storage(text: str, path: str | Path, error: type[SimError]) -> dict[str, Any]:
    """Return the entries of a FileStorage by name.

    An entry is a number, a text, a list of numbers or a matrix (rows, cols). Matrices are decoded
    here, because OpenCV crashes with a memory error if a matrix contains more numbers than its size
    allows, or has no size.

    Raises:
        error: the file is invalid; the message names the file, the entry and what is expected.
    """
    import cv2

    try:
        store = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        nodes = {name: store.getNode(name) for name in store.root().keys()}  # noqa: SIM118
        return {name: _read_value(node, f"{path}: {name}", error) for name, node in nodes.items()}
    except (cv2.error, SystemError) as fault:
        words = " ".join(str(getattr(fault, "err", "") or fault).split())
        raise error(f"{path} cannot be read by OpenCV ({words}): check that the file is "
                    "complete") from None


def _read_value(node: Any, where: str, error: type[SimError]) -> Any:
    if node.isMap():
        return _read_matrix(node, where, error)
    if node.isInt() or node.isReal():
        return node.real()
    if node.isSeq() and (numbers := _read_numbers(node)):
        return numbers
    return node.string() if node.isString() else None


def _read_numbers(node: Any) -> list[float] | None:
    items = [node.at(i) for i in range(node.size())]
    if not all(item.isInt() or item.isReal() for item in items):
        return None
    return [item.real() for item in items]


def _read_matrix(node: Any, where: str, error: type[SimError]) -> np.ndarray | None:
    """Return the matrix (rows, cols) in a node of the file, or None if the node is not a matrix.

    A vector of n elements is returned as a column (n, 1).
    """
    keys = set(node.keys())
    if not keys & {"rows", "cols", "sizes", "dt", "data"}:
        return None
    shape = ("sizes",) if "sizes" in keys else ("rows", "cols")
    for key in (*shape, "dt", "data"):
        if key not in keys:
            raise error(f"{where} has no {key}, but needs {', '.join(shape)}, dt and data: check "
                        "that the file is complete")  # fmt: skip
    sizes = _read_numbers(node.getNode("sizes")) if "sizes" in keys else [
        node.getNode(key).real() for key in shape]  # fmt: skip
    kind = re.fullmatch(r"([1-4]?)[ucwsifdh]", node.getNode("dt").string())
    if not sizes or len(sizes) > 2 or kind is None or any(
        not 1 <= size <= LARGEST or size != int(size) for size in sizes
    ):
        given = " x ".join(f"{size:g}" for size in sizes or ()) or "missing"
        raise error(f"{where} has the size {given} and the data type (dt) "
                    f"'{node.getNode('dt').string()}', must have one or two sizes from 1 to "
                    f"{LARGEST} and a data type such as d: correct rows, cols or dt")  # fmt: skip
    data = node.getNode("data")
    if not data.isSeq() or data.size() > LARGEST or (numbers := _read_numbers(data)) is None:
        raise error(f"{where}: data must be a list of up to {LARGEST} numbers")
    rows, cols = int(sizes[0]), int(sizes[1]) if len(sizes) > 1 else 1
    width = cols * int(kind[1] or 1)
    if len(numbers) != rows * width:
        raise error(f"{where} has {len(numbers)} numbers, must have {rows} rows of {width}: "
                    "check that the file is complete")  # fmt: skip
    return np.reshape(numbers, (rows, width))
