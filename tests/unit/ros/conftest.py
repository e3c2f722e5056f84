"""ROS graph without a master: services, topics and parameters in memory, with the simulation."""

from __future__ import annotations

import importlib.util
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import pytest
import rosgraph
import rospy
from genpy import Message
from geometry_msgs.msg import Point, Pose
from rospy.impl import masterslave, registration, tcpros_base

from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_visual_servo_ros import rospy_patches as connections
from aras_visual_servo_ros.send_queue import QUEUE_FLUSHER

sys.path.insert(0, str(Path(__file__).parent))
SOURCES = Path(__file__).parents[3] / "src"

if importlib.util.find_spec("gazebo_msgs") is None:
    # Imports of generated messages would fail at the top of the test files.
    collect_ignore_glob = ["test_*.py"]
    sys.stderr.write("tests/unit/ros left out: build the workspace and source devel/setup.bash\n")


def on_wire(message: Message) -> Message:
    message.serialize(BytesIO())
    return message


class Publisher:
    """Replacement of rospy.Publisher that stores messages."""

    def __init__(self, graph: Graph, topic: str, kind: type, options: dict[str, object]) -> None:
        self.graph, self.topic, self.kind, self.options = graph, topic, kind, options
        self.resolved_name = topic
        self.listener = options.get("subscriber_listener")
        self.impl = SimpleNamespace(connections=[])
        self.sent: list[object] = []

    def publish(self, message: object) -> None:
        if self.impl is None:  # as rospy, which closes topics while a node ends
            raise rospy.ROSException("publish() to a closed topic")
        self.sent.append(message if isinstance(message, (int, float)) else on_wire(message))

    def get_num_connections(self) -> int:
        return len(self.impl.connections)

    def unregister(self) -> None:
        if self.graph.publishers.get(self.topic) is self:
            del self.graph.publishers[self.topic]
        self.impl = None


class Graph:
    """Advertised topics and services, and the content of the parameter server."""

    def __init__(self) -> None:
        self.services: dict[str, Callable[[object], object]] = {}
        self.types: dict[str, type] = {}
        self.publishers: dict[str, Publisher] = {}
        self.subscribers: dict[str, Callable[[object], None]] = {}
        self.heard: dict[str, tuple[type, dict[str, object]]] = {}
        self.subscriptions: dict[str, SimpleNamespace] = {}
        self.parameters: dict[str, object] = {}
        self.lines: list[str] = []
        self.periods: list[float] = []  # s, of lines that are written once in a while
        self.timers: list[tuple] = []
        self.wall_time = 100.0
        self.published: list | Exception = []  # topics with their publishers, as the master says
        self.sources: dict[str, int] = {}  # how many publish on a topic to which a node listens
        self.proxies: list[tuple[str, type, dict[str, object]]] = []  # of services that were asked

    def call(self, service: str, *args: object, **fields: object) -> object:
        """Call a service with these fields, and return its answer."""
        service = rospy.resolve_name(service)
        request = self.types[service]._request_class
        if not args or not isinstance(args[0], request):
            args = (request(**dict(zip(request.__slots__, args, strict=False)), **fields),)
        return on_wire(self.services[service](on_wire(args[0])))

    def told(self) -> dict[str, tuple[type, int, bool]]:
        """Return type, queue length and latching of each published topic."""
        return {topic: (one.kind, one.options["queue_size"], one.options.get("latch", False))
                for topic, one in self.publishers.items()}

    def listen(self, topic: str, count: int = 1) -> list[SimpleNamespace]:
        """Return this number of subscriber connections, each with the `heard` end of its socket."""
        publisher = self.publishers[topic]
        publisher.impl.connections = [Connection() for _ in range(count)]
        publisher.listener.peer_subscribe(topic, lambda message: None, None)
        return publisher.impl.connections

    def send(self, topic: str, message: Message) -> None:
        """Send a message to a command topic through a connection of its own, and close it."""
        near, far = socket.socketpair()
        connection = SimpleNamespace(header={}, socket=near, read_buff=BytesIO(), done=False)
        self.subscriptions[topic].impl = SimpleNamespace(connections=[connection])
        content = BytesIO()
        message.serialize(content)

        def receive() -> None:
            received = self.heard[topic][0]().deserialize(content.getvalue())
            received._connection_header = connection.header
            self.subscribers[topic](received)

        far.close()
        receiver = threading.Thread(target=receive)
        receiver.start()
        receiver.join(30.0)
        assert not receiver.is_alive(), f"the connection to {topic} is not read"
        near.close()

    def set(self, name: str, value: object) -> None:
        self.parameters[rospy.resolve_name(name)] = value

    def given(self, name: str, default: object = None) -> object:
        """Return a parameter like rospy.get_param; a namespace is a mapping."""
        name = rospy.resolve_name(name)
        if name in self.parameters:
            return self.parameters[name]
        below: dict[str, object] = {}
        for key, value in self.parameters.items():
            if key.startswith(f"{name.rstrip('/')}/"):
                *folders, last = key[len(name.rstrip("/")) + 1 :].split("/")
                place = below
                for folder in folders:
                    place = place.setdefault(folder, {})
                place[last] = value
        return below or default

    def proxy(self, name: str, kind: type, **options: object) -> Callable[..., object]:
        def ask(*args: object, **fields: object) -> object:
            self.proxies.append((name, kind, options))
            if rospy.resolve_name(name) not in self.services:
                raise rospy.ServiceException(f"service [{name}] unavailable")
            return self.call(name, *args, **fields)

        ask.call = ask
        return ask

    def getPid(self) -> int:
        return 7

    def getSystemState(self) -> tuple:
        if isinstance(self.published, Exception):
            raise self.published
        return self.published, [], []

    def lookupService(self, name: str) -> str:
        if name not in self.services:
            raise rosgraph.MasterError(f"unknown service [{name}]")
        return "rosrpc://here:1"

    def getParam(self, name: str) -> object:
        assert name.startswith("/")
        found = self.given(name)
        if found is None:
            raise rosgraph.MasterError(f"Parameter [{name}] is not set")
        return found


