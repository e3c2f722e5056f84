"""Graph under test for fault injection, and checks that its state after a fault is as before."""

from __future__ import annotations

import logging
import math
import os
import threading
import time
import xmlrpc.client
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import rosgraph
import roslib.message
import rospy
import rosservice
from actionlib_msgs.msg import GoalStatusArray
from ros_graph import PATIENCE, GraphError, Launch, RosMaster
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float64

from .outcome import Outcome

ROBOT = "aras_visual_servo"
JOINTS = ("gantry", "joint1", "joint2", "joint3", "joint5", "joint6")
NODES = ("/gazebo", "/aras_visual_servo_camera", "/aras_visual_servo_controller")
COMMANDS = tuple(f"/{ROBOT}/{joint}_position_controller/command" for joint in JOINTS)
STATUS = f"/{ROBOT}/servo_to_target/status"
LISTENING = "0A"  # in /proc/net/tcp
ANSWER = 10.0 * PATIENCE  # s of wall time: what has not answered by then hangs
RECOVERY = 40.0 * PATIENCE  # s of wall time: what has not come back by then is lost
RECENT = 1.0 * PATIENCE  # s of wall time: what has not been heard of for longer has stopped
DESCRIPTORS, THREADS, MEGABYTES = 12, 6, 80.0  # more than this and staying is a leak


