"""The live page of a running graph: see it, drive it, change it, in a browser on this machine."""

from __future__ import annotations

import os
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rospy

from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.settings import build, list_defaults, parameter
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.observation.observation import SEGMENTED
from aras_visual_servo_ros.connections import accept_in_threads
from aras_visual_servo_ros.shutdown import init_node, iterate_at_period

from ..errors import BenchError, RefusedError
from .graph_listener import GraphListener, make_listener_settings

if TYPE_CHECKING:
    from ..web.live.requests import Request

PERIOD = 0.5  # s of wall time between two looks at what changes seldom


@dataclass(frozen=True)
class PageSettings:
    """The page's own parameters, besides those of the controller that say where the robot is."""

    host: str = "127.0.0.1"
    port: int = parameter(8080, least=1, most=65535)
    token: str = ""
    directory: str = ""
    robot: str = "aras_visual_servo"

    def __post_init__(self) -> None:
        if self.token and (len(self.token) < 12 or not self.token.isascii()):
            raise ServoError(
                "parameter ~token is too easy to guess: 12 characters or more, or empty"
            )


class Dashboard:
    """The server's Host: a graph's story, pictures and actions."""

    def __init__(self, listener: GraphListener, robot: str, directory: Path) -> None:
        """`robot`: the model's name; `directory`: where goals, bags and reports go."""
        from ..web.live.page import Page
        from .image_subscriber import ImageSubscriber
        from .page_commands import PageCommands
        from .session_files import SessionFiles
        from .target_watch import TargetWatch
        from .teleoperator import Teleoperator

        settings = listener.settings
        self.page, self._listener = Page(), listener
        self._commands = PageCommands(listener, settings, directory, robot)
        self._session_files, self._target = SessionFiles(directory), TargetWatch()
        self._session_files.check_recording = self._check_time
        self._teleoperator = Teleoperator(listener, settings)
        self._images = ImageSubscriber(
            settings.namespace.rstrip("/"), settings.camera_namespace.rstrip("/")
        )
        self._model: tuple[str, dict[str, Any]] = ("", {})
        self._viewer_count = 0
        self._model_lock = threading.Lock()
        listener.on_state = self.page.add_sample
        actions, keeping, driving = self._commands, self._session_files, self._teleoperator
        self._handlers = {
            **{name: lambda g, n=name: actions.control_loop(n)
                for name in ("start", "stop", "hold")},
            "reset": lambda g: actions.control_clock("reset_simulation"),
            "pause": lambda g: actions.control_clock("pause_physics"),
            "resume": lambda g: actions.control_clock("unpause_physics"),
            "step": lambda g: actions.step(**g),
            "gain": lambda g: actions.set_gain(**g),
            "servo": lambda g: actions.restart_nodes(**g),
            "goal": lambda g: actions.move_goal(**g),
            "camera": lambda g: actions.change_camera(**g),
            "target": lambda g: actions.change_target(**g),
            "teach": lambda g: self._teach(g["name"]),
            "record": lambda g: keeping.start_recording(),
            "stop_record": lambda g: keeping.stop_recording(),
            "report": lambda g: keeping.make_report(),
            "jog": lambda g: driving.move_camera([g[k]
                for k in ("vx", "vy", "vz", "wx", "wy", "wz")]),
            "jog_joint": lambda g: driving.move_joint(g["joint"], g["speed"]),
        }  # fmt: skip

    # -- what the server asks for ------------------------------------------------------------

    def make_update(self) -> dict[str, Any]:
        """What has changed since the last call."""
        listener = self._listener
        with listener.lock:
            story = listener.refresh()
            joints, speeds = listener.positions, listener.velocities
            if joints is None:
                story, joints, speeds = None, (), ()
            return self.page.make_update(story, joints, speeds, listener.stamp)

    def make_robot_model(self) -> dict[str, Any] | None:
        """The robot's model; a description that cannot be drawn is told, and drawn as nothing."""
        from ..web.live.robot_model import make_robot_model

        urdf = self._listener.urdf
        if not urdf:
            return None
        with self._model_lock:
            if self._model[0] != urdf:
                try:
                    self._model = urdf, make_robot_model(urdf)
                except DescriptionError as error:
                    rospy.logwarn("the page does not draw the robot: %s", error)
                    self._model = urdf, {"name": "", "root": "", "joints": [], "links": {}}
            return self._model[1]

    def take_image(self) -> bytes | None:
        """A new JPEG, None where there is none since the last call."""
        return self._images.take_jpeg()

    def set_viewer_count(self, viewers: int) -> None:
        """So many look on now."""
        self._viewer_count = viewers
        self._images.set_viewer_count(viewers)

    def execute(self, request: Request) -> str:
        """Carry out a request; what to say. RefusedError: why not."""
        try:
            return self._handlers[request.do](request.arguments)
        except (ServoError, OSError, rospy.ROSException) as error:
            raise RefusedError(str(error)) from error

    def find_file(self, path: str) -> Path | None:
        """A file of the last run's report."""
        return self._session_files.find_file(path)

    def _check_time(self) -> None:
        """RefusedError where a recorder would wait for a time that does not come."""
        story = self._listener.run_trace
        if story is None or story.factor is None:
            self._commands.check_simulator()

    def _teach(self, name: str) -> str:
        """Refused at once where it is known already that the tool would see nothing."""
        listener, scheme = self._listener, self._commands.read_selection().get("scheme", "moments")
        if listener.run_trace is None or listener.run_trace.factor is None:
            raise RefusedError("time stands still, so that no images come: let it go on first")
        settings = listener.settings
        needs = settings.from_mapping({"scheme": scheme}, settings.package).make_scheme().needs
        if listener.no_target_reason and (not needs or needs & SEGMENTED):
            raise RefusedError(
                f"the camera sees nothing that could be taught ({listener.no_target_reason}): "
                "bring the target into view and teach again"
            )
        return self._session_files.teach_goal(name, scheme)

    # -- what changes seldom -----------------------------------------------------------------

    def refresh(self) -> None:
        """Look for another robot, for nodes that have come or gone, for choices."""
        listener, keeping = self._listener, self._session_files
        story = listener.update()
        if story is None or not self._viewer_count:
            return
        controller = self._commands.has_controller()
        if story.state.phase and not controller:
            listener.clear_controller()
        self._target.update(story, self._commands.robot)
        arm = story.arm
        limits = listener.settings.for_robot(listener.robot_name, ()).make_limits(arm)
        self.page.set_robot(
            arm.names, limits.lower, limits.upper, limits.velocity, arm.is_prismatic
        )
        self._images.choose_topic()
        self.page.choices = self._commands.list_choices()
        self.page.state = {
            **self._commands.read_selection(), "gains": self._commands.gains,
            "controller": controller, "robot": listener.robot_count, "image_note": self._images.note,
            "open_bag": str(keeping.open_bag or ""), "last_bag": str(keeping.last_bag or ""),
            "recording_error": keeping.find_recording_error(), "no_target": self._target.missing_reason,
            "report": keeping.report_page,
        }  # fmt: skip

    def close(self) -> None:
        """End what was started from the page."""
        self._commands.close()
        self._session_files.close()