class Connection:
    def __init__(self) -> None:
        self.endpoint_id = "/listener"
        self.socket, self.heard = socket.socketpair()
        self.heard.setblocking(False)

    def close(self) -> None:
        self.socket.close()


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Graph:
    """Graph in memory that replaces rospy's functions for the test."""
    for lane in QUEUE_FLUSHER.list_unsent():  # of listeners of tests before, who read no more
        lane.close()
    it = Graph()

    def service(name: str, kind: type, handler: Callable) -> SimpleNamespace:
        it.services[name], it.types[name] = handler, kind
        return SimpleNamespace(shutdown=lambda _reason="": it.services.pop(name, None))

    def publisher(topic: str, kind: type, **options: object) -> Publisher:
        assert "queue_size" in options, f"who sends {topic} waits for those who read it"
        it.publishers[topic] = Publisher(it, topic, kind, options)
        return it.publishers[topic]

    def subscriber(topic: str, kind: type, callback: Callable, **more: object) -> SimpleNamespace:
        it.subscribers[topic], it.heard[topic] = callback, (kind, more)
        it.subscriptions[topic] = SimpleNamespace(
            unregister=lambda: it.subscribers.pop(topic, None), impl=None,
            get_num_connections=lambda: it.sources.get(topic, 0))  # fmt: skip
        return it.subscriptions[topic]

    def log(text: str, *args: object) -> None:
        it.lines.append(text % args if args else text)

    def timer(*given: object) -> SimpleNamespace:
        it.timers.append(given)
        return SimpleNamespace(shutdown=lambda: None)

    def throttled(period: float, text: str) -> None:
        it.periods.append(period)
        it.lines.append(text)

    for name, value in {
        "Service": service, "Publisher": publisher, "Subscriber": subscriber, "Timer": timer,
        "search_param": lambda _name: None, "get_param": it.given, "set_param": it.set,
        "has_param": lambda name: it.given(name) is not None, "ServiceProxy": it.proxy,
        "delete_param": lambda name: it.parameters.pop(rospy.resolve_name(name)), "loginfo": log,
        "logwarn": log, "logerr": log, "logfatal": log, "logerr_throttle": throttled,
        "logwarn_throttle": throttled}.items():
        monkeypatch.setattr(rospy, name, value)
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time.from_sec(it.wall_time)))
    monkeypatch.setattr(rosgraph, "Master", lambda _name: it)
    return it


