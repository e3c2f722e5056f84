"""Web server of the live page, with one WebSocket for each viewer.

The host of the server, a PageHost, supplies updates and images and executes requests. The server
itself does not use ROS.
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

from ...errors import RefusedRequestError
from ...plots.palette import LIVE, LIVE_LIGHT, make_css
from .. import SHARED
from ..access import Access
from ..page_messages import MAX_BYTES, read_message
from ..server import AuthorizedHandler, WebServer, start_server
from .outbox import ACKNOWLEDGED, Outbox, to_json
from .page_requests import REQUESTS, PageRequest, read_request
from .page_state import PageState

FILES = Path(__file__).parent / "page"
UPDATE_RATE = 15.0  # rate of the updates that each open page receives, Hz
IMAGE_RATE = 10.0  # rate of the images that each open page receives, Hz
MAX_VIEWERS = 8  # largest number of open pages; each page needs processor time
MAX_REQUESTS = 8  # largest number of requests of one viewer that are executed at the same time
# Size of the send buffer of a viewer above which messages to this viewer are dropped, bytes.
MAX_UNREAD_BYTES = 2_000_000


class PageHost(Protocol):
    """Interface of the object that connects the server to a robot.

    `make_update` and `take_image` are called only in the server's thread.
    """

    page: PageState

    def make_update(self) -> dict[str, Any]:
        """Return a message with all values that have changed since the last call."""

    def make_robot_model(self) -> dict[str, Any] | None:
        """Return the robot model; return None if there is no robot."""

    def take_image(self) -> bytes | None:
        """Return the newest image as JPEG; return None if it was returned before."""

    def set_viewer_count(self, viewers: int) -> None:
        """Set the number of open pages; it is called when this number changes."""

    def execute(self, request: PageRequest) -> str:
        """Execute a request, and return the answer; it is called in a worker thread.

        Raises:
            RefusedRequestError: the request cannot be executed.
        """

    def find_file(self, path: str) -> Path | None:
        """Return the path of a file of a report; return None if it does not exist."""


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
    """Handler that sends a report, which is a single HTML file."""

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
        """Accept any origin, because `prepare` checks it and sends the reason of a refusal."""
        return True

    def refusal_reason(self) -> str:
        """Return why this connection is refused, for example if too many pages are open; else ''.
        """
        why = super().refusal_reason()
        if not why and len(self.server.viewers) >= MAX_VIEWERS:
            why = f"{MAX_VIEWERS} pages are open already: close one of them"
        return why

    def open(self, *_: str) -> None:
        self.set_nodelay(True)
        self.server.add_viewer(self)
        self.outbox.send_update(self.server.host.page.make_full_message())

    def on_close(self) -> None:
        self.server.remove_viewer(self)

    def send(self, message: str | bytes) -> None:
        """Send a message. It is dropped if the send buffer is too full."""
        stream = self.ws_connection.stream if self.ws_connection else None
        if stream is None or len(stream._write_buffer) > MAX_UNREAD_BYTES:
            return
        try:
            self.write_message(message, binary=isinstance(message, bytes))
        except tornado.websocket.WebSocketClosedError:
            self.server.remove_viewer(self)

    def on_message(self, message: str | bytes) -> None:
        """Handle a message of the viewer: an acknowledgement, or a request.

        A request is executed in another thread, so the connection is not blocked.
        """
        if message == ACKNOWLEDGED:
            self.outbox.acknowledge()
            return
        if self._request_count >= MAX_REQUESTS:
            text = f"{MAX_REQUESTS} requests are in progress: wait for their answers"
            self._send_answer(None, False, text)
            return
        self._request_count += 1
        tornado.ioloop.IOLoop.current().spawn_callback(self._carry_out, message)

    async def _carry_out(self, message: str | bytes) -> None:
        """Execute the request in a message, and send the answer."""
        loop, host = tornado.ioloop.IOLoop.current(), self.server.host
        do, is_done = None, False
        try:
            do, fields = read_message(message, REQUESTS)
            request = read_request(do, fields, host.page.choices)
            text = await loop.run_in_executor(self.server.workers, host.execute, request)
            is_done = True
        except RefusedRequestError as error:
            text = str(error)
        except Exception as error:  # the connection must remain open after a programming error
            logging.getLogger(__name__).exception("%s", do)
            text = f"{do} failed: {type(error).__name__}: {error}"
        self._request_count -= 1
        self._send_answer(do, is_done, text)

    def _send_answer(self, do: str | None, is_done: bool, text: str) -> None:
        self.send(json.dumps({"kind": "answer", "do": do, "ok": is_done, "text": text}))


class LiveServer(WebServer):
    """Web server of the live page."""

    index = FILES / "index.html"
    routes = ((r"/live", Viewer), (r"/robot", RobotModelHandler), (r"/report/(.*)", ReportHandler))
    max_message_bytes = 2 * MAX_BYTES

    def __init__(self, host: PageHost, access: Access, sockets: list[socket.socket]) -> None:
        """Create a server.

        Args:
            host: connection to the robot.
            access: access rules of the server.
            sockets: sockets on which it listens.

        Raises:
            BenchError: the plotting library uPlot is not installed.
        """
        # the 3-D scene is dark also in light mode
        colours = make_css(LIVE_LIGHT) + make_css(LIVE, "[data-theme=dark], #scene-box")
        scripts = (*FILES.glob("*.js"), SHARED / "scene.js", SHARED / "theme.js")
        super().__init__(access, sockets, scripts, colours, FILES / "style.css")
        self.host = host
        self.viewers: set[Viewer] = set()

    def on_start(self) -> None:
        """Create the timers for updates and images."""
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


def serve(
    host: PageHost, address: str, port: int, token: str = "",
    say: Callable[[str], None] = print,
) -> LiveServer:  # fmt: skip
    """Start the server of the live page.

    Args:
        host: connection to the robot.
        address: address on which the server listens.
        port: first port to try.
        token: token in the URL of the page; '' for a random token.
        say: function that is called with messages for the user, such as the URL.

    Raises:
        NoFreePortError: no port is free.
        BenchError: the plotting library uPlot is not installed.
    """
    return start_server(
        lambda access, sockets: LiveServer(host, access, sockets), "the live page",
        "move the robot", address, port, token, say,
    )  # fmt: skip
