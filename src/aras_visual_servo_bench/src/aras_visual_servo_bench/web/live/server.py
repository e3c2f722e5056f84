"""The live page's server: one page, its files, one WebSocket for each viewer.

`send_update`s, requests and pictures come from its host, which need not be ROS.
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
from ...plots.palette import LIVE, make_css
from .. import SHARED
from ..access import Access
from ..messages import MAX_BYTES, read_message
from ..server import AuthorizedHandler, WebServer, is_local, start_server
from ..uplot import SCRIPT, STYLE, read_uplot
from .outbox import ACKNOWLEDGED, Outbox, to_json
from .page import Page
from .requests import REQUESTS, Request, read_request

FILES = Path(__file__).parent / "page"
UPDATE_RATE = 15.0  # messages a second to each viewer
IMAGE_RATE = 10.0
MAX_VIEWERS = 8  # at most; each costs its part of a core
MAX_REQUESTS = 8  # requests of one viewer at a time
# bytes of answers that a viewer may leave unread before it hears no more
MAX_UNREAD_BYTES = 2_000_000


class PageHost(Protocol):
    """What the page is about; `news` and `picture` are called by the server's thread alone."""

    page: Page

    def make_update(self) -> dict[str, Any]:
        """What has changed since the last call."""

    def make_robot_model(self) -> dict[str, Any] | None:
        """The robot's model, None where there is none yet."""

    def take_image(self) -> bytes | None:
        """A new JPEG, None where there is none since the last call."""

    def set_viewer_count(self, viewers: int) -> None:
        """So many look on now."""

    def execute(self, request: Request) -> str:
        """Carry out a request, in a thread of its own; what to say. RefusedError: why not."""

    def find_file(self, path: str) -> Path | None:
        """A file of a report that the page links to; None: there is none of that name."""


class LiveServer(WebServer):
    """The live page's."""

    index = FILES / "index.html"
    max_message_bytes = 2 * MAX_BYTES

    def __init__(self, host: PageHost, access: Access, sockets: list[socket.socket]) -> None:
        """See WebServer; BenchError where the library that draws curves is not there."""
        super().__init__(access, sockets)
        read_uplot(SCRIPT)  # said before the page is opened, if it is missing
        self.host = host
        self.viewers: set[Viewer] = set()

    def list_routes(self) -> list[tuple[str, type[AuthorizedHandler]]]:
        """See WebServer."""
        return [(r"/live", Viewer), (r"/robot", RobotModelHandler),
                (r"/report/(.*)", ReportHandler)]  # fmt: skip

    def find_page_file(self, name: str) -> str | None:
        """See WebServer."""
        if name == "uplot.js":
            return read_uplot(SCRIPT)
        path = SHARED / name if name == "scene.js" else FILES / name
        if not path.is_file():
            return None
        before = make_css(LIVE) + read_uplot(STYLE) if name == "style.css" else ""
        return before + path.read_bytes().decode()

    def on_start(self) -> None:
        """See WebServer."""
        self._update_timer = tornado.ioloop.PeriodicCallback(self.send_update, 1e3 / UPDATE_RATE)
        self._image_timer = tornado.ioloop.PeriodicCallback(self.send_image, 1e3 / IMAGE_RATE)

    def on_stop(self) -> None:
        """See WebServer."""
        for viewer in list(self.viewers):
            viewer.close(1001, "the simulator has ended")

    def add_viewer(self, viewer: Viewer) -> None:
        """A viewer more."""
        self.viewers.add(viewer)
        if len(self.viewers) == 1:
            self._update_timer.start()
            self._image_timer.start()
        self.host.set_viewer_count(len(self.viewers))

    def remove_viewer(self, viewer: Viewer) -> None:
        """A viewer less; without any, nothing is worked out."""
        self.viewers.discard(viewer)
        if not self.viewers:
            self._update_timer.stop()
            self._image_timer.stop()
        self.host.set_viewer_count(len(self.viewers))

    def send_update(self) -> None:
        """Tell all viewers what is new."""
        news = self.host.make_update()
        text = to_json(news)
        for viewer in list(self.viewers):
            viewer.outbox.send_update(news, text)

    def send_image(self) -> None:
        """Show all viewers the new picture."""
        picture = self.host.take_image()
        if picture is not None:
            for viewer in list(self.viewers):
                viewer.outbox.send_image(picture)


