"""Base class of the web servers of the live page and the results browser.

A server runs Tornado in its own thread. All servers have the same access rules (access.py) and HTTP
headers.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import tornado.httpserver
import tornado.ioloop
import tornado.netutil
import tornado.web

from ..errors import BenchError
from .access import Access
from .uplot import SCRIPT, STYLE, read_uplot

LOCAL_ADDRESSES = ("127.0.0.1", "localhost", "::1")  # only this machine can connect to these
MAX_PORTS = 20  # number of successive ports that are tried if ports are taken
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}

# Content-Security-Policy of a report, a single file with inline scripts, styles and images.
REPORT_POLICY = ("default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
                 "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
                 "frame-ancestors 'none'")  # fmt: skip
CONTENT_TYPES = {"js": "text/javascript", "css": "text/css"}


class NoFreePortError(BenchError):
    """No port is free."""


def bind_free_port(host: str, port: int) -> tuple[list[socket.socket], str]:
    """Listen on the first free port, starting with `port`.

    Returns:
        The listening sockets; and a note if `port` is not free, otherwise ''.

    Raises:
        NoFreePortError: no port is free, or the address does not belong to this machine.
    """
    last = min(port + MAX_PORTS, 65536)
    for candidate in range(port, last):
        try:
            sockets = tornado.netutil.bind_sockets(candidate, host)
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                continue
            raise NoFreePortError(f"the server cannot listen on {host}:{port}: {error.strerror}; "
                                  "use an address of this machine") from error  # fmt: skip
        note = "" if candidate == port else f"port {port} is taken"
        return sockets, note
    raise NoFreePortError(f"there is no free port from {port} to {last - 1} on {host}: use "
                          "another port")  # fmt: skip


class WebServer:
    """Base class of a web server that runs in its own thread until it is closed.

    Attributes:
        access: access rules of the server.
        files: texts of the scripts and the style sheet of the page, by name.
        workers: threads for slow tasks.
    """

    index: Path  # HTML file of the page
    # URL patterns and their handlers, in addition to those for the page and its files
    routes: tuple[tuple[str, type[AuthorizedHandler]], ...]
    max_message_bytes = 65536  # largest length of a request, bytes
    is_compressed = True

    def __init__(
        self, access: Access, sockets: list[socket.socket], scripts: Iterable[Path], colours: str,
        style: Path,
    ) -> None:  # fmt: skip
        """Create a server.

        Args:
            access: access rules. Their host and port are those of the sockets.
            sockets: listening sockets, from `bind_free_port`.
            scripts: scripts of the page.
            colours: rules with the colours of the page, in CSS.
            style: style sheet of the page.

        Raises:
            BenchError: the plotting library uPlot is not installed.
        """
        self.access = access
        self.files = {
            "uplot.js": read_uplot(SCRIPT),
            "style.css": colours + read_uplot(STYLE) + style.read_text(encoding="utf-8"),
            **{path.name: path.read_text(encoding="utf-8") for path in scripts},
        }
        self.workers = ThreadPoolExecutor(4, "page")
        self._sockets = sockets
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        logging.getLogger("tornado.access").setLevel(logging.ERROR)
        logging.getLogger("tornado.general").setLevel(logging.ERROR)

    def start(self) -> None:
        """Start the server's thread."""
        self._thread.start()
        self._ready.wait(10.0)

    def close(self) -> None:
        """Stop the server and its thread."""
        if self._thread.is_alive():
            self._loop.add_callback(self._stop)
            self._thread.join(5.0)
        self.workers.shutdown(wait=False, cancel_futures=True)

    def on_start(self) -> None:
        """Prepare the server; it is called in the server's thread before the first request."""

    def on_stop(self) -> None:
        """Release resources; it is called in the server's thread when the server stops."""

    def _run(self) -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        self._loop = tornado.ioloop.IOLoop.current()
        arguments = {"server": self}
        routes = [(r"/", IndexHandler), *self.routes, (r"/([a-z]+\.(?:js|css))", PageFileHandler)]
        self._server = tornado.httpserver.HTTPServer(
            tornado.web.Application(
                [(pattern, handler, arguments) for pattern, handler in routes],
                default_handler_class=NotFoundHandler,
                default_handler_args=arguments,
                compress_response=self.is_compressed,
                websocket_max_message_size=self.max_message_bytes,
                websocket_ping_interval=10.0,
            ),
            max_body_size=self.max_message_bytes,
        )
        self._server.add_sockets(self._sockets)
        self.on_start()
        self._loop.add_callback(self._ready.set)
        self._loop.start()
        self._loop.close(all_fds=True)

    def _stop(self) -> None:
        self.on_stop()
        self._server.stop()
        self._loop.call_later(0.1, self._loop.stop)


