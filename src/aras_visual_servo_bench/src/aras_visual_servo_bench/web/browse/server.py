"""Web server of the results browser: the page, its queries, and the reports of runs."""

from __future__ import annotations

import html
import json
import logging
import socket
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import tornado.ioloop

from aras_visual_servo_base.settings import build

from ...errors import BenchError, RefusedRequestError, StudyError
from ...plots.palette import REPORT, REPORT_DARK, make_css
from ...studies import compare
from .. import SHARED
from ..access import Access
from ..page_messages import read_message
from ..server import AuthorizedHandler, WebServer, start_server
from . import result_queries
from .map_cells import to_json_value
from .queries import (
    OPERATORS,
    ComparisonQuery,
    GroupQuery,
    MapQuery,
    PointQuery,
    RowQuery,
    RunQuery,
    StudiesQuery,
)
from .reports import Reports
from .studies import Studies, StudiesSnapshot

FILES = Path(__file__).parent / "page"


def _list_studies(snapshot: StudiesSnapshot, query: StudiesQuery) -> dict[str, Any]:
    return {
        "studies": [{"name": entry.name, "path": str(entry.path), "runs": entry.stored_run_count,
                     "run_count": entry.run_count, "note": entry.note}
                    for entry in snapshot.studies],
        "note": snapshot.note,
        "columns": result_queries.describe_columns(snapshot),
        "operators": OPERATORS,
    }  # fmt: skip


def _rank_difference(difference: compare.Difference) -> tuple[int, float]:
    """Return a sort key: significant differences first, untested ones last, then by p-value."""
    if difference.verdict == compare.UNTESTED:
        return 2, 0.0
    return int(not difference.is_significant), difference.p


def _compare_studies(snapshot: StudiesSnapshot, query: ComparisonQuery) -> dict[str, Any]:
    """Return the differences between two studies: significant ones first, untested ones last."""
    first, second = (snapshot.find_study(name) for name in (query.first, query.second))
    for entry in (first, second):
        if entry.results is None:
            raise StudyError(f"study {entry.name} has no results yet")
    found = first.results.compare(second.results, query.by).differences
    return {
        "level": compare.SIGNIFICANCE_LEVEL,
        "differences": [
            {"group": d.group, "metric": d.metric, "verdict": d.verdict,
             "is_significant": d.is_significant, "p": to_json_value(d.p),
             "before": to_json_value(d.comparison.before),
             "after": to_json_value(d.comparison.after),
             "count": d.comparison.count, "paired": d.comparison.paired}
            for d in sorted(found, key=_rank_difference)
        ],
    }  # fmt: skip


def _find_run(snapshot: StudiesSnapshot, query: RunQuery) -> dict[str, Any]:
    return {"row": result_queries.find_run_row(snapshot, query.study, query.run)}


# type of each query, and function that returns the answer
QUERIES: Mapping[str, tuple[type, Callable[[StudiesSnapshot, Any], dict[str, Any]]]] = {
    "studies": (StudiesQuery, _list_studies),
    "rows": (RowQuery, result_queries.list_rows),
    "groups": (GroupQuery, result_queries.compute_groups),
    "map": (MapQuery, result_queries.compute_success_map),
    "points": (PointQuery, result_queries.find_points),
    "compare": (ComparisonQuery, _compare_studies),
    "run": (RunQuery, _find_run),
}


class QueryHandler(AuthorizedHandler):
    """Handler of the queries, which are JSON objects sent by POST."""

    async def post(self) -> None:
        loop, server = tornado.ioloop.IOLoop.current(), self.server
        text = self.request.body.decode(errors="replace")
        self.set_header("Content-Type", "application/json")
        try:
            answer = await loop.run_in_executor(server.workers, server.answer_query, text)
        except BenchError as error:
            self.set_status(400)
            answer = {"error": str(error)}
        except Exception as error:  # the page must remain usable after a programming error
            logging.getLogger(__name__).exception("%s", text[:200])
            self.set_status(500)
            answer = {"error": f"{type(error).__name__}: {error}"}
        self.finish(json.dumps(answer, separators=(",", ":")))


WAITING_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="stylesheet" href="/style.css"></head><body><header><h1>{title}</h1></header>
<main><section><p id="waiting">{text}</p></section></main></body></html>"""


class RunReportHandler(AuthorizedHandler):
    """Handler of the report of a run.

    While the report is being computed, the answer is a page that reloads every second.
    """

    async def get(self) -> None:
        loop, server = tornado.ioloop.IOLoop.current(), self.server
        name, run = self.get_query_argument("study", ""), self.get_query_argument("run", "")
        title, is_waiting = f"Run {run[:20]} of {name[:200]}", False
        try:
            if not run.isascii() or not run.isdigit() or len(run) > 9:
                raise StudyError(
                    f"the number of the run is {run[:60]!r}, must have 1 to 9 digits"
                )
            entry = server.studies.read_snapshot().find_study(name)
            found = await loop.run_in_executor(
                server.workers, server.reports.find_or_start, entry, int(run)
            )
            if isinstance(found, Path):
                self.send_report(found)
                return
            text, is_waiting = f"Repeating the run with images for its report: {found:.0f} s", True
        except BenchError as error:
            self.set_status(400)
            text = str(error)
        if is_waiting:
            self.set_header("Refresh", "1")
        self.finish(WAITING_PAGE.format(title=html.escape(title), text=html.escape(text)))


class BrowseServer(WebServer):
    """Web server of the results browser."""

    index = FILES / "index.html"
    routes = ((r"/ask", QueryHandler), (r"/run", RunReportHandler))
    # compressing megabytes of points would take longer than sending the points uncompressed
    is_compressed = False

    def __init__(
        self, studies: Studies, access: Access, sockets: list[socket.socket]
    ) -> None:
        """Create a server.

        Args:
            studies: reader of the studies.
            access: access rules of the server.
            sockets: sockets on which it listens.

        Raises:
            BenchError: the plotting library uPlot is not installed.
        """
        colours = make_css(REPORT) + make_css(REPORT_DARK, "[data-theme=dark]")
        scripts = (*FILES.glob("*.js"), SHARED / "charts.js", SHARED / "theme.js")
        super().__init__(access, sockets, scripts, colours, SHARED / "style.css")
        self.studies, self.reports = studies, Reports()

    def on_stop(self) -> None:
        """Stop the computation of reports."""
        self.reports.close()

    def answer_query(self, text: str) -> dict[str, Any]:
        """Return the answer to a query.

        text: the query as JSON.

        Raises:
            BenchError: the query is invalid or cannot be answered.
        """
        do, fields = read_message(text, QUERIES, self.max_message_bytes)
        kind, answer = QUERIES[do]
        query = build(kind, fields, f"{do}: ", RefusedRequestError)
        snapshot = self.studies.read_snapshot(isinstance(query, StudiesQuery) and query.force)
        return {"version": snapshot.version, **answer(snapshot, query)}


def serve(
    folders: Sequence[Path], address: str, port: int, token: str = "",
    say: Callable[[str], None] = print,
) -> BrowseServer:  # fmt: skip
    """Start the server of the results browser.

    Args:
        folders: folders of studies, or folders that contain folders of studies.
        address: address on which the server listens.
        port: first port to try.
        token: token in the URL of the page; '' for a random token.
        say: function that is called with messages for the user, such as the URL.

    Raises:
        BenchError: a folder does not exist, no port is free, or uPlot is not installed.
    """
    studies = Studies(folders)
    studies.read_snapshot()
    return start_server(
        lambda access, sockets: BrowseServer(studies, access, sockets), "the results browser",
        "read the results", address, port, token, say,
    )  # fmt: skip
