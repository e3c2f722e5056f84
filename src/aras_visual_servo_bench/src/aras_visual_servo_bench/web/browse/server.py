"""The results browser's server: the page, its questions, and the reports of runs."""

from __future__ import annotations

import html
import json
import logging
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tornado.ioloop

from aras_visual_servo_base.settings import build, parameter

from ...errors import BenchError, RefusedError, StudyError
from ...pictures.palette import REPORT, REPORT_DARK, css
from ...study import compare
from .. import SHARED
from ..access import Access
from ..messages import read_message
from ..server import Guarded, WebServer, begin, is_local
from ..uplot import SCRIPT, STYLE, uplot
from . import queries
from .queries import GroupsAsked, MapAsked, PointsAsked, RowsAsked
from .reports import Reports
from .studies import Snapshot, Studies

FILES = Path(__file__).parent / "page"


@dataclass(frozen=True)
class RunAsked:
    """A run of a study."""

    study: str
    run: int = parameter(least=0)


@dataclass(frozen=True)
class CompareAsked:
    """Two studies. by: columns that make groups; empty: the settings that both have."""

    first: str
    second: str
    by: tuple[str, ...] = ()


@dataclass(frozen=True)
class StudiesAsked:
    """All studies. now: look at the folders at once."""

    now: bool = False


REQUESTS: Mapping[str, type] = {
    "studies": StudiesAsked, "rows": RowsAsked, "groups": GroupsAsked, "map": MapAsked,
    "points": PointsAsked, "run": RunAsked, "compare": CompareAsked,
}  # fmt: skip


class BrowseServer(WebServer):
    """The results browser's."""

    index = FILES / "index.html"
    compress = False  # megabytes of points, to this machine most often

    def __init__(
        self, studies: Studies, access: Access, sockets: list[socket.socket]
    ) -> None:
        """See WebServer; BenchError where the library that draws is not there."""
        super().__init__(access, sockets)
        self.studies, self.reports = studies, Reports()
        self._files = {
            "uplot.js": uplot(SCRIPT),
            "style.css": css(REPORT) + css(REPORT_DARK, "[data-theme=dark]") + uplot(STYLE)
            + (SHARED / "style.css").read_text(encoding="utf-8"),
            **{path.name: path.read_text(encoding="utf-8")
               for path in (*FILES.glob("*.js"), SHARED / "charts.js")},
        }  # fmt: skip

    def routes(self) -> list[tuple[str, type[Guarded]]]:
        """See WebServer."""
        return [(r"/ask", Questions), (r"/run", RunPage)]

    def page_file(self, name: str) -> str | None:
        """See WebServer."""
        return self._files.get(name)

    def ended(self) -> None:
        """See WebServer."""
        self.reports.close()

    def answer(self, text: str) -> dict[str, Any]:
        """To a question of the page; BenchError where it cannot be answered."""
        do, fields = read_message(text, REQUESTS, self.largest)
        asked = build(REQUESTS[do], fields, f"{do}: ", RefusedError)
        look = self.studies.look(isinstance(asked, StudiesAsked) and asked.now)
        return {"version": look.version, **_ANSWERS[do](look, asked)}


def _studies(look: Snapshot, asked: StudiesAsked) -> dict[str, Any]:
    return {
        "studies": [{"name": seen.name, "path": str(seen.path), "runs": seen.runs, "of": seen.of,
                     "note": seen.note} for seen in look.studies],
        "note": look.note,
        "columns": queries.columns(look),
        "operators": queries.OPERATORS,
    }  # fmt: skip


def _compared(look: Snapshot, asked: CompareAsked) -> dict[str, Any]:
    """Differences of two studies, the surest first."""
    first, second = (look.study(name) for name in (asked.first, asked.second))
    for seen in (first, second):
        if seen.results is None:
            raise StudyError(f"{seen.name} has no rows yet")
    found = compare.differences(first.results, second.results, asked.by)
    return {
        "level": compare.LEVEL,
        "differences": [
            {"group": d.group, "metric": d.metric, "verdict": d.verdict, "p": queries.plain(d.p),
             "before": queries.plain(d.found.before), "after": queries.plain(d.found.after),
             "count": d.found.count, "paired": d.found.paired}
            for d in sorted(found, key=lambda d: (d.verdict == compare.CHANCE, d.p))
        ],
    }  # fmt: skip


_ANSWERS: Mapping[str, Callable[[Snapshot, Any], dict[str, Any]]] = {
    "studies": _studies, "rows": queries.some_rows, "groups": queries.groups,
    "map": queries.success_map, "points": queries.points, "compare": _compared,
    "run": lambda look, asked: {"row": queries.run_row(look, asked.study, asked.run)},
}  # fmt: skip


class Questions(Guarded):
    """What the page asks, each a JSON object by POST."""

    async def post(self) -> None:
        loop, server = tornado.ioloop.IOLoop.current(), self.server
        text = self.request.body.decode(errors="replace")
        self.set_header("Content-Type", "application/json")
        try:
            answer = await loop.run_in_executor(server.workers, server.answer, text)
        except BenchError as error:
            self.set_status(400)
            answer = {"error": str(error)}
        except Exception as error:  # a fault of ours must not close the page
            logging.getLogger(__name__).exception("%s", text[:200])
            self.set_status(500)
            answer = {"error": f"{type(error).__name__}: {error}"}
        self.finish(json.dumps(answer, separators=(",", ":")))


WAITING = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="stylesheet" href="/style.css"></head><body><header><h1>{title}</h1></header>
<main><section><p id="waiting">{text}</p></section></main></body></html>"""


class RunPage(Guarded):
    """The report of a run; a page that asks again each second until it is computed."""

    async def get(self) -> None:
        loop, server = tornado.ioloop.IOLoop.current(), self.server
        name, run = self.get_query_argument("study", ""), self.get_query_argument("run", "")
        title, again = f"Run {run[:20]} of {name[:200]}", False
        try:
            if not run.isascii() or not run.isdigit() or len(run) > 9:
                raise StudyError(f"run is {run[:60]!r}, must be a number")
            seen = server.studies.look().study(name)
            found = await loop.run_in_executor(
                server.workers, server.reports.ask, seen, int(run)
            )
            if isinstance(found, Path):
                self.give_report(found)
                return
            text, again = (f"Carried out once more, with its pictures, for the report: "
                           f"{found:.0f} s …"), True  # fmt: skip
        except BenchError as error:
            self.set_status(400)
            text = str(error)
        if again:
            self.set_header("Refresh", "1")
        self.finish(WAITING.format(title=html.escape(title), text=html.escape(text)))


def serve(
    folders: Sequence[Path], address: str, port: int, token: str = "",
    say: Callable[[str], None] = print,
) -> BrowseServer:  # fmt: skip
    """Serve the page on an address; says where it is.

    Raises:
        BenchError: a folder that is none, no free port, or the library that draws is missing.
    """
    studies = Studies(folders)
    studies.look()
    server = begin(lambda access, sockets: BrowseServer(studies, access, sockets),
                   "the results browser", address, port, token, say)  # fmt: skip
    if not is_local(address):
        say(f"it listens on {address}: whoever reads its address on the network sees the results; "
            "what is sent is not encrypted")  # fmt: skip
    return server
