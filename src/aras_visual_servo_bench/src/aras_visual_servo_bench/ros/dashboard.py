"""Node that serves the live page, which shows and controls a running graph in a browser."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rospy

from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.settings import build, list_defaults, parameter
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.observation.observation import SEGMENTED
from aras_visual_servo_ros.shutdown import iterate_at_period, node_main

from ..errors import BenchError, RefusedRequestError
from .graph_listener import GraphListener, make_listener_settings

if TYPE_CHECKING:
    from ..web.live.page_requests import PageRequest

# Time between two updates of rarely changing values, such as selection lists, s of wall time.
PERIOD = 0.5


@dataclass(frozen=True)
class PageSettings:
    """Parameters of the live page; the node also has the parameters of the controller node."""

    host: str = "127.0.0.1"
    port: int = parameter(8080, least=1, most=65535)
    token: str = ""
    directory: str = ""
    robot: str = "aras_visual_servo"

    def __post_init__(self) -> None:
        if self.token and (len(self.token) < 12 or not self.token.isascii()):
            raise ServoError(
                "parameter ~token is too easy to guess: use 12 or more ASCII characters, or an "
                "empty text for a random token"
            )


class Dashboard:
    """Connects the server of the live page to the topics and services of a ROS graph."""

    def __init__(self, listener: GraphListener, robot: str, directory: Path) -> None:
        """Create the dashboard of a robot.

        Args:
            listener: subscriber of the robot's topics.
            robot: name of the robot's model in the simulator.
            directory: folder for goals, bags and reports.
        """
        from ..web.live.page_state import PageState
        from .live_image_subscriber import LiveImageSubscriber
        from .page_commands import PageCommands
        from .session_files import SessionFiles
        from .target_drawing_updater import TargetDrawingUpdater
        from .teleoperator import Teleoperator

        settings = listener.settings
        self.page, self._listener = PageState(), listener
        self._commands = PageCommands(listener, settings, directory, robot)
        self._session_files, self._target = SessionFiles(directory), TargetDrawingUpdater()
        self._teleoperator = Teleoperator(listener, settings)
        self._images = LiveImageSubscriber(
            settings.namespace.rstrip("/"), settings.camera_namespace.rstrip("/")
        )
        self._model: tuple[str, dict[str, Any]] = ("", {})
        self._viewer_count = 0
        self._model_lock = threading.Lock()
        listener.on_state = self.page.add_sample
        commands, files, teleoperator = self._commands, self._session_files, self._teleoperator
        # For each request, the function that executes it; its arguments are the request's fields.
        self._handlers: dict[str, Callable[..., str]] = {
            **{name: partial(commands.control_loop, name) for name in ("start", "stop", "hold")},
            "reset": partial(commands.control_clock, "reset_simulation"),
            "pause": partial(commands.control_clock, "pause_physics"),
            "resume": partial(commands.control_clock, "unpause_physics"),
            "step": commands.step,
            "gain": commands.set_gain,
            "servo": commands.restart_nodes,
            "goal": commands.move_goal,
            "camera": commands.change_camera,
            "target": commands.change_target,
            "teach": self._teach,
            "record": self._record,
            "stop_record": files.stop_recording,
            "report": files.make_report,
            "jog": teleoperator.move_camera,
            "jog_joint": teleoperator.move_joint,
        }

    def make_update(self) -> dict[str, Any]:
        """Return a message with all values that have changed since the last call."""
        listener = self._listener
        with listener.lock:
            trace = listener.refresh()
            joints, velocities = listener.positions, listener.velocities
            if joints is None:
                trace, joints, velocities = None, (), ()
            return self.page.make_update(trace, joints, velocities, listener.stamp)

    def make_robot_model(self) -> dict[str, Any] | None:
        """Return the robot model for the live page's 3-D view, or None if there is no robot.

        If the robot cannot be drawn, a warning is logged, and the result is a model without links.
        """
        from ..web.live.robot_model import make_robot_model

        urdf = self._listener.urdf
        if not urdf:
            return None
        with self._model_lock:
            if self._model[0] != urdf:
                try:
                    self._model = urdf, make_robot_model(urdf)
                except DescriptionError as error:
                    rospy.logwarn("the live page cannot draw the robot: %s", error)
                    self._model = urdf, {"name": "", "root": "", "joints": [], "links": {}}
            return self._model[1]

    def take_image(self) -> bytes | None:
        """Return the newest image as JPEG; return None if it was returned before."""
        return self._images.take_jpeg()

    def set_viewer_count(self, viewers: int) -> None:
        """Set the number of open pages; if it is 0, the node does not subscribe to images."""
        self._viewer_count = viewers
        self._images.set_viewer_count(viewers)

    def execute(self, request: PageRequest) -> str:
        """Execute a request of the live page, and return the answer.

        Raises:
            RefusedRequestError: the request cannot be executed.
        """
        try:
            return self._handlers[request.do](**request.arguments)
        except (ServoError, OSError, rospy.ROSException) as error:
            raise RefusedRequestError(str(error)) from error

    def find_file(self, path: str) -> Path | None:
        """Return the path of a file of a report; return None if it does not exist."""
        return self._session_files.find_file(path)

    def _record(self) -> str:
        """Start to record a bag, and return the answer.

        Raises:
            RefusedRequestError: the recorder does not start, or would wait for simulated time
                forever: no joint states arrive, and no simulator is running.
        """
        trace = self._listener.run_trace
        if trace is None or trace.factor is None:
            self._commands.check_simulator()
        return self._session_files.start_recording()

    def _teach(self, name: str) -> str:
        """Store the current view as a goal, and return the answer.

        Raises:
            RefusedRequestError: the simulation is paused, the target is not detected, or the tool
                that stores the goal fails.
        """
        listener, scheme = self._listener, self._commands.read_selection().get("scheme", "moments")
        if listener.run_trace is None or listener.run_trace.factor is None:
            raise RefusedRequestError(
                "the simulation is paused, so there are no images: resume it first"
            )
        settings = listener.settings
        needs = settings.from_mapping({"scheme": scheme}, settings.package).make_scheme().needs
        if listener.no_target_reason and (not needs or needs & SEGMENTED):
            raise RefusedRequestError(
                f"the target is not detected ({listener.no_target_reason}): bring it into view, "
                "then teach again"
            )
        return self._session_files.teach_goal(name, scheme)

    def refresh(self) -> None:
        """Update the robot, the controller, the target and the selection lists.

        It is called every PERIOD.
        """
        listener, files = self._listener, self._session_files
        trace = listener.update()
        if not self._viewer_count:
            return
        missing = listener.find_missing()
        if trace is None:
            self.page.state = {"missing": missing}
            return
        controller = self._commands.has_controller()
        if trace.state.phase and not controller:
            listener.clear_controller()
        self._target.update(trace, self._commands.robot)
        arm = trace.arm
        limits = listener.settings.for_robot(listener.robot_name, ()).make_limits(arm)
        self.page.set_robot(
            arm.names, limits.lower, limits.upper, limits.velocity, arm.is_prismatic
        )
        self._images.choose_topic()
        self.page.choices = self._commands.list_choices()
        self.page.state = {
            **self._commands.read_selection(), "gains": self._commands.gains,
            "controller": controller, "robot": listener.robot_count, "missing": missing,
            "image_note": self._images.note,
            "open_bag": str(files.open_bag or ""), "last_bag": str(files.last_bag or ""),
            "recording_error": files.find_recording_error(),
            "no_target": self._target.missing_reason,
            "report": files.report_page,
        }  # fmt: skip

    def close(self) -> None:
        """Stop the nodes and the recorder that were started from the live page."""
        self._commands.close()
        self._session_files.close()


def split_parameters(parameters: dict[str, Any]) -> tuple[PageSettings, dict[str, Any]]:
    """Split the node's parameters into those of the live page and those of the controller.

    Only the parameters of the live page are checked.

    Raises:
        ServoError: a parameter of the live page has the wrong type or is out of range.
    """
    names = list_defaults(PageSettings)
    of_page = {name: parameters[name] for name in names if name in parameters}
    others = {name: value for name, value in parameters.items() if name not in names}
    return build(PageSettings, of_page, "parameter ~", ServoError), others


def main() -> int:
    """Run the node and return its exit status."""
    return node_main("aras_visual_servo_dashboard", __doc__, _serve, (BenchError, ServoError),
                     disable_rostime=True)  # fmt: skip


def _serve() -> None:
    """Serve the live page until the node is shut down, and end the process.

    Raises:
        BenchError, ServoError: the page cannot be served.
    """
    try:
        from ..web.live.server import serve
    except ModuleNotFoundError as error:
        raise BenchError(f"the live page needs {error.name}, which is not installed; run: "
                         "./setup.sh --for bench") from None  # fmt: skip
    page, other_parameters = split_parameters(rospy.get_param("~", {}))
    listener = GraphListener(make_listener_settings(other_parameters))
    home = Path(os.environ.get("ROS_HOME", "~/.ros")).expanduser()
    directory = Path(page.directory or home / "aras_dashboard").expanduser()
    dashboard = Dashboard(listener, page.robot, directory)
    server = serve(dashboard, page.host, page.port, page.token, rospy.loginfo)
    # the address has its own line, so that terminals show it as a link
    print(f"\n    {server.access.address}\n", flush=True)
    status = 0
    try:
        for _ in iterate_at_period(PERIOD):
            dashboard.refresh()
    except ServoError as error:
        rospy.logfatal("%s", error)
        status = 1
    server.close()
    dashboard.close()
    for thread in threading.enumerate():
        # rospy unregisters the node in this thread, so the thread must end first
        if thread.name == "shutdown":
            thread.join(5.0)
    sys.stdout.flush()
    os._exit(status)  # a normal exit would wait for the threads of tools that are still running
