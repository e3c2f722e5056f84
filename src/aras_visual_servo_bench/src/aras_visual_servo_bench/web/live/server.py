"""Web server of the live page, with one WebSocket for each viewer.

Its host supplies updates and images and executes requests. The server itself does not use ROS.
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
UPDATE_RATE = 15.0  # Hz, updates to each viewer
IMAGE_RATE = 10.0  # Hz, images to each viewer
MAX_VIEWERS = 8  # limits the load: each viewer costs processor time
MAX_REQUESTS = 8  # requests of one viewer in progress
# Unread bytes in the send buffer of a viewer above which further messages to it are dropped.
MAX_UNREAD_BYTES = 2_000_000


class PageHost(Protocol):
    """Interface between the server and the robot that the page shows.

    Only the server's thread calls `make_update` and `take_image`.
    """

    page: Page

    def make_update(self) -> dict[str, Any]:
        """Return what has changed since the last call."""

    def make_robot_model(self) -> dict[str, Any] | None:
        """Return the robot model, or None without a robot."""

    def take_image(self) -> bytes | None:
        """Return the newest image as JPEG, or None without a new one since the last call."""

    def set_viewer_count(self, viewers: int) -> None:
        """Report the number of open pages to the host."""

    def execute(self, request: Request) -> str:
        """Execute a request in a worker thread, and return the answer.

        Raises:
            RefusedError: the request cannot be executed.
        """

    def find_file(self, path: str) -> Path | None:
        """Return the path of a report file, or None if it does not exist."""


class LiveServer(WebServer):
    """Web server of the live page."""

    index = FILES / "index.html"
    max_message_bytes = 2 * MAX_BYTES

    def __init__(self, host: PageHost, access: Access, sockets: list[socket.socket]) -> None:
        """Create the server of a host's page.

        Raises:
            BenchError: the plotting library uPlot is not installed.
        """
        super().__init__(access, sockets)
        read_uplot(SCRIPT)  # report a missing library before a page is opened
        self.host = host
        self.viewers: set[Viewer] = set()

    def list_routes(self) -> list[tuple[str, type[AuthorizedHandler]]]:
        """Return the routes of the WebSocket, the robot model and the reports."""
        return [(r"/live", Viewer), (r"/robot", RobotModelHandler),
                (r"/report/(.*)", ReportHandler)]  # fmt: skip

    def find_page_file(self, name: str) -> str | None:
        """Return the text of a script or of the style sheet, or None if it does not exist."""
        if name == "uplot.js":
            return read_uplot(SCRIPT)
        path = SHARED / name if name == "scene.js" else FILES / name
        if not path.is_file():
            return None
        before = make_css(LIVE) + read_uplot(STYLE) if name == "style.css" else ""
        return before + path.read_bytes().decode()

    def on_start(self) -> None:
        """Create the timers of updates and images."""
        self._update_timer = tornado.ioloop.PeriodicCallback(self.send_update, 1e3 / UPDATE_RATE)
        self._image_timer = tornado.ioloop.PeriodicCallback(self.send_image, 1e3 / IMAGE_RATE)

    def on_stop(self) -> None:
        """Close the connections to all viewers."""
        for viewer in list(self.viewers):
            viewer.close(1001, "the simulator has ended")

    def add_viewer(self, viewer: Viewer) -> None:
        """Add a viewer, and start the timers for the first one."""
        self.viewers.add(viewer)
        if len(self.viewers) == 1:
            self._update_timer.start()
            self._image_timer.start()
        self.host.set_viewer_count(len(self.viewers))

    def remove_viewer(self, viewer: Viewer) -> None:
        """Remove a viewer, and stop the timers after the last one."""
        self.viewers.discard(viewer)
        if not self.viewers:
            self._update_timer.stop()
            self._image_timer.stop()
        self.host.set_viewer_count(len(self.viewers))

    def send_update(self) -> None:
        """Send an update to all viewers."""
        update = self.host.make_update()
        text = to_json(update)
        for viewer in list(self.viewers):
            viewer.outbox.send_update(update, text)

    def send_image(self) -> None:
        """Send a new image to all viewers."""
        image = self.host.take_image()
        if image is not None:
            for viewer in list(self.viewers):
                viewer.outbox.send_image(image)


class RobotModelHandler(AuthorizedHandler):
    """Handler that sends the robot model as JSON."""

    async def get(self) -> None:
        loop = tornado.ioloop.IOLoop.current()
        model = await loop.run_in_executor(self.server.workers, self.server.host.make_robot_model)
        if model is None:
            self.send_not_found("There is no robot yet.")
            return
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(model))


class ReportHandler(AuthorizedHandler):
    """Handler that sends a report, a self-contained page."""

    def get(self, name: str) -> None:
        path = self.server.host.find_file(name)
        if path is None:
            self.send_not_found("There is no report of that name.")
            return
        self.send_report(path)


class Viewer(AuthorizedHandler, tornado.websocket.WebSocketHandler):
    """WebSocket connection to one open page."""

    def initialize(self, server: LiveServer) -> None:
        super().initialize(server)
        self.outbox = Outbox(self.send)
        self._request_count = 0

    def check_origin(self, origin: str) -> bool:
        """Accept any origin here; `prepare` checks it and refuses with a reason."""
        return True

    def refusal_reason(self) -> str:
        """Return why this connection is refused, also for too many pages; '' if allowed."""
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
        """Send a message, unless the viewer has too many unread bytes."""
        stream = self.ws_connection.stream if self.ws_connection else None
        if stream is None or len(stream._write_buffer) > MAX_UNREAD_BYTES:
            return
        try:
            self.write_message(message, binary=isinstance(message, bytes))
        except tornado.websocket.WebSocketClosedError:
            self.server.remove_viewer(self)

    def on_message(self, message: str | bytes) -> None:
        """Handle an acknowledgement, or start a request without blocking the socket."""
        if message == ACKNOWLEDGED:
            self.outbox.acknowledge()
            return
        if self._request_count >= MAX_REQUESTS:
            text = f"{MAX_REQUESTS} requests are in progress: wait for their answers"
            self.send(json.dumps({"kind": "answer", "do": None, "ok": False, "text": text}))
            return
        self._request_count += 1
        tornado.ioloop.IOLoop.current().spawn_callback(self._carry_out, message)

    async def _carry_out(self, message: str | bytes) -> None:
        """Execute a request, and send the answer."""
        loop, host = tornado.ioloop.IOLoop.current(), self.server.host
        do: str | None = None
        try:
            do, fields = read_message(message, REQUESTS)
            request = read_request(do, fields, host.page.choices)
            text = await loop.run_in_executor(self.server.workers, host.execute, request)
            answer = {"kind": "answer", "do": do, "ok": True, "text": text}
        except RefusedError as error:
            answer = {"kind": "answer", "do": do, "ok": False, "text": str(error)}
        except Exception as error:  # a programming error must not close the connection
            logging.getLogger(__name__).exception("%s", do)
            text = f"{do} failed: {type(error).__name__}: {error}"
            answer = {"kind": "answer", "do": do, "ok": False, "text": text}
        self._request_count -= 1
        self.send(json.dumps(answer))


def serve(
    host: PageHost, address: str, port: int, token: str = "",
    say: Callable[[str], None] = print,
) -> LiveServer:  # fmt: skip
    """Serve the live page of a host, and report its address by `say`.

    Raises:
        PortTakenError: no port is free.
        BenchError: the plotting library uPlot is not installed.
    """
    server = start_server(
        lambda access, sockets: LiveServer(host, access, sockets), "the live page", address, port,
        token, say,
    )  # fmt: skip
    if not is_local(address):
        say(f"the live page listens on {address}: anyone who intercepts its address can move the "
            "robot; the connection is not encrypted")  # fmt: skip
    return server
