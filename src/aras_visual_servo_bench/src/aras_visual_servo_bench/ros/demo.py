"""The demo: start the simulation and the nodes, servo to the target, stop, and write a report.

The demo uses its own ROS master on a free port, so it does not affect other ROS graphs. The exit
status is 0 if the controller has converged, 1 if not or after an error, 2 for invalid arguments,
and 130 after ^C.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import rospy

from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.records.state import HOLDING

from ..errors import BenchError
from .demo_arguments import LAUNCH_FILES, parse
from .ros_launch import RosLaunch, find_free_port

if TYPE_CHECKING:
    from .controller_watch import ControllerWatch

STARTUP_TIMEOUT = 300.0  # longest duration of each step of the startup, s of wall time
# Duration of a step of the startup after which a message names this step, s of wall time.
SLOW_START_NOTICE = 20.0
# A run is ended when its duration in wall time exceeds its time limit (simulated time) by this
# factor.
MAX_WALL_TIME_FACTOR = 6.0
# Longest time for which the controller may stop the arm before servoing starts, s of wall time.
HOLDING_TIMEOUT = 5.0
# time for which the recording continues after convergence, simulated s
TIME_AFTER_CONVERGENCE = 0.5


class Demo:
    """One run of the demo, from the start of the processes to the report."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.output_folder = arguments.out.expanduser().resolve()
        self.bag = self.output_folder / "run.bag"
        self.uri = f"http://localhost:{find_free_port()}"
        self.launches: list[RosLaunch] = []
        self._watch: ControllerWatch | None = None
        self._check_time = -math.inf
        self._hold_start_time: float | None = None

    def run(self) -> int:
        """Run the demo and return its exit status."""
        (self.output_folder / "log").mkdir(parents=True, exist_ok=True)
        for old in (self.bag, self.bag.with_name("run.bag.active")):
            old.unlink(missing_ok=True)
        try:
            self._start()
            self._servo()
        finally:
            self._stop()
        return self._report()

    def _start(self) -> None:
        """Start the ROS master, the simulator, the recorder and the nodes."""
        from .controller_watch import ControllerWatch, wait_for_master

        _print_status("starting the simulator")
        port = self.uri.rpartition(":")[2]
        os.environ.update(
            ROS_MASTER_URI=self.uri, ROS_IP="127.0.0.1", ROS_LOG_DIR=str(self.output_folder / "log")
        )
        os.environ.pop("ROS_HOSTNAME", None)
        world, loop = LAUNCH_FILES
        robot = self._launch(
            "simulator", ["-p", port, "aras_visual_servo_gazebo", world],
            record="true", bag=str(self.bag), show_rviz=str(self.arguments.rviz).lower(),
            server_required="true", **self._make_world_arguments(),
            **self.arguments.further[world],
        )  # fmt: skip
        if not wait_for_master(self.uri, lambda: robot.running, STARTUP_TIMEOUT):
            raise ServoError(f"the simulator did not start:\n{robot.read_last_lines()}")
        self._watch = ControllerWatch()
        active = self.bag.with_name(self.bag.name + ".active")
        self._wait(
            lambda: self._watch.has_joint_states and active.exists(),
            "the simulated robot and the recorder",
        )
        # rosbag subscribes to a new topic only after 1 s. The parameter `listeners` makes the
        # controller wait until two nodes have subscribed: the recorder and this process.
        node = "/aras_visual_servo_controller"
        rospy.set_param(f"{node}/listeners", 2)
        for name in ("law", "gain", "tracker"):
            if value := getattr(self.arguments, name):
                rospy.set_param(f"{node}/{name}", value)
        _print_status("starting the camera and controller nodes")
        self._launch(
            "nodes", ["aras_visual_servo_gazebo", loop], scheme=self.arguments.scheme,
            start=self.arguments.start, goal=self._find_goal(), **self.arguments.further[loop],
        )  # fmt: skip

    def _servo(self) -> None:
        """Wait until the controller has converged or the time limit is reached."""
        watch, printed_phase = self._watch, ""
        self._wait(lambda: watch.phase != "", "the controller's first state")
        self._wait(lambda: watch.start_stamp is not None, "the start pose")
        deadline = time.monotonic() + MAX_WALL_TIME_FACTOR * self.arguments.timeout
        while watch.stamp - watch.start_stamp < self.arguments.timeout:
            if watch.phase != printed_phase:
                printed_phase = watch.phase
                _print_status(printed_phase + (f": {watch.reason}" if watch.reason else ""))
            if (converged := watch.convergence_stamp) and (
                watch.stamp - converged > TIME_AFTER_CONVERGENCE
            ):
                return
            self._check_running()
            if time.monotonic() > deadline:
                seconds = MAX_WALL_TIME_FACTOR * self.arguments.timeout
                _print_status(f"stopped after {seconds:.0f} s of wall time: the simulation is too "
                              "slow on this machine")
                return
            time.sleep(0.05)
        _print_status(f"not converged within {self.arguments.timeout:.0f} s of simulated time")

    def _stop(self) -> None:
        """Close the bag, then stop all processes."""
        if not self.launches:
            return
        from .controller_watch import stop_recorder

        # Ignore a second ^C, so that no process is left running.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        _print_status("stopping")
        if self._watch is not None:
            stop_recorder(self.uri, self.bag)
        for launch in reversed(self.launches):
            launch.stop()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    def _report(self) -> int:
        """Write the report, print its metrics, and return the exit status."""
        from ..metrics.summary import describe_run, summarise
        from ..web.report.write import write_report
        from .bag import read_bag

        _print_status("reading the bag and writing the report")
        record = read_bag(self.bag, name=self.output_folder.name)
        record.settings = {
            "scheme": self.arguments.scheme, "start": self.arguments.start,
            **self._make_world_arguments(),
            **record.settings,
        }  # fmt: skip
        page = write_report([record], self.output_folder, ("png",))[0]
        if not record.converged:
            _print_status(f"log of the nodes: {self.launches[-1].log}")
        print(f"\nVisual servoing by scheme '{self.arguments.scheme}' from the initial pose "
              f"{self.arguments.start}, camera '{self.arguments.camera}':\n\n"
              f"{describe_run(record, summarise(record))}\n\n"
              f"  Report: {page}\n", flush=True)
        return 0 if record.converged else 1

    def _make_world_arguments(self) -> dict[str, str]:
        """Return the arguments of the simulation's launch file that the user has set by options."""
        options = vars(self.arguments)
        names = ("camera", "target", "target_size", "urdf", "camera_xyz", "camera_rpy")
        return {name: str(options[name]) for name in names if options[name]}

    def _find_goal(self) -> str:
        """Return the name or the path of the goal's file.

        A goal that was computed for another target is written into the output folder.
        """
        if self.arguments.taught is None:
            return self.arguments.goal
        path = self.output_folder / "goal.yaml"
        comment = (
            f"View of the target {self.arguments.target} from the camera pose of the shipped goal."
        )
        path.write_text(self.arguments.taught.to_yaml(comment), encoding="utf-8")
        return str(path)

    def _launch(self, name: str, arguments: list[str], **values: str) -> RosLaunch:
        pairs = [f"{key}:={value}" for key, value in values.items()]
        launch = RosLaunch([*arguments, *pairs], self.output_folder / "log" / f"{name}.txt")
        self.launches.append(launch)
        return launch

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        start, is_reported = time.monotonic(), False
        while not condition():
            self._check_running()
            waited = time.monotonic() - start
            if not is_reported and waited > SLOW_START_NOTICE:
                is_reported = True
                _print_status(f"still waiting for {what}; the first start may compile code")
            if waited > STARTUP_TIMEOUT:
                raise ServoError(
                    f"still waiting for {what} after {STARTUP_TIMEOUT:.0f} s"
                    + (f" ({self._watch.reason})" if self._watch.reason else "")
                    + f"; see the logs in {self.output_folder / 'log'}"
                )
            time.sleep(0.05)

    def _check_running(self) -> None:
        now = time.monotonic()
        if now - self._check_time < 0.5:
            return
        self._check_time = now
        for launch in self.launches:
            if death := launch.find_death_message():
                raise ServoError(
                    f"{death}; last lines of its log:\n{launch.read_last_lines()}\nFull log: "
                    f"{launch.log}"
                )
        watch = self._watch
        if watch is None or watch.start_stamp is not None or watch.phase != HOLDING:
            self._hold_start_time = None
        elif self._hold_start_time is None:
            self._hold_start_time = now
        elif now - self._hold_start_time > HOLDING_TIMEOUT:
            raise ServoError(
                f"the controller does not start servoing: {watch.reason}\nFull log: "
                f"{self.launches[-1].log}"
            )


def _print_status(text: str) -> None:
    print(f"[demo] {text}", flush=True)


def _raise_interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def main(argv: list[str] | None = None) -> int:
    """Run the demo and return its exit status."""
    arguments = parse(argv)
    signal.signal(signal.SIGTERM, _raise_interrupt)
    try:
        return Demo(arguments).run()
    except KeyboardInterrupt:
        _print_status("interrupted")
        return 130
    except (BenchError, ServoError, OSError) as error:
        print(f"[demo] failed: {error}", file=sys.stderr)
        return 1