def split_parameters(parameters: dict[str, Any]) -> tuple[PageSettings, dict[str, Any]]:
    """The page's own parameters, checked, and the rest.

    Raises:
        ServoError: one that is of a wrong kind, or out of range.
    """
    own = {name: parameters[name] for name in list_defaults(PageSettings) if name in parameters}
    rest = {name: value for name, value in parameters.items() if name not in own}
    return build(PageSettings, own, "parameter ~", ServoError), rest


def main() -> int:
    """Run the node; returns its exit status."""
    init_node("aras_visual_servo_dashboard", __doc__, disable_rostime=True)
    accept_in_threads()
    try:
        from ..web.live.server import serve
    except ModuleNotFoundError as error:
        rospy.logfatal("the live page needs %s: ./setup.sh --for bench installs it", error.name)
        return 1
    try:
        own, rest = split_parameters(rospy.get_param("~", {}))
        listener = GraphListener(make_listener_settings(rest))
        home = Path(os.environ.get("ROS_HOME", "~/.ros")).expanduser()
        directory = Path(own.directory or home / "aras_dashboard").expanduser()
        dashboard = Dashboard(listener, own.robot, directory)
        server = serve(dashboard, own.host, own.port, own.token, rospy.loginfo)
    except (BenchError, ServoError) as error:
        rospy.logfatal("%s", error)
        return 1
    print(f"\n    {server.access.address}\n", flush=True)  # a line that a terminal makes a link of
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
        if thread.name == "shutdown":  # it takes the node off the graph
            thread.join(5.0)
    sys.stdout.flush()
    os._exit(status)  # a tool that still runs for the page would be waited for


if __name__ == "__main__":
    sys.exit(main())
