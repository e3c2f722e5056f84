"""The demo: start everything, servo to the target, stop everything, show what happened.

Runs a ROS master of its own on a free port, so that it disturbs no other graph. Exit status: 0
when the target was reached and held, 1 when not, 2 for wrong arguments, 130 after ^C.
"""

import argparse
import math
import os
import signal
import sys
import time
from typing import Any

import rospy

from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.records.state import HOLDING

from ..errors import BenchError
from .demo_words import STARTED, parse
from .processes import Launch, free_port

STARTUP_TIMEOUT = 300.0  # s of wall time for each step; nodes that die are told at once
SLOW_START = 20.0  # s of wall time after which it is told what is waited for
WALL_PER_SIMULATED = 6.0  # patience with a slow machine
HOLDING_PATIENCE = 5.0  # s of wall time for a controller that holds before it has begun
AFTERGLOW = 0.5  # s recorded beyond convergence


class Demo:
    """One run, from the first process to the last plot."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.out = arguments.out.expanduser().resolve()
        self.bag = self.out / "run.bag"
        self.uri = f"http://localhost:{free_port()}"
        self.launches: list[Launch] = []
        self.progress: Any = None
        self._checked = -math.inf
        self._holds_since: float | None = None

    def run(self) -> int:
        """Returns the exit status."""
        (self.out / "log").mkdir(parents=True, exist_ok=True)
        for old in (self.bag, self.bag.with_name("run.bag.active")):
            old.unlink(missing_ok=True)
        try:
            self._start()
            self._servo()
        finally:
            self._stop()
        return self._report()

    def _start(self) -> None:
        """Bring up master, simulator, recorder and nodes."""
        from .watch import Watch, wait_for_master

        _say("starting the simulator")
        port = self.uri.rpartition(":")[2]
        os.environ.update(
            ROS_MASTER_URI=self.uri, ROS_IP="127.0.0.1", ROS_LOG_DIR=str(self.out / "log")
        )
        os.environ.pop("ROS_HOSTNAME", None)
        world, loop = STARTED
        robot = self._launch(
            "simulator",
            ["-p", port, "aras_visual_servo_gazebo", world],
            record="true",
            bag=str(self.bag),
            **self._world(),
            show_rviz=str(self.arguments.rviz).lower(),
            server_required="true",
            **self.arguments.further[world],
        )
        if not wait_for_master(self.uri, lambda: robot.running, STARTUP_TIMEOUT):
            raise ServoError(f"the simulator did not start:\n{robot.last_lines()}")
        self.progress = Watch().progress
        active = self.bag.with_name(self.bag.name + ".active")
        self._wait(
            lambda: self.progress.joints and active.exists(),
            STARTUP_TIMEOUT,
            "the simulated robot and the recorder",
        )
        # The recorder and this process: rosbag takes a second to connect to a new topic.
        node = "/aras_visual_servo_controller"
        rospy.set_param(f"{node}/listeners", 2)
        for name in ("law", "gain", "tracker"):
            if value := getattr(self.arguments, name):
                rospy.set_param(f"{node}/{name}", value)
        _say("starting the camera and controller nodes")
        self._launch(
            "nodes",
            ["aras_visual_servo_gazebo", loop],
            scheme=self.arguments.scheme,
            start=self.arguments.start,
            goal=self._goal(),
            **self.arguments.further[loop],
        )

    def _servo(self) -> None:
        """Follow the controller until it has converged or time is up."""
        progress, told = self.progress, ""
        self._wait(lambda: progress.phase != "", STARTUP_TIMEOUT, "the controller's first word")
        self._wait(lambda: progress.began is not None, STARTUP_TIMEOUT, "the start pose")
        deadline = time.monotonic() + WALL_PER_SIMULATED * self.arguments.timeout
        while progress.stamp - progress.began < self.arguments.timeout:
            if progress.phase != told:
                told = progress.phase
                _say(told + (f": {progress.reason}" if progress.reason else ""))
            if progress.converged and progress.stamp - progress.converged > AFTERGLOW:
                return
            self._check_running()
            if time.monotonic() > deadline:
                _say(f"gave up after {WALL_PER_SIMULATED * self.arguments.timeout:.0f} s")
                return
            time.sleep(0.05)
        _say(f"not converged within {self.arguments.timeout:.0f} s of simulated time")

    def _stop(self) -> None:
        """Close the bag, then end every process."""
        if not self.launches:
            return
        from .watch import stop_recorder

        # A second ^C must not leave processes behind.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        _say("stopping")
        if self.progress is not None:
            stop_recorder(self.uri, self.bag)
        for launch in reversed(self.launches):
            launch.stop()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    def _report(self) -> int:
        """Write the report; print its numbers."""
        from ..numbers.summary import summarise, told
        from ..web.report.write import write_report
        from .bag import read_bag

        _say("reading the bag, drawing the report")
        record = read_bag(self.bag, name=self.out.name)
        record.settings = {
            "scheme": self.arguments.scheme, "start": self.arguments.start, **self._world(),
            **record.settings,
        }  # fmt: skip
        page = write_report([record], self.out, ("png",))[0]
        if not record.converged:
            _say(f"the nodes' log: {self.launches[-1].log}")
        print(f"\nVisual servoing by scheme '{self.arguments.scheme}' from the initial pose "
              f"{self.arguments.start}, camera '{self.arguments.camera}':\n\n"
              f"{told(record, summarise(record))}\n\n"
              f"  Report: {page}\n", flush=True)
        return 0 if record.converged else 1

    def _world(self) -> dict[str, str]:
        """Launch arguments of what is simulated, those that were given."""
        given = vars(self.arguments)
        names = ("camera", "target", "target_size", "urdf", "camera_xyz", "camera_rpy")
        return {name: str(given[name]) for name in names if given[name]}

    def _goal(self) -> str:
        """Name or path of the goal; one that was taught is kept with the results."""
        if self.arguments.taught is None:
            return self.arguments.goal
        path = self.out / "goal.yaml"
        told = f"Before the target {self.arguments.target}, where the shipped goal has the camera."
        path.write_text(self.arguments.taught.to_yaml(told), encoding="utf-8")
        return str(path)

    def _launch(self, name: str, arguments: list[str], **values: str) -> Launch:
        given = [f"{key}:={value}" for key, value in values.items()]
        launch = Launch(
            [*arguments, *given], self.out / "log" / f"{name}.txt", dict(os.environ)
        )
        self.launches.append(launch)
        return launch

    def _wait(self, condition, timeout: float, what: str) -> None:
        began, told = time.monotonic(), False
        while not condition():
            self._check_running()
            waited = time.monotonic() - began
            if not told and waited > SLOW_START:
                told = True
                _say(f"still waiting for {what}; a first start may have to compile loops")
            if waited > timeout:
                reason = getattr(self.progress, "reason", "")
                raise ServoError(
                    f"after {timeout:.0f} s still waiting for {what}"
                    + (f" ({reason})" if reason else "")
                    + f"; logs are in {self.out / 'log'}"
                )
            time.sleep(0.05)

    def _check_running(self) -> None:
        now = time.monotonic()
        if now - self._checked < 0.5:
            return
        self._checked = now
        for launch in self.launches:
            if death := launch.death():
                raise ServoError(
                    f"{death}; its last words:\n{launch.last_lines()}\nThe whole log: {launch.log}"
                )
        progress = self.progress
        if progress is None or progress.began is not None or progress.phase != HOLDING:
            self._holds_since = None
        elif self._holds_since is None:
            self._holds_since = now
        elif now - self._holds_since > HOLDING_PATIENCE:
            raise ServoError(
                f"the controller holds still: {progress.reason}\nThe whole log: "
                f"{self.launches[-1].log}"
            )


def _say(text: str) -> None:
    print(f"[demo] {text}", flush=True)


def _interrupted(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def main(argv: list[str] | None = None) -> int:
    """Run the demo; returns its exit status."""
    arguments = parse(argv)
    signal.signal(signal.SIGTERM, _interrupted)
    try:
        return Demo(arguments).run()
    except KeyboardInterrupt:
        _say("interrupted")
        return 130
    except (BenchError, ServoError, OSError) as error:
        print(f"[demo] failed: {error}", file=sys.stderr)
        return 1
