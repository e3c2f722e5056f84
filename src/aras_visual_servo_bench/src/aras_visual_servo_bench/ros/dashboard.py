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
from aras_visual_servo_base.settings import build, defaults, parameter
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.seeing.observation import SEGMENTED
from aras_visual_servo_ros.connections import open_wide
from aras_visual_servo_ros.shutdown import beats, begin_node

from ..errors import BenchError, RefusedError
from .listener import Listener, listener_settings

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

    def __init__(self, listener: Listener, robot: str, directory: Path) -> None:
        """`robot`: the model's name; `directory`: where goals, bags and reports go."""
        from ..web.live.page import Page
        from .actions import Actions
        from .driving import Driving
        from .keeping import Keeping
        from .pictures import Pictures
        from .target_watch import TargetWatch

        settings = listener.settings
        self.page, self._listener = Page(), listener
        self._actions = Actions(listener, settings, directory, robot)
        self._keeping, self._target = Keeping(directory), TargetWatch()
        self._keeping.check = self._check_time
        self._driving = Driving(listener, settings)
        self._pictures = Pictures(
            settings.namespace.rstrip("/"), settings.camera_namespace.rstrip("/")
        )
        self._model: tuple[str, dict[str, Any]] = ("", {})
        self._viewers = 0
        self._model_lock = threading.Lock()
        listener.hear = self.page.sample
        actions, keeping, driving = self._actions, self._keeping, self._driving
        self._doers = {
            **{name: lambda g, n=name: actions.loop(n) for name in ("start", "stop", "hold")},
            "reset": lambda g: actions.clock("reset_simulation"),
            "pause": lambda g: actions.clock("pause_physics"),
            "resume": lambda g: actions.clock("unpause_physics"),
            "step": lambda g: actions.step(**g),
            "gain": lambda g: actions.gain(**g),
            "servo": lambda g: actions.servo(**g),
            "goal": lambda g: actions.goal(**g),
            "camera": lambda g: actions.camera(**g),
            "target": lambda g: actions.target(**g),
            "teach": lambda g: self._teach(g["name"]),
            "record": lambda g: keeping.record(),
            "stop_record": lambda g: keeping.stop_record(),
            "report": lambda g: keeping.make_report(),
            "jog": lambda g: driving.twist([g[k] for k in ("vx", "vy", "vz", "wx", "wy", "wz")]),
            "jog_joint": lambda g: driving.joint(g["joint"], g["speed"]),
        }  # fmt: skip

    # -- what the server asks for ------------------------------------------------------------

    def news(self) -> dict[str, Any]:
        """What has changed since the last call."""
        listener = self._listener
        with listener.lock:
            story = listener.look_again()
            joints, speeds = listener.positions, listener.velocities
            if joints is None:
                story, joints, speeds = None, (), ()
            return self.page.news(story, joints, speeds, listener.stamp)

    def robot(self) -> dict[str, Any] | None:
        """The robot's model; a description that cannot be drawn is told, and drawn as nothing."""
        from ..web.live.robot_model import robot_model

        urdf = self._listener.urdf
        if not urdf:
            return None
        with self._model_lock:
            if self._model[0] != urdf:
                try:
                    self._model = urdf, robot_model(urdf)
                except DescriptionError as error:
                    rospy.logwarn("the page does not draw the robot: %s", error)
                    self._model = urdf, {"name": "", "root": "", "joints": [], "links": {}}
            return self._model[1]

    def picture(self) -> bytes | None:
        """A new JPEG, None where there is none since the last call."""
        return self._pictures.jpeg()

    def watched(self, viewers: int) -> None:
        """So many look on now."""
        self._viewers = viewers
        self._pictures.watched(viewers)

    def do(self, request: Request) -> str:
        """Carry out a request; what to say. RefusedError: why not."""
        try:
            return self._doers[request.do](request.given)
        except (ServoError, OSError, rospy.ROSException) as error:
            raise RefusedError(str(error)) from error

    def file(self, path: str) -> Path | None:
        """A file of the last run's report."""
        return self._keeping.file(path)

    def _check_time(self) -> None:
        """RefusedError where a recorder would wait for a time that does not come."""
        story = self._listener.story
        if story is None or story.factor is None:
            self._actions.check_simulator()

    def _teach(self, name: str) -> str:
        """Refused at once where it is known already that the tool would see nothing."""
        listener, scheme = self._listener, self._actions.given().get("scheme", "moments")
        if listener.story is None or listener.story.factor is None:
            raise RefusedError("time stands still, so that no images come: let it go on first")
        settings = listener.settings
        needs = settings.from_mapping({"scheme": scheme}, settings.package).make_scheme().needs
        if listener.unseen and (not needs or needs & SEGMENTED):
            raise RefusedError(f"the camera sees nothing that could be taught ({listener.unseen}): "
                               "bring the target into view and teach again")
        return self._keeping.teach(name, scheme)

    # -- what changes seldom -----------------------------------------------------------------

    def refresh(self) -> None:
        """Look for another robot, for nodes that have come or gone, for choices."""
        listener, keeping = self._listener, self._keeping
        story = listener.look()
        if story is None or not self._viewers:
            return
        controller = self._actions.controller_is_there()
        if story.told.phase and not controller:
            listener.forget()
        self._target.tell(story, self._actions.robot)
        arm = story.arm
        limits = listener.settings.for_robot(listener.robot, ()).limits(arm)
        self.page.robot(arm.names, limits.lower, limits.upper, limits.velocity, arm.prismatic)
        self._pictures.choose()
        self.page.choices = self._actions.choices()
        self.page.state = {
            **self._actions.given(), "gains": self._actions.gains,
            "controller": controller, "robot": listener.robots, "picture": self._pictures.note,
            "recording": str(keeping.recording or ""), "recorded": str(keeping.recorded or ""),
            "trouble": keeping.trouble(), "no_target": self._target.missing,
            "report": keeping.report,
        }  # fmt: skip

    def close(self) -> None:
        """End what was started from the page."""
        self._actions.close()
        self._keeping.close()


def own_parameters(given: dict[str, Any]) -> tuple[PageSettings, dict[str, Any]]:
    """The page's own parameters, checked, and the rest.

    Raises:
        ServoError: one that is of a wrong kind, or out of range.
    """
    own = {name: given[name] for name in defaults(PageSettings) if name in given}
    rest = {name: value for name, value in given.items() if name not in own}
    return build(PageSettings, own, "parameter ~", ServoError), rest


def main() -> int:
    """Run the node; returns its exit status."""
    begin_node("aras_visual_servo_dashboard", __doc__, disable_rostime=True)
    open_wide()
    try:
        from ..web.live.server import serve
    except ModuleNotFoundError as error:
        rospy.logfatal("the live page needs %s: ./setup.sh --for bench installs it", error.name)
        return 1
    try:
        own, rest = own_parameters(rospy.get_param("~", {}))
        listener = Listener(listener_settings(rest))
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
        for _ in beats(PERIOD):
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
