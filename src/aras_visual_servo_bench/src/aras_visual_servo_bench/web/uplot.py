"""uPlot, the library that draws a page's curves: found among the installed packages, and checked.

https://github.com/leeoniya/uPlot, MIT; 52 kB. Plotly's basic bundle has 1.1 MB, Vega-Lite with
what it needs 0.9 MB, and both take seconds for what uPlot draws in milliseconds. The package
youplot brings its files, of which the hashes are those of npm's uplot 1.6.31.
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
    """The text of SCRIPT or STYLE; BenchError where it is not there, or another."""
    name, wanted = file
    found = importlib.util.find_spec(CARRIER_PACKAGE)  # finds the package, runs nothing of it
    if found is None or not found.submodule_search_locations:
        raise make_missing_library_error("uPlot, which draws the page's curves,")
    path = Path(found.submodule_search_locations[0]) / "vendor" / name
    content = path.read_bytes() if path.is_file() else b""
    if hashlib.sha256(content).hexdigest() != wanted:
        raise BenchError(f"{path} is not the uPlot that the page is made for: pip install "
                         f"--force-reinstall {CARRIER_PACKAGE}=={VERSION}")  # fmt: skip
    return content.decode()
