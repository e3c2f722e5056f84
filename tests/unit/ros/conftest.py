"""ROS graph without a master: services, topics and parameters in memory, with the simulation.

Message types of our own packages come from the build where there is one, else they are generated
here from their .msg and .srv files.
"""

from __future__ import annotations

import atexit
import importlib.util
import math
import os
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import pytest
import rosgraph
import rospy
from genpy import Message
from genpy.generator import MsgGenerator, SrvGenerator
from geometry_msgs.msg import Point, Pose, Quaternion

from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_visual_servo_ros import parameters
from aras_visual_servo_ros.send_queue import QUEUE_FLUSHER

sys.path.insert(0, str(Path(__file__).parent))
SOURCES = Path(__file__).parents[3] / "src"
OURS = ("aras_sim_bridge", "aras_visual_servo_camera", "aras_visual_servo_controller")
GENACTION = "/usr/lib/actionlib_msgs/genaction.py"
SLIDER = """<robot name="slider"><link name="world"/>
  <joint name="rail" type="prismatic">
    <parent link="world"/><child link="cart"/><origin xyz="0 0 1"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="2" effort="100" velocity="10"/><dynamics damping="0.5"/></joint>
  <joint name="bolt" type="fixed"><parent link="cart"/><child link="box"/></joint>
  <link name="cart"><inertial><origin xyz="0.1 0.2 0.3"/><mass value="2"/>
    <inertia ixx="1" iyy="1.1" izz="1.2" ixy="0.01" ixz="0.02" iyz="0.03"/></inertial></link>
  <link name="box"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
</robot>"""
BALL = """<robot name="ball"><link name="ball"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
QUARTER = Quaternion(0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))  # about z


def generate(folder: Path) -> None:
    """Write the Python modules of our message packages below `folder`."""
    packages = {path.parent.name: path.parent
                for path in SOURCES.glob("upstream_msgs/*/package.xml")}
    packages |= {name: SOURCES / name for name in OURS}
    search = {path.parent.name: [str(path)] for path in Path("/usr/share").glob("*_msgs/msg")}
    search |= {name: [str(path / "msg"), str(folder / name)] for name, path in packages.items()}
    for name, path in packages.items():
        (folder / name).mkdir()
        (folder / name / "__init__.py").touch()
        for action in path.glob("action/*.action"):
            command = [sys.executable, GENACTION, action, "-o", folder / name]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    for name, path in packages.items():
        extra = (folder / name).glob("*.msg")
        for kind, generator, files in (
            ("msg", MsgGenerator(), [*path.glob("msg/*.msg"), *extra]),
            ("srv", SrvGenerator(), [*path.glob("srv/*.srv")]),
        ):
            if not files:
                continue
            out = folder / name / kind
            generator.generate_messages(name, map(str, files), str(out), search)
            lines = [f"from ._{file.stem} import *\n" for file in files]
            (out / "__init__.py").write_text("".join(lines))


def remove(folder: Path, owner: int) -> None:
    """Delete the folder in the process that made it, not in its forked processes."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


if importlib.util.find_spec("gazebo_msgs") is None:
    made = Path(tempfile.mkdtemp(prefix="aras_messages_"))
    atexit.register(remove, made, os.getpid())
    generate(made)
    sys.path.append(str(made))
    for name in OURS:
        importlib.import_module(name).__path__.append(str(made / name))


def on_wire(message: Message) -> Message:
    """Check that a message can be sent, and return it."""
    message.serialize(BytesIO())
    return message


class Publisher:
    """Replacement of rospy.Publisher that stores messages; the test sets `listeners`."""

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
        self.parameters: dict[str, object] = {}
        self.lines: list[str] = []
        self.periods: list[float] = []  # s, of lines that are written once in a while
        self.timers: list[tuple] = []
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

    def set(self, name: str, value: object) -> None:
        """Set a parameter, like rospy.set_param."""
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
        """Return a service proxy, like rospy.ServiceProxy."""

        def ask(*args: object, **fields: object) -> object:
            self.proxies.append((name, kind, options))
            if rospy.resolve_name(name) not in self.services:
                raise rospy.ServiceException(f"service [{name}] unavailable")
            return self.call(name, *args, **fields)

        ask.call = ask
        return ask

    def getPid(self) -> int:
        """Answer like the master's getPid."""
        return 7

    def lookupService(self, name: str) -> str:
        """Answer like the master's lookupService."""
        if name not in self.services:
            raise rosgraph.MasterError(f"unknown service [{name}]")
        return "rosrpc://here:1"

    def getParam(self, name: str) -> object:
        """Answer like the parameter server's getParam."""
        assert name.startswith("/")
        found = self.given(name)
        if found is None:
            raise rosgraph.MasterError(f"Parameter [{name}] is not set")
        return found


