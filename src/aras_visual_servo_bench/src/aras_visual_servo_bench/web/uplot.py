"""Files of uPlot, the plotting library of the web pages.

uPlot (https://github.com/leeoniya/uPlot, MIT) is small (52 kB) and draws in milliseconds. The
Python package youplot contains its files. The hashes below are those of uplot 1.6.31 in npm.
"""

from __future__ import annotations

import hashlib
import importlib.util
from pathlib import Path

from ..errors import BenchError, make_missing_library_error

CARRIER_PACKAGE = "youplot"
SCRIPT = ("uplot.iife.min.js", "2d27e8ad3d228164525ce213f9dc716f39b4e3aee0cc773fb3491c96cf4921a2")
STYLE = ("uplot.min.css", "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04")
VERSION = "1.0.0"


def read_uplot(file: tuple[str, str]) -> str:
    """Return the text of a file of uPlot.

    file: SCRIPT or STYLE.

    Raises:
        BenchError: the file is missing or has a different hash.
    """
    name, digest = file
    found = importlib.util.find_spec(CARRIER_PACKAGE)  # locates the package without importing it
    if found is None or not found.submodule_search_locations:
        raise make_missing_library_error("uPlot, the plotting library of the pages,")
    path = Path(found.submodule_search_locations[0]) / "vendor" / name
    content = path.read_bytes() if path.is_file() else b""
    if hashlib.sha256(content).hexdigest() != digest:
        raise BenchError(
            f"{path} is missing or differs from the version of uPlot that the pages need; run: "
            f"pip install --force-reinstall {CARRIER_PACKAGE}=={VERSION}"
        )
    return content.decode()
