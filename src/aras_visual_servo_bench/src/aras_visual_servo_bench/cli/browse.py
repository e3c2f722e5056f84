"""`bench browse DIR...` serves a web page that shows the runs of studies."""

from __future__ import annotations

import argparse
import os
import threading
import webbrowser
from typing import TYPE_CHECKING

from ..errors import BenchError, make_missing_library_error

# The library of the web server may be missing, so this import is not executed at run time.
if TYPE_CHECKING:
    from ..web.browse.server import BrowseServer


def browse(options: argparse.Namespace) -> int:
    """Serve the web page with the runs of studies until Ctrl-C."""
    try:
        from ..web.browse.server import serve
    except ModuleNotFoundError as error:
        raise make_missing_library_error(error.name, "page") from None
    if not 1 <= options.port <= 65535:
        raise BenchError(f"--port is {options.port}, must be 1 to 65535")
    print("reading the results ...", flush=True)
    server = serve(options.folders, options.address, options.port,
                   say=lambda text: print(text, flush=True))  # fmt: skip
    try:
        _print_start(server, options.no_open)
        threading.Event().wait()
    except KeyboardInterrupt:
        return 0
    finally:
        server.close()
    return 0


def _print_start(server: BrowseServer, is_quiet: bool) -> None:
    """Print the studies with their numbers of runs, and open a browser unless `is_quiet`."""
    found = server.studies.read_snapshot()
    lines = [f"{entry.name}: {entry.stored_run_count} of {entry.run_count} runs"
             + (f"; {entry.note}" if entry.note else "") for entry in found.studies]  # fmt: skip
    if not lines:
        lines.append("no studies yet: the page shows them as soon as they exist")
    if found.note:
        lines.append(found.note)
    if not is_quiet and not _open_browser(server.access.address):
        lines.append("cannot open a browser: open the address in a browser yourself")
    print(*lines, "press Ctrl-C to stop", sep="\n", flush=True)


def _open_browser(address: str) -> bool:
    """Open the web page in a graphical browser, not in a text browser; return whether this worked.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False