class Bed:
    """The simulator with its nodes on a master of its own, and this process as a node there."""

    def __init__(self, directory: Path, nodes: bool = True) -> None:
        self.directory = directory
        self.master = RosMaster(directory, watched=False)
        for name in ("ROS_HOSTNAME", "ROS_NAMESPACE"):
            os.environ.pop(name, None)
        for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOME", "ROS_LOG_DIR"):
            os.environ[name] = self.master.environment[name]
        rospy.init_node("faults", anonymous=True, disable_signals=True)
        logging.getLogger("rosout").setLevel(logging.CRITICAL)  # it tells each refused connection
        self.launches: list[Launch] = []
        self._nodes = nodes
        self._commanded: list[float] = []
        self._seen: dict[str, tuple[float, Any]] = {}
        self._subscribers: list[rospy.Subscriber] = []
        self.connect()

    def connect(self) -> None:
        """Subscribe to the graph; subscribe again if its master was replaced."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._seen.clear()
        self._subscribers = [
            rospy.Subscriber("/clock", Clock, self._keep, "clock"),
            rospy.Subscriber(f"/{ROBOT}/joint_states", JointState, self._keep, "joints"),
            rospy.Subscriber("/labrob/camera/image_raw", Image, self._keep, "image"),
            *(rospy.Subscriber(topic, Float64, self._command) for topic in COMMANDS),
            rospy.Subscriber(STATUS, GoalStatusArray, self._keep, "status of the action"),
        ]

    def _keep(self, message: Any, name: str) -> None:
        self._seen[name] = (time.monotonic(), message)

    def _command(self, message: Float64) -> None:
        self._commanded.append(message.data)

    def start(self) -> None:
        self.launch("aras_visual_servo.launch", ["/gazebo"], respawn_gazebo=True)
        if self._nodes:
            self.launch("aras_visual_servo_nodes.launch", NODES[1:])
        if wrong := self.trouble():
            raise GraphError(f"the graph is ill before any fault: {'; '.join(wrong)}")
        self._settle()

    def _settle(self) -> None:
        """Wait until all connections exist, so that they do not count as a leak."""
        before: dict[str, tuple[int, int]] = {}
        for _ in range(40):
            now = {node: figures[:2] for node, figures in self.resources().items()}
            if now == before:
                return
            before = now
            time.sleep(0.5)

    def launch(self, file: str, nodes: Any, **arguments: Any) -> Launch:
        """Start a launch file of the robot, and return when its nodes exist; stop() ends it."""
        launched = Launch(self.master, ("aras_visual_servo_gazebo", file), arguments)
        self.launches.append(launched)
        launched.wait_for_nodes(nodes, 120.0)
        return launched

    def start_only(self, file: str) -> Launch:
        """Start a launch file of the robot without waiting for its nodes."""
        return Launch(self.master, ("aras_visual_servo_gazebo", file), {})

    def close(self) -> None:
        try:
            self.stop()
        finally:
            rospy.signal_shutdown("the campaign is over")
            self.master.stop()

    def stop(self) -> None:
        for launched in reversed(self.launches):
            launched.stop()
        self.launches.clear()

    def start_anew(self) -> None:
        """Stop the remaining processes, and start all of them again with a new master."""
        for launched in reversed(self.launches):
            with suppress(GraphError):
                launched.stop()
        self.launches.clear()
        with suppress(GraphError):
            self.master.stop()
        self.master.start()
        self.connect()
        self.start()

    # --- what has to be as before ----------------------------------------------------------------

    def trouble(self, within: float = RECOVERY) -> list[str]:
        """Return what is wrong, as text, if it is not repaired within `within` s."""
        end = time.monotonic() + within
        while True:
            wrong = self._wrong()
            if not wrong or time.monotonic() > end:
                return wrong
            time.sleep(0.25)

    def _wrong(self) -> list[str]:
        wrong = []
        try:
            models = self.call("/gazebo/get_world_properties").model_names
            if ROBOT not in models:
                wrong.append("the robot is gone from the world")
            listed = self.call(f"/{ROBOT}/controller_manager/list_controllers").controller
            running = {c.name for c in listed if c.state == "running"}
            missing = {f"{joint}_position_controller" for joint in JOINTS} - running
            missing |= {"joint_state_controller"} - running
            if missing:
                wrong.append(f"not running: {', '.join(sorted(missing))}")
        except UnansweredError as error:
            wrong.append(str(error))
        now = time.monotonic()
        nodes = ("status of the action",) if self._nodes else ()
        for name in ("clock", "joints", "image", *nodes):
            if now - self._seen.get(name, (-math.inf, None))[0] > RECENT:
                wrong.append(f"no {name} any more")
        joints = self._seen.get("joints")
        if joints and not all(
            map(math.isfinite, (*joints[1].position, *joints[1].velocity, *joints[1].effort))
        ):
            wrong.append("joint states that are no numbers")
        if not all(map(math.isfinite, self._commanded)):
            wrong.append("a command that is no number")
        self._commanded.clear()
        missing = set(NODES if self._nodes else NODES[:1]) - self.master.nodes()
        wrong += [f"{node} is not registered" for node in sorted(missing)]
        return wrong

    def call(self, name: str, request: Any = None, timeout: float = ANSWER) -> Any:
        """Call a service and return its answer; without a request, the fields have default values.
        """
        try:
            kind = rosservice.get_service_class_by_name(name)
        except rosservice.ROSServiceException as error:
            raise UnansweredError(str(error)) from None
        if request is None:
            request = kind._request_class()
        box: list[Any] = []

        def run() -> None:
            try:
                box.append(rospy.ServiceProxy(name, kind)(request))
            except (rospy.ServiceException, rospy.ROSException, OSError) as error:
                box.append(error)

        caller = threading.Thread(target=run, daemon=True)
        caller.start()
        caller.join(timeout)
        if not box:
            raise UnansweredError(f"{name} has not answered for {timeout:g} s", hangs=True)
        if isinstance(box[0], Exception):
            raise UnansweredError(f"{name}: {box[0]}")
        return box[0]

    def calm(self) -> None:
        self.call("/gazebo/unpause_physics")

    def simulated(self) -> float:
        return self._seen["clock"][1].clock.to_sec()

    def listened(self) -> list[tuple[str, type]]:
        """Return the topics that the nodes subscribe to, with their classes, except time and
        transforms."""
        subscribers = dict(rosgraph.Master("/faults").getSystemState()[1])
        types = dict(rosgraph.Master("/faults").getTopicTypes())
        return [
            (topic, roslib.message.get_message_class(types[topic]))
            for topic, nodes in sorted(subscribers.items())
            if set(nodes) & set(NODES) and topic not in ("/clock", "/tf", "/tf_static")
        ]

    def services(self) -> list[str]:
        provided = rosgraph.Master("/faults").getSystemState()[2]
        return sorted(name for name, nodes in provided if set(nodes) & set(NODES))

    def ports(self, node: str) -> list[int]:
        process = Path("/proc") / str(self.pid(node))
        inodes = set()
        for entry in (process / "fd").iterdir():
            with suppress(OSError):
                inodes.add(os.readlink(entry).removeprefix("socket:[").removesuffix("]"))
        lines = [line.split() for line in (process / "net/tcp").read_text().splitlines()[1:]]
        return sorted(
            int(words[1].rpartition(":")[2], 16)
            for words in lines
            if words[3] == LISTENING and words[9] in inodes
        )

    # --- processes -------------------------------------------------------------------------------

    def pid(self, node: str) -> int:
        api = rosgraph.Master("/faults").lookupNode(node)
        return int(xmlrpc.client.ServerProxy(api).getPid("/faults")[2])

    def resources(self) -> dict[str, tuple[int, int, float]]:
        """Return the number of open descriptors and threads, and the resident MB, of each node."""
        found = {}
        for node in NODES if self._nodes else NODES[:1]:
            process = Path("/proc") / str(self.pid(node))
            status = dict(
                line.split(":", 1) for line in (process / "status").read_text().splitlines()
            )
            found[node] = (
                len(list((process / "fd").iterdir())),
                int(status["Threads"]),
                int(status["VmRSS"].split()[0]) / 1024.0,
            )
        return found

    @contextmanager
    def group(self, name: str) -> Iterator[Outcome]:
        """Run a group of faults: check the start, and report resources that have grown at the end.
        """
        outcome = Outcome(name)
        before = self.resources()
        yield outcome
        end = time.monotonic() + 10.0
        while (grown := list(_grown(before, self.resources()))) and time.monotonic() < end:
            time.sleep(0.5)
        outcome.leaked += grown

    def judge(self, outcome: Outcome, what: str, within: float = RECOVERY) -> None:
        """Record a fault, or a batch of faults, as survived, or name what was lost."""
        began = time.monotonic()
        wrong = self.trouble(within)
        outcome.recovered = max(outcome.recovered, time.monotonic() - began)
        if wrong:
            outcome.lost += [f"{what}: {w}" for w in wrong]


class UnansweredError(Exception):
    """A service that did not answer (`hangs`), or whose call failed."""

    def __init__(self, text: str, hangs: bool = False) -> None:
        super().__init__(text)
        self.hangs = hangs


def _grown(
    before: dict[str, tuple[int, int, float]], after: dict[str, tuple[int, int, float]]
) -> Iterator[str]:
    for node, then in before.items():
        now = after.get(node, then)
        for what, old, new, least in zip(
            ("descriptors", "threads", "MB"), then, now, (DESCRIPTORS, THREADS, MEGABYTES),
            strict=True,
        ):  # fmt: skip
            if new > old + least:
                yield f"{node}: {what} from {old:.0f} to {new:.0f}"


Group = Callable[[Bed, float, int], Outcome]
