"""The live page's web server: one page, its files, one WebSocket for each viewer. By Tornado.

It runs in a thread of its own with an event loop of its own; `tick`s, requests and pictures come
from its host, which need not be ROS.
"""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import socket
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol

import tornado.httpserver
import tornado.ioloop
import tornado.netutil
import tornado.web
import tornado.websocket

from ..errors import BenchError
from ..pictures.palette import LIVE, css
from .access import Access
from .outbox import SEEN, Outbox, text_of
from .page import Page
from .requests import LARGEST, RefusedError, Request, read_message, read_request

FILES = Path(__file__).parent / "page"
RATE = 15.0  # messages a second to each viewer
PICTURE_RATE = 10.0
PORTS = 20  # tried one after the other, where the first is taken
VIEWERS = 8  # at most; each costs its part of a core
ASKED = 8  # requests of one viewer at a time
UNREAD = 2_000_000  # bytes of answers that a viewer may leave unread before it hears no more
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class PortTakenError(BenchError):
    """No port is free."""


class Host(Protocol):
    """What the page is about; `news` and `picture` are called by the server's thread alone."""

    page: Page

    def news(self) -> dict[str, Any]:
        """What has changed since the last call."""

    def robot(self) -> dict[str, Any] | None:
        """The robot's model, None where there is none yet."""

    def picture(self) -> bytes | None:
        """A new JPEG, None where there is none since the last call."""

    def watched(self, viewers: int) -> None:
        """So many look on now."""

    def do(self, request: Request) -> str:
        """Carry out a request, in a thread of its own; what to say. RefusedError: why not."""

    def file(self, path: str) -> Path | None:
        """A file of a report that the page links to; None: there is none of that name."""


def bound(host: str, port: int) -> tuple[list[socket.socket], str]:
    """Sockets that listen on the first free port from `port` on, and a word if that is another.

    Raises:
        PortTakenError: none is free, or the address is not this machine's.
    """
    last = min(port + PORTS, 65536)
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


class Server:
    """Serves a host's page until it is closed."""

    def __init__(self, host: Host, access: Access, sockets: list[socket.socket]) -> None:
        """`sockets`: as `bound` gives them, on the port that `access` names."""
        self.host, self.access = host, access
        self.viewers: set[Viewer] = set()
        self.workers = ThreadPoolExecutor(4, "page")
        self._sockets = sockets
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        logging.getLogger("tornado.access").setLevel(logging.ERROR)
        logging.getLogger("tornado.general").setLevel(logging.ERROR)

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

    def _run(self) -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        self._loop = tornado.ioloop.IOLoop.current()
        given = {"server": self}
        self._server = tornado.httpserver.HTTPServer(
            tornado.web.Application(
                [
                    (r"/", Index, given),
                    (r"/live", Viewer, given),
                    (r"/robot", RobotFile, given),
                    (r"/report/(.*)", ReportFile, given),
                    (r"/([a-z]+\.(?:js|css))", PageFile, given),
                ],
                default_handler_class=Nowhere,
                default_handler_args=given,
                compress_response=True,
                websocket_max_message_size=2 * LARGEST,
                websocket_ping_interval=10.0,
            ),
            max_body_size=LARGEST,
        )
        self._server.add_sockets(self._sockets)
        self._tick = tornado.ioloop.PeriodicCallback(self.tick, 1e3 / RATE)
        self._pictures = tornado.ioloop.PeriodicCallback(self.show, 1e3 / PICTURE_RATE)
        self._loop.add_callback(self._ready.set)
        self._loop.start()
        self._loop.close(all_fds=True)

    def _stop(self) -> None:
        self._tick.stop()
        self._pictures.stop()
        self._server.stop()
        for viewer in list(self.viewers):
            viewer.close(1001, "the simulator has ended")
        self._loop.call_later(0.1, self._loop.stop)

    def came(self, viewer: Viewer) -> None:
        """A viewer more."""
        self.viewers.add(viewer)
        if len(self.viewers) == 1:
            self._tick.start()
            self._pictures.start()
        self.host.watched(len(self.viewers))

    def went(self, viewer: Viewer) -> None:
        """A viewer less; without any, nothing is worked out."""
        if viewer not in self.viewers:
            return
        self.viewers.discard(viewer)
        if not self.viewers:
            self._tick.stop()
            self._pictures.stop()
        self.host.watched(len(self.viewers))

    def tick(self) -> None:
        """Tell all viewers what is new."""
        news = self.host.news()
        text = text_of(news)
        for viewer in list(self.viewers):
            viewer.outbox.news(news, text)

    def show(self) -> None:
        """Show all viewers the new picture."""
        picture = self.host.picture()
        if picture is not None:
            for viewer in list(self.viewers):
                viewer.outbox.picture(picture)


class Guarded(tornado.web.RequestHandler):
    """A handler that answers only whoever has the token."""

    def initialize(self, server: Server) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.clear_header("Server")

    def prepare(self) -> None:
        why = self.refusal()
        if why:
            self.set_status(403)
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.finish(f"Refused: {why}.\n")

    def refusal(self) -> str:
        """Why this request is not answered; '' where it is."""
        return self.server.access.refusal(
            self.token(), self.request.host, self.request.headers.get("Origin")
        )

    def token(self) -> str:
        """What the address carries."""
        return self.get_query_argument("token", "")