class AuthorizedHandler(tornado.web.RequestHandler):
    """Base class of all handlers. It refuses requests that the access rules do not allow."""

    def initialize(self, server: WebServer) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.clear_header("Server")

    def prepare(self) -> None:
        why = self.refusal_reason()
        if why:
            self.set_status(403)
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.finish(f"Refused: {why}.\n")

    def refusal_reason(self) -> str:
        """Return why this request is refused; '' if it is allowed."""
        return self.server.access.refusal_reason(
            self.read_token(), self.request.host, self.request.headers.get("Origin")
        )

    def read_token(self) -> str:
        """Return the token in the URL of the request; '' if there is none."""
        return self.get_query_argument("token", "")

    def send_not_found(self, text: str = "There is nothing here.") -> None:
        """Answer with the status 404 and a text."""
        self.set_status(404)
        self.finish(f"{text}\n")

    def send_report(self, path: Path) -> None:
        """Answer with a report, whose page contains its scripts and images."""
        self.set_header("Content-Security-Policy", REPORT_POLICY)
        self.finish(path.read_bytes())


class NotFoundHandler(AuthorizedHandler):
    """Handler of all unknown addresses."""

    def get(self) -> None:
        self.send_not_found()


class IndexHandler(AuthorizedHandler):
    """Handler of the HTML page."""

    def get(self) -> None:
        self.finish(self.server.index.read_bytes())


class PageFileHandler(AuthorizedHandler):
    """Handler of the scripts and the style sheet of a page."""

    def read_token(self) -> str:
        """Return the valid token, so that these files are available without a token.

        A script cannot pass the token to the scripts that it imports. The files contain no secrets.
        """
        return self.server.access.token

    def get(self, name: str) -> None:
        if name not in self.server.files:
            self.send_not_found()
            return
        kind = CONTENT_TYPES[name.rpartition(".")[2]]
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.finish(self.server.files[name])


ServerT = TypeVar("ServerT", bound=WebServer)


def start_server(
    make_server: Callable[[Access, list[socket.socket]], ServerT], page_name: str, risk: str,
    address: str, port: int, token: str = "", say: Callable[[str], None] = print,
) -> ServerT:  # fmt: skip
    """Start a server on the first free port.

    Args:
        make_server: function that creates the server from its access rules and sockets.
        page_name: name of the page, for the message.
        risk: what anyone who intercepts the page's URL can do, such as 'move the robot'.
        address: address on which the server listens.
        port: first port to try.
        token: token in the URL of the page; '' for a random token.
        say: function that is called with a message that contains the URL.

    Raises:
        NoFreePortError: no port is free.
    """
    sockets, note = bind_free_port(address, port)
    bound_port = sockets[0].getsockname()[1]
    access = Access(address, bound_port, token) if token else Access(address, bound_port)
    server = make_server(access, sockets)
    server.start()
    say(f"{page_name} is at {access.address}" + (f" ({note})" if note else ""))
    if address not in LOCAL_ADDRESSES:
        say(f"{page_name} listens on {address} without encryption: anyone who intercepts its URL "
            f"can {risk}")  # fmt: skip
    return server
