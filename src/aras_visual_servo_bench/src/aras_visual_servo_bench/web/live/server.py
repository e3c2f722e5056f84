"""The live page's server: one page, its files, one WebSocket for each viewer.

`tick`s, requests and pictures come from its host, which need not be ROS.
"""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import tornado.ioloop
import tornado.websocket

from ...errors import RefusedError
from ...pictures.palette import LIVE, css
from .. import SHARED
from ..access import Access
from ..messages import LARGEST, read_message
from ..server import Guarded, WebServer, begin, is_local
from ..uplot import SCRIPT, STYLE, uplot
from .outbox import SEEN, Outbox, text_of
from .page import Page
from .requests import REQUESTS, Request, read_request

FILES = Path(__file__).parent / "page"
RATE = 15.0  # messages a second to each viewer
PICTURE_RATE = 10.0
VIEWERS = 8  # at most; each costs its part of a core
ASKED = 8  # requests of one viewer at a time
UNREAD = 2_000_000  # bytes of answers that a viewer may leave unread before it hears no more


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


class Server(WebServer):
    """The live page's."""

    index = FILES / "index.html"
    largest = 2 * LARGEST

    def __init__(self, host: Host, access: Access, sockets: list[socket.socket]) -> None:
        """See WebServer; BenchError where the library that draws curves is not there."""
        super().__init__(access, sockets)
        uplot(SCRIPT)  # said before the page is opened, if it is missing
        self.host = host
        self.viewers: set[Viewer] = set()

    def routes(self) -> list[tuple[str, type[Guarded]]]:
        """See WebServer."""
        return [(r"/live", Viewer), (r"/robot", RobotFile),
                (r"/report/(.*)", ReportFile)]  # fmt: skip

    def page_file(self, name: str) -> str | None:
        """See WebServer."""
        if name == "uplot.js":
            return uplot(SCRIPT)
        path = SHARED / name if name == "scene.js" else FILES / name
        if not path.is_file():
            return None
        before = css(LIVE) + uplot(STYLE) if name == "style.css" else ""
        return before + path.read_bytes().decode()

    def begun(self) -> None:
        """See WebServer."""
        self._tick = tornado.ioloop.PeriodicCallback(self.tick, 1e3 / RATE)
        self._pictures = tornado.ioloop.PeriodicCallback(self.show, 1e3 / PICTURE_RATE)

    def ended(self) -> None:
        """See WebServer."""
        for viewer in list(self.viewers):
            viewer.close(1001, "the simulator has ended")

    def came(self, viewer: Viewer) -> None:
        """A viewer more."""
        self.viewers.add(viewer)
        if len(self.viewers) == 1:
            self._tick.start()
            self._pictures.start()
        self.host.watched(len(self.viewers))

    def went(self, viewer: Viewer) -> None:
        """A viewer less; without any, nothing is worked out."""
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


class RobotFile(Guarded):
    """The robot's model."""

    async def get(self) -> None:
        loop = tornado.ioloop.IOLoop.current()
        model = await loop.run_in_executor(self.server.workers, self.server.host.robot)
        if model is None:
            self.nothing("There is no robot yet.")
            return
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(model))


class ReportFile(Guarded):
    """A file of the last run's report; a report is a page of its own, with its pictures inside."""

    def get(self, name: str) -> None:
        path = self.server.host.file(name)
        if path is None:
            self.nothing("There is no report of that name.")
            return
        self.give_report(path)


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
            do, fields = read_message(message, REQUESTS)
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
    server = begin(lambda access, sockets: Server(host, access, sockets), "the live page", address,
                   port, token, say)  # fmt: skip
    if not is_local(address):
        say(f"the live page listens on {address}: whoever reads its address on the network may "
            "move the robot; what is sent is not encrypted")  # fmt: skip
    return server