class Nowhere(Guarded):
    """Any other address."""

    def get(self) -> None:
        self.set_status(404)
        self.finish("There is nothing here.\n")


class Index(Guarded):
    """The page itself."""

    def get(self) -> None:
        self.finish((FILES / "index.html").read_bytes())


class PageFile(Guarded):
    """Its scripts and its style."""

    TYPES = {".js": "text/javascript", ".css": "text/css"}

    def token(self) -> str:
        """None is asked for: a script cannot hand it to those that it imports, and they are the
        same for everyone."""
        return self.server.access.token

    def get(self, name: str) -> None:
        path = FILES / name
        if not path.is_file():
            self.set_status(404)
            self.finish("There is nothing here.\n")
            return
        self.set_header("Content-Type", f"{self.TYPES[path.suffix]}; charset=utf-8")
        colours = css(LIVE) if name == "style.css" else ""
        self.finish(colours.encode() + path.read_bytes())


class RobotFile(Guarded):
    """The robot's model."""

    async def get(self) -> None:
        loop = tornado.ioloop.IOLoop.current()
        model = await loop.run_in_executor(self.server.workers, self.server.host.robot)
        if model is None:
            self.set_status(404)
            self.finish("There is no robot yet.\n")
            return
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(model))


class ReportFile(Guarded):
    """A file of the last run's report; a report is a page of its own, with its pictures inside."""

    def get(self, name: str) -> None:
        path = self.server.host.file(name)
        if path is None:
            self.set_status(404)
            self.finish("There is no report of that name.\n")
            return
        self.set_header("Content-Security-Policy", "default-src 'none'; style-src 'unsafe-inline'; "
                        "img-src data:; script-src 'unsafe-inline'")  # fmt: skip
        self.finish(path.read_bytes())


class Viewer(Guarded, tornado.websocket.WebSocketHandler):
    """One open page."""

    def initialize(self, server: Server) -> None:
        super().initialize(server)
        self.outbox = Outbox(self.tell)
        self._busy = 0

    def check_origin(self, origin: str) -> bool:
        """Refusals are said in `prepare`, which knows the reason."""
        return True

    def refusal(self) -> str:
        """See Guarded.refusal; there may be as many as are open already."""
        why = super().refusal()
        if not why and len(self.server.viewers) >= VIEWERS:
            why = f"{VIEWERS} pages are open already"
        return why

    def open(self, *_: str) -> None:
        self.set_nodelay(True)
        self.server.came(self)
        self.outbox.news(self.server.host.page.whole())

    def on_close(self) -> None:
        self.server.went(self)

    def tell(self, message: str | bytes) -> None:
        """Send; a viewer that asks and never reads is left out until it does."""
        stream = self.ws_connection.stream if self.ws_connection else None
        if stream is None or len(stream._write_buffer) > UNREAD:
            return
        try:
            self.write_message(message, binary=isinstance(message, bytes))
        except tornado.websocket.WebSocketClosedError:
            self.server.went(self)

    def on_message(self, message: str | bytes) -> None:
        """Have a request carried out; meanwhile the socket goes on being read, pongs included."""
        if message == SEEN:
            self.outbox.seen()
            return
        if self._busy >= ASKED:
            text = f"{ASKED} requests are being carried out: wait for them"
            self.tell(json.dumps({"kind": "answer", "do": None, "done": False, "text": text}))
            return
        self._busy += 1
        tornado.ioloop.IOLoop.current().spawn_callback(self._carry_out, message)

    async def _carry_out(self, message: str | bytes) -> None:
        """Carry out a request, and say how that went."""
        loop, host = tornado.ioloop.IOLoop.current(), self.server.host
        do: str | None = None
        try:
            do, fields = read_message(message)
            request = read_request(do, fields, host.page.choices)
            text = await loop.run_in_executor(self.server.workers, host.do, request)
            answer = {"kind": "answer", "do": do, "done": True, "text": text}
        except RefusedError as error:
            answer = {"kind": "answer", "do": do, "done": False, "text": str(error)}
        except Exception as error:  # a fault of ours must not close the page
            logging.getLogger(__name__).exception("%s", do)
            text = f"{do} failed: {type(error).__name__}: {error}"
            answer = {"kind": "answer", "do": do, "done": False, "text": text}
        self._busy -= 1
        self.tell(json.dumps(answer))


def serve(
    host: Host, address: str, port: int, token: str = "",
    say: Callable[[str], None] = print,
) -> Server:  # fmt: skip
    """Serve a host's page on an address; says where it is.

    Raises:
        PortTakenError: no port is free.
    """
    sockets, word = bound(address, port)
    taken = sockets[0].getsockname()[1]
    access = Access(address, taken, token) if token else Access(address, taken)
    server = Server(host, access, sockets)
    server.start()
    say(f"the live page is at {access.address}" + (f" ({word})" if word else ""))
    if address not in ("127.0.0.1", "localhost", "::1"):
        say(f"the live page listens on {address}: whoever reads its address on the network may "
            "move the robot; what is sent is not encrypted")  # fmt: skip
    return server