class Connection:
    """A subscriber's connection with the interface of rospy."""

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
        return SimpleNamespace(unregister=lambda: it.subscribers.pop(topic, None), impl=None,
                               get_num_connections=lambda: it.sources.get(topic, 0))

    def log(text: str, *args: object) -> None:
        it.lines.append(text % args if args else text)

    monkeypatch.setattr(rospy, "Service", service)
    monkeypatch.setattr(rospy, "Publisher", publisher)
    monkeypatch.setattr(rospy, "Subscriber", subscriber)
    monkeypatch.setattr(rospy, "Timer", lambda *given: it.timers.append(given))
    monkeypatch.setattr(rospy, "get_param", it.given)
    monkeypatch.setattr(parameters.rosgraph, "Master", lambda _name: it)
    monkeypatch.setattr(rospy, "set_param", it.set)
    monkeypatch.setattr(rospy, "has_param", lambda name: it.given(name) is not None)
    monkeypatch.setattr(
        rospy, "delete_param", lambda name: it.parameters.pop(rospy.resolve_name(name))
    )
    monkeypatch.setattr(rospy, "ServiceProxy", it.proxy)
    for name in ("loginfo", "logwarn", "logerr", "logfatal"):
        monkeypatch.setattr(rospy, name, log)

    def throttled(period: float, text: str) -> None:
        it.periods.append(period)
        it.lines.append(text)

    for name in ("logerr_throttle", "logwarn_throttle"):
        monkeypatch.setattr(rospy, name, throttled)
    return it


class Life:
    """Life cycle of a node: its start, the wall time while it sleeps, and its shutdown.

    While it sleeps the next of `steps` is done; after the last one the node is shut down.
    """

    def __init__(self, graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
        self.graph, self.down, self.now = graph, False, 100.0
        self.begun: list[tuple[tuple[str, ...], dict[str, bool]]] = []
        self.slept: list[float] = []
        self.steps: list[Callable[[], object]] = []
        self.ending: list[Callable[[], object]] = []
        self.waited: list[tuple[str, float]] = []
        self.threads: list[SimpleNamespace] = []
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(SOURCES))
        monkeypatch.setattr("time.monotonic", lambda: self.now)
        monkeypatch.setattr("time.sleep", self.sleep)
        monkeypatch.setattr(rospy, "is_shutdown", lambda: self.down)
        monkeypatch.setattr(rospy, "on_shutdown", self.ending.append)
        monkeypatch.setattr(rospy, "get_time", lambda: self.now - 90.0)
        monkeypatch.setattr(rospy, "wait_for_service", self._wait)

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds
        if self.steps:
            self.steps.pop(0)()
        else:
            self.down = True

    def begin(self, *given: str, **options: bool) -> None:
        """Replacement of begin_node."""
        self.begun.append((given, options))

    def thread(self, **given: object) -> SimpleNamespace:
        """Replacement of threading.Thread; the test calls its function."""
        it = SimpleNamespace(**given, started=False)
        it.start = lambda: setattr(it, "started", True)
        self.threads.append(it)
        return it

    def _wait(self, name: str, timeout: float) -> None:
        self.waited.append((name, timeout))
        if rospy.resolve_name(name) not in self.graph.services:
            raise rospy.ROSException(f"timeout exceeded while waiting for service {name}")


@pytest.fixture
def life(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> Life:
    """Life cycle of the one node that the test runs."""
    return Life(graph, monkeypatch)


@pytest.fixture
def face(graph: Graph) -> object:
    """Publishers of the controller on the graph in memory."""
    from run_messages import JOINTS, SETTINGS

    from aras_visual_servo_controller.ros.ros_publisher import RosPublisher

    return RosPublisher(SETTINGS, JOINTS, "camera_optical_frame")


@pytest.fixture
def thread(request: pytest.FixtureRequest) -> Iterator[SimulationThread]:
    """Thread of a simulation with only the ground, paused at time 0; each of `batch_hooks` is
    called after a group of steps."""
    hooks: list[Callable[[int], None]] = []
    it = SimulationThread(Simulation, Pacer(0.0), paused=True,
                          after_batch=lambda time_ns: [hook(time_ns) for hook in hooks])
    it.batch_hooks = hooks
    it.start()
    yield it
    it.stop()


@pytest.fixture
def api(graph: Graph, thread: SimulationThread) -> SimpleNamespace:
    """Services of gazebo_ros in this world; `resets` lists the times of resets."""
    from aras_sim_bridge.ros.gazebo_api import GazeboApi
    from aras_sim_bridge.ros.runtime.restart_record import RestartRecord

    it = SimpleNamespace(graph=graph, thread=thread, resets=[], graph_synced=[])
    on_graph = SimpleNamespace(
        sync=lambda: it.graph_synced.append(len(thread.simulation.world.models)),
        restart_record=RestartRecord(True),
    )
    it.api = GazeboApi(
        thread, on_graph, lambda: it.resets.append(thread.simulation.time_ns)
    )
    thread.batch_hooks.append(lambda _time_ns: it.api.states.after_batch(thread.simulation))
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
    call("spawn_urdf_model", "ball", BALL, "", Pose(Point(0.0, 0.0, 100.0), QUARTER), "")


@pytest.fixture
def another(call):
    """Function that spawns such a ball as `other` at a pose in a frame."""
    return lambda pose, frame="": call("spawn_urdf_model", "other", BALL, "", pose, frame)


@pytest.fixture
def slider(call):
    """Spawn a cart of 2 kg on a level rail with damping 0.5."""
    call("spawn_urdf_model", "slider", SLIDER, "", Pose(), "")


@pytest.fixture(scope="session")
def shipped_arm() -> object:
    """Arm of the ARAS robot."""
    from aras_visual_servo_bench.experiment.robots import Robot, RobotSpec

    return Robot(RobotSpec()).make_arm()
