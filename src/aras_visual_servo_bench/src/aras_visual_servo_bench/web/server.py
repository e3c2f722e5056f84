"""A web server for one of this program's pages, by Tornado, in a thread of its own.

Every page is served under the same rules (access.py) with the same headers: the live page and the
results browser are such servers.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import tornado.httpserver
import tornado.ioloop
import tornado.netutil
import tornado.web

from ..errors import BenchError
from .access import Access

MAX_PORTS = 20  # tried one after the other, where the first is taken
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}


# Of a report, which is one file with all that it needs within.
REPORT_POLICY = ("default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
                 "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
                 "frame-ancestors 'none'")  # fmt: skip
CONTENT_TYPES = {"js": "text/javascript", "css": "text/css"}


class PortTakenError(BenchError):
    """No port is free."""


def bind_free_port(host: str, port: int) -> tuple[list[socket.socket], str]:
    """Sockets that listen on the first free port from `port` on, and a word if that is another.

    Raises:
        PortTakenError: none is free, or the address is not this machine's.
    """
    last = min(port + MAX_PORTS, 65536)
    for candidate in range(port, last):
        try:
            sockets = tornado.netutil.bind_sockets(candidate, host)
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                continue
            raise PortTakenError(f"the page cannot listen on {host}:{port}: {error.strerror}; give "
                                 "an address of this machine") from error  # fmt: skip
        word = "" if candidate == port else f"port {port} is taken"
        return sockets, word
    raise PortTakenError(f"the page finds no free port from {port} to {last - 1} on {host}: give "
                         "another one")  # fmt: skip


class WebServer(ABC):
    """Serves pages until it is closed.

    Attributes:
        access: who may see them. workers: for what takes longer than a moment.
    """

    index: Path  # the page itself
    max_message_bytes = 65536  # bytes of a request
    is_compressed = True  # what is sent

    def __init__(self, access: Access, sockets: list[socket.socket]) -> None:
        """`sockets`: as `bind_free_port` gives them, on the port that `access` names."""
        self.access = access
        self.workers = ThreadPoolExecutor(4, "page")
        self._sockets = sockets
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        logging.getLogger("tornado.access").setLevel(logging.ERROR)
        logging.getLogger("tornado.general").setLevel(logging.ERROR)

    @abstractmethod
    def list_routes(self) -> list[tuple[str, type[AuthorizedHandler]]]:
        """Patterns of addresses beside the page and its files, and who answers them."""

    @abstractmethod
    def find_page_file(self, name: str) -> str | None:
        """The text of one of the page's scripts and styles; None: there is none of that name."""

    def start(self) -> None:
        """Serve, from now on."""
        self._thread.start()
        self._ready.wait(10.0)

    def close(self) -> None:
        """Serve no more."""
        if self._thread.is_alive():
            self._loop.add_callback(self._stop)
            self._thread.join(5.0)
        self.workers.shutdown(wait=False, cancel_futures=True)

    def on_start(self) -> None:
        """Called in the server's thread before it serves."""

    def on_stop(self) -> None:
        """Called in the server's thread when it serves no more."""

    def _run(self) -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        self._loop = tornado.ioloop.IOLoop.current()
        given = {"server": self}
        routes = [
            (r"/", IndexHandler),
            *self.list_routes(),
            (r"/([a-z]+\.(?:js|css))", PageFileHandler),
        ]
        self._server = tornado.httpserver.HTTPServer(
            tornado.web.Application(
                [(pattern, handler, given) for pattern, handler in routes],
                default_handler_class=NotFoundHandler,
                default_handler_args=given,
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
    """A handler that answers only whoever has the token."""

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
        """Why this request is not answered; '' where it is."""
        return self.server.access.refusal_reason(
            self.read_token(), self.request.host, self.request.headers.get("Origin")
        )

    def read_token(self) -> str:
        """What the address carries."""
        return self.get_query_argument("token", "")

    def send_not_found(self, text: str = "There is nothing here.") -> None:
        """Answer that there is no such thing."""
        self.set_status(404)
        self.finish(f"{text}\n")

    def send_report(self, path: Path) -> None:
        """Answer with a report, a page with its scripts and pictures inside."""
        self.set_header("Content-Security-Policy", REPORT_POLICY)
        self.finish(path.read_bytes())


class NotFoundHandler(AuthorizedHandler):
    """Any other address."""

    def get(self) -> None:
        self.send_not_found()


class IndexHandler(AuthorizedHandler):
    """The page itself."""

    def get(self) -> None:
        self.finish(self.server.index.read_bytes())


class PageFileHandler(AuthorizedHandler):
    """A page's scripts and its style."""

    def read_token(self) -> str:
        """None is asked for: a script cannot hand it to those that it imports, and they are the
        same for everyone."""
        return self.server.access.token

    def get(self, name: str) -> None:
        text = self.server.find_page_file(name)
        if text is None:
            self.send_not_found()
            return
        kind = CONTENT_TYPES[name.rpartition(".")[2]]
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.finish(text)


ServerT = TypeVar("Page", bound=WebServer)


def start_server(
    make_server: Callable[[Access, list[socket.socket]], ServerT], page_name: str, address: str,
    port: int,
    token: str = "", say: Callable[[str], None] = print,
) -> ServerT:  # fmt: skip
    """Serve a page on an address; says where it is.

    Args:
        make: the server. what: the page is called.

    Raises:
        PortTakenError: no port is free.
    """
    sockets, word = bind_free_port(address, port)
    taken = sockets[0].getsockname()[1]
    access = Access(address, taken, token) if token else Access(address, taken)
    server = make_server(access, sockets)
    server.start()
    say(f"{page_name} is at {access.address}" + (f" ({word})" if word else ""))
    return server


def is_local(address: str) -> bool:
    """Whether only this machine sees what listens there."""
    return address in ("127.0.0.1", "localhost", "::1")
