"""`bench browse DIR...`: the runs of studies in a local page."""

from __future__ import annotations

import argparse
import os
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import BenchError, make_missing_library_error

if TYPE_CHECKING:  # the library that serves may be missing
    from ..web.browse.server import BrowseServer

PORT = 8090


def add_parser(commands: Any) -> None:
    """The command's own parser."""
    browse = commands.add_parser("browse", help="the runs of studies in a page: filter, plot, open")
    browse.add_argument("folders", nargs="+", type=Path, metavar="DIR",
                        help="of a study, or of many")
    browse.add_argument("--port", type=int, default=PORT, metavar="N",
                        help="%(default)s; the next free one where it is taken")
    browse.add_argument("--address", default="127.0.0.1", metavar="IP",
                        help="to listen on (%(default)s); 0.0.0.0 for other machines too")
    browse.add_argument("--no-open", action="store_true", help="do not open a browser")
    browse.set_defaults(carry_out=_browse)


def _browse(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
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
    """Say what is there, and open a browser."""
    found = server.studies.read_snapshot()
    lines = [f"{seen.name}: {seen.stored_run_count} of {seen.run_count} runs" + (f"; {seen.note}"
        if seen.note else "")
             for seen in found.studies]  # fmt: skip
    if not lines:
        lines.append("no studies there yet: they appear on the page as soon as there are")
    if found.note:
        lines.append(found.note)
    if not is_quiet and not _open_browser(server.access.address):
        lines.append("no browser could be opened here: open that address in one")
    print(*lines, "Ctrl-C ends it", sep="\n", flush=True)


def _open_browser(address: str) -> bool:
    """Whether a browser shows it; one within this terminal is none."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False