class RobotModelHandler(AuthorizedHandler):
    """The robot's model."""

    async def get(self) -> None:
        loop = tornado.ioloop.IOLoop.current()
        model = await loop.run_in_executor(self.server.workers, self.server.host.make_robot_model)
        if model is None:
            self.send_not_found("There is no robot yet.")
            return
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(model))


class ReportHandler(AuthorizedHandler):
    """A file of the last run's report; a report is a page of its own, with its pictures inside."""

    def get(self, name: str) -> None:
        path = self.server.host.find_file(name)
        if path is None:
            self.send_not_found("There is no report of that name.")
            return
        self.send_report(path)


class Viewer(AuthorizedHandler, tornado.websocket.WebSocketHandler):
    """One open page."""

    def initialize(self, server: LiveServer) -> None:
        super().initialize(server)
        self.outbox = Outbox(self.send)
        self._request_count = 0

    def check_origin(self, origin: str) -> bool:
        """Refusals are said in `prepare`, which knows the reason."""
        return True

    def refusal_reason(self) -> str:
        """See Guarded.refusal; there may be as many as are open already."""
        why = super().refusal_reason()
        if not why and len(self.server.viewers) >= MAX_VIEWERS:
            why = f"{MAX_VIEWERS} pages are open already"
        return why

    def open(self, *_: str) -> None:
        self.set_nodelay(True)
        self.server.add_viewer(self)
        self.outbox.send_update(self.server.host.page.make_full_message())

    def on_close(self) -> None:
        self.server.remove_viewer(self)

    def send(self, message: str | bytes) -> None:
        """Send; a viewer that asks and never reads is left out until it does."""
        stream = self.ws_connection.stream if self.ws_connection else None
        if stream is None or len(stream._write_buffer) > MAX_UNREAD_BYTES:
            return
        try:
            self.write_message(message, binary=isinstance(message, bytes))
        except tornado.websocket.WebSocketClosedError:
            self.server.remove_viewer(self)

    def on_message(self, message: str | bytes) -> None:
        """Have a request carried out; meanwhile the socket goes on being read, pongs included."""
        if message == ACKNOWLEDGED:
            self.outbox.acknowledge()
            return
        if self._request_count >= MAX_REQUESTS:
            text = f"{MAX_REQUESTS} requests are being carried out: wait for them"
            self.send(json.dumps({"kind": "answer", "do": None, "done": False, "text": text}))
            return
        self._request_count += 1
        tornado.ioloop.IOLoop.current().spawn_callback(self._carry_out, message)

    async def _carry_out(self, message: str | bytes) -> None:
        """Carry out a request, and say how that went."""
        loop, host = tornado.ioloop.IOLoop.current(), self.server.host
        do: str | None = None
        try:
            do, fields = read_message(message, REQUESTS)
            request = read_request(do, fields, host.page.choices)
            text = await loop.run_in_executor(self.server.workers, host.execute, request)
            answer = {"kind": "answer", "do": do, "done": True, "text": text}
        except RefusedError as error:
            answer = {"kind": "answer", "do": do, "done": False, "text": str(error)}
        except Exception as error:  # a fault of ours must not close the page
            logging.getLogger(__name__).exception("%s", do)
            text = f"{do} failed: {type(error).__name__}: {error}"
            answer = {"kind": "answer", "do": do, "done": False, "text": text}
        self._request_count -= 1
        self.send(json.dumps(answer))


def serve(
    host: PageHost, address: str, port: int, token: str = "",
    say: Callable[[str], None] = print,
) -> LiveServer:  # fmt: skip
    """Serve a host's page on an address; says where it is.

    Raises:
        PortTakenError: no port is free.
    """
    server = start_server(lambda access, sockets: LiveServer(host, access, sockets), "the live "
                                                                                     "page",
                                                                                     address,
                   port, token, say)  # fmt: skip
    if not is_local(address):
        say(f"the live page listens on {address}: whoever reads its address on the network may "
            "move the robot; what is sent is not encrypted")  # fmt: skip
    return server