class Start:
    """Start and end of a node, in which rospy's own part is replaced; signals stay as they are."""

    def __init__(self, graph: Graph, monkeypatch: pytest.MonkeyPatch, logs: Path) -> None:
        self.graph, self.down = graph, False
        self.begun: list[tuple[str, dict[str, bool]]] = []
        self.is_open = False  # to several connections at once
        self.is_ended_early = lambda: False
        self.end_reasons: list[str] = []
        self.ending: list[Callable[[], object]] = []
        self.handled_signals: list[int] = []
        socket_ = SimpleNamespace(listen=lambda _backlog: setattr(self, "is_open", True))
        server = SimpleNamespace(server_sock=socket_, inbound_handler=None)
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(SOURCES))
        monkeypatch.setenv("ROS_LOG_DIR", str(logs))
        for place, name, value in (
            (rospy, "init_node", lambda name, **options: self.begun.append((name, options))),
            (rospy, "is_shutdown", lambda: self.down), (rospy, "on_shutdown", self.ending.append),
            (rospy, "signal_shutdown", self.end),
            (rospy.core, "add_shutdown_hook", lambda _hook: None),
            (rospy.core, "is_shutdown_requested", lambda: self.is_ended_early()),
            (masterslave.ROSHandler, "_connect_topic", lambda *_: None),
            (registration.RegManager, "publisher_update", lambda *_: None),
            (tcpros_base, "start_tcpros_server", lambda: None),
            (tcpros_base, "_tcpros_server", SimpleNamespace(tcp_ros_server=server)),
            (signal, "signal", lambda number, _: self.handled_signals.append(number)),
            (signal, "set_wakeup_fd", lambda *_, **__: -1),
            (logging.getLogger("rosout"), "filters", [])):
            monkeypatch.setattr(place, name, value)

    def end(self, reason: str) -> None:
        self.end_reasons.append(reason)
        self.down = True
        for hook in self.ending:
            hook()

    @property
    def finds_publishers(self) -> bool:
        """Whether rospy has been patched so that it connects to every publisher once."""
        return masterslave.ROSHandler._connect_topic.__module__ == connections.__name__


class Life(Start):
    """Start of a node, and its wall time: while it sleeps the next of `steps` is done; after the
    last one it is shut down. Threads that it starts sleep without a step."""

    def __init__(self, graph: Graph, monkeypatch: pytest.MonkeyPatch, logs: Path) -> None:
        super().__init__(graph, monkeypatch, logs)
        self.now = 100.0
        self._thread, self._sleep = threading.get_ident(), time.sleep
        self.slept: list[float] = []
        self.steps: list[Callable[[], object]] = []
        self.waited: list[tuple[str, float]] = []
        self.threads: list[SimpleNamespace] = []
        monkeypatch.setattr("time.monotonic", lambda: self.now)
        monkeypatch.setattr("time.sleep", self.sleep)
        monkeypatch.setattr(rospy, "get_time", lambda: self.now - 90.0)
        monkeypatch.setattr(rospy, "wait_for_service", self._wait)

    def sleep(self, seconds: float) -> None:
        if threading.get_ident() != self._thread:
            self._sleep(0.01)
            return
        self.slept.append(seconds)
        self.now += seconds
        if self.steps:
            self.steps.pop(0)()
        else:
            self.down = True

    def thread(self, **given: object) -> SimpleNamespace:
        it = SimpleNamespace(**given, started=False)
        it.start = lambda: setattr(it, "started", True)
        self.threads.append(it)
        return it

    def _wait(self, name: str, timeout: float | None = None) -> None:
        self.waited.append((name, timeout))
        if rospy.resolve_name(name) not in self.graph.services:
            raise rospy.ROSException(f"timeout exceeded while waiting for service {name}")


@pytest.fixture
def start(graph: Graph, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Start:
    return Start(graph, monkeypatch, tmp_path / "log")


@pytest.fixture
def life(graph: Graph, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Life:
    return Life(graph, monkeypatch, tmp_path / "log")


@pytest.fixture
def roslaunch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")

    def write(script: str) -> None:
        (folder / "roslaunch").write_text(f"#!/bin/bash\n{script}")
        (folder / "roslaunch").chmod(0o755)

    return write


@pytest.fixture
def face(graph: Graph) -> object:
    """Publishers of the controller on the graph in memory."""
    from run_messages import JOINTS, SETTINGS

    from aras_visual_servo_controller.ros.ros_publisher import RosPublisher

    return RosPublisher(SETTINGS, JOINTS, "camera_optical_frame")


class TimedPacer(Pacer):
    """Pacer without a limit that stores the simulated times at which it was restarted, ns."""

    def __init__(self) -> None:
        self.restarts: list[int] = []
        super().__init__(0.0)

    def restart(self, time_ns: int) -> None:
        self.restarts.append(time_ns)
        super().restart(time_ns)


class TimedThread(SimulationThread):
    """Simulation thread that stores the time limits of calls, s; its pace is as it is set."""

    def __init__(self, *given: object, **more: object) -> None:
        self.limits: list[float] = []
        self.pace: float | None = None
        super().__init__(*given, **more)

    @property
    def real_time_factor(self) -> float:
        return super().real_time_factor if self.pace is None else self.pace

    def call(self, job: Callable[[], object], *limit: float) -> object:
        self.limits += limit
        return super().call(job, *limit)

    def step(self, count: int, limit: float) -> int:
        self.limits.append(limit)
        return super().step(count, limit)


@pytest.fixture
def thread() -> Iterator[TimedThread]:
    """Thread of a paused simulation; each of `batch_hooks` is called after a group of steps."""
    hooks: list[Callable[[int], None]] = []
    it = TimedThread(Simulation, TimedPacer(), paused=True,
                     after_batch=lambda time_ns: [hook(time_ns) for hook in hooks])
    it.batch_hooks = hooks
    it.start()
    yield it
    it.stop()


@pytest.fixture
def api(graph: Graph, thread: SimulationThread) -> SimpleNamespace:
    """Services of gazebo_ros in this world; `resets` lists the times of resets."""
    from aras_sim_bridge.ros.gazebo_api import advertise_gazebo_api
    from aras_sim_bridge.ros.runtime.restart_record import RestartRecord

    it = SimpleNamespace(graph=graph, thread=thread, resets=[], graph_synced=[])
    on_graph = SimpleNamespace(
        sync=lambda: it.graph_synced.append(len(thread.simulation.world.models)),
        restart_record=RestartRecord(True))
    thread.on_time_reset = lambda: it.resets.append(thread.simulation.time_ns)
    it.states = advertise_gazebo_api(thread, on_graph)
    thread.batch_hooks.append(lambda _time_ns: it.states.after_batch(thread.simulation))
    return it


@pytest.fixture
def call(api):
    """Function that calls /gazebo/<name>; a refusal fails unless the test requests the answer."""

    def call(name: str, *args: object, refused: bool = False, **fields: object) -> object:
        answer = api.graph.call(f"/gazebo/{name}", *args, **fields)
        assert getattr(answer, "success", True) is not refused, answer
        return answer

    return call


@pytest.fixture
def step(call):
    return lambda count: call("step_world", count)


@pytest.fixture
def ball(call):
    """Spawn a ball of 2 kg at a height of 100 m, its x axis along the world's y."""
    from stepped_models import BALL, QUARTER

    call("spawn_urdf_model", "ball", BALL, "", Pose(Point(0.0, 0.0, 100.0), QUARTER), "")


@pytest.fixture
def another(call):
    """Function that spawns such a ball as `other` at a pose in a frame."""
    from stepped_models import BALL

    return lambda pose, frame="": call("spawn_urdf_model", "other", BALL, "", pose, frame)


@pytest.fixture
def slider(call):
    """Spawn a cart of 2 kg on a level rail with damping 0.5."""
    from stepped_models import SLIDER

    call("spawn_urdf_model", "slider", SLIDER, "", Pose(), "")


@pytest.fixture
def hear_with(graph: Graph, shipped_arm: object) -> Callable[..., object]:
    """Function that makes a loop with these observers, which stores what it is given."""
    from aras_visual_servo_controller.observation.camera_rig import CameraRig
    from aras_visual_servo_controller.ros.ros_publisher import RosPublisher
    from aras_visual_servo_controller.runner.loop_runner import LoopRunner
    from aras_visual_servo_controller.settings import ControllerSettings

    class HearingRunner(LoopRunner):
        """Loop that stores its inputs, and the observations of images, without processing them."""

        joints = command = None  # joints at the exposure, and the command that was sent since

        def __init__(self, *given: object) -> None:
            self.images, self.told, self.sources, self.stops = [], [], {}, []
            super().__init__(*given)

        def set_source(self, camera: str, source: object) -> None:
            self.sources[camera] = source

        def add_image(self, stamp: float, observe_frame: Callable, camera: str = "") -> None:
            commands = () if self.command is None else (self.command,)
            self.images.append((stamp, observe_frame(self.joints, commands), camera))

        def add_joint_state(self, *given: object) -> None:
            self.told.append(given)

        def emergency_stop(self, pressed: bool) -> None:
            self.stops.append(pressed)

    def make(*observers: object) -> HearingRunner:
        settings = ControllerSettings.from_mapping({}, SOURCES / "aras_visual_servo_controller")
        publisher = RosPublisher(settings, shipped_arm.names, shipped_arm.camera_frame)
        return HearingRunner(settings.make_servo(shipped_arm), CameraRig(observers), settings,
                             publisher, lambda: 0.0)

    return make


@pytest.fixture(scope="session")
def shipped_arm() -> object:
    from aras_visual_servo_bench.experiment.robot_spec import RobotSpec
    from aras_visual_servo_bench.experiment.robots import Robot

    return Robot(RobotSpec()).make_arm()
