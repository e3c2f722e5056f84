"""Live page on a running graph: what it shows and executes, and which requests it refuses."""

import contextlib
import json
import os
import pty
import re
import socket
import subprocess
import threading
import time
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

import pytest

pytest.importorskip("rospy")
websocket = pytest.importorskip("tornado.websocket")

from ros_graph import SLOW_CAMERA, wait_for  # noqa: E402
from tornado.httpclient import HTTPClientError  # noqa: E402
from tornado.ioloop import IOLoop  # noqa: E402

NODES = ("/gazebo", "/aras_visual_servo_dashboard")
TOKEN = "a-token-for-the-tests"


class Viewer:
    """Client of the page in a thread: it records all messages and waits for answers."""

    def __init__(self, port: int) -> None:
        self.told, self.pictures, self.answers, self.shapes = {}, [], [], {}
        self.samples = []
        self._address = f"ws://127.0.0.1:{port}/live?token={TOKEN}"
        self._ready = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()
        assert self._ready.wait(20.0)

    def _run(self) -> None:
        import asyncio

        asyncio.set_event_loop(asyncio.new_event_loop())
        self._loop = IOLoop.current()
        self._loop.run_sync(self._listen)

    async def _listen(self) -> None:
        self._socket = await websocket.websocket_connect(self._address)
        self._ready.set()
        with contextlib.suppress(websocket.WebSocketClosedError):  # while it was answering
            await self._hear()

    async def _hear(self) -> None:
        while (message := await self._socket.read_message()) is not None:
            if isinstance(message, bytes):
                self.pictures.append(message)
                await self._socket.write_message("ack")
                continue
            data = json.loads(message)
            if data["kind"] == "answer":
                self.answers.append(data)
                continue
            await self._socket.write_message("ack")
            self.samples += [row for row in data.pop("samples", []) if row[0] != "clear"]
            self.shapes |= data.pop("shapes", {})
            self.told |= data

    def ask(self, do: str, **given) -> tuple[bool, str]:
        """Send a request; return whether it was executed, and the answer."""
        self.answers.clear()
        message = json.dumps({"do": do, **given})
        self._loop.add_callback(lambda: self._socket.write_message(message))
        answer = wait_for(lambda: self.answers, 200.0, f"an answer to {do}")[0]
        return answer["ok"], answer["text"]

    def phase(self) -> str:
        return self.told.get("controller", {}).get("phase", "")

    def wait(self, phase: str) -> None:
        wait_for(lambda: self.phase() == phase, 120.0, phase)

    def do(self, do: str, **given) -> None:
        """Send a request that is executed."""
        done, text = self.ask(do, **given)
        assert done, text

    def close(self) -> None:
        self._loop.add_callback(self._socket.close)


@pytest.fixture(scope="module")
def taken():
    """A port that is already in use."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    return tmp_path_factory.mktemp("dashboard")


@pytest.fixture(scope="module")
def graph(launch, ros_master, ros_node, taken, directory):
    """The robot with a slow camera, and the page."""
    for name, value in (("token", TOKEN), ("directory", str(directory))):
        ros_master.api.setParam(f"/aras_visual_servo_dashboard/{name}", value)
    return launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=NODES,
                  dashboard=True, dashboard_port=taken, clock_rate=100, camera=SLOW_CAMERA)


@pytest.fixture(scope="module")
def port(graph, taken):
    """Return the next free port, which the node has printed."""
    said = wait_for(lambda: re.search(r"http://127\.0\.0\.1:(\d+)/\?token=", graph.output()), 60.0,
                    "the page's address")  # fmt: skip
    assert int(said[1]) > taken
    assert f"port {taken} is taken" in graph.output()
    return int(said[1])


@pytest.fixture(scope="module")
def keyboard(graph, ros_master):
    """A terminal, and the process of aras_teleop, which reads its keys; None without terminals."""
    try:
        terminal, other = pty.openpty()
    except OSError:
        yield None
        return
    process = subprocess.Popen(["rosrun", "aras_visual_servo_controller", "aras_teleop"],
                               env=ros_master.environment, stdin=other, stdout=other, stderr=other)
    os.close(other)
    yield terminal, process
    process.kill()
    process.wait()
    os.close(terminal)


@pytest.fixture(scope="module")
def viewer(port, keyboard):
    """Client of the page, on which the nodes have been started; at first with another scheme."""
    found = Viewer(port)
    wait_for(lambda: found.told.get("joints"), 60.0, "joints")
    found.do("pause")  # nodes start faster
    done, why = found.ask("servo", scheme="luminance", law="proportional", start="2015",
                          goal="2016")
    assert not done
    assert why.startswith("the controller did not start: goal_2016.yaml holds no image"), why
    assert not found.phase() and not found.told["state"]["controller"]
    found.do("servo", scheme="moments", law="proportional", start="2016", goal="auto")
    found.do("resume")
    found.wait("converged")
    yield found
    found.close()


def test_strangers_are_refused(port):
    with pytest.raises(HTTPError, match="403"):
        urlopen(f"http://127.0.0.1:{port}/?token=wrong", timeout=20)
    with pytest.raises(HTTPClientError, match="403"):
        IOLoop().run_sync(
            lambda: websocket.websocket_connect(f"ws://127.0.0.1:{port}/live?token=none"))
    with urlopen(f"http://127.0.0.1:{port}/?token={TOKEN}", timeout=20) as page:
        assert b"ARAS visual servoing" in page.read()
    own = socket.gethostbyname(socket.gethostname())
    if not own.startswith("127."):
        with pytest.raises((URLError, OSError)):
            urlopen(f"http://{own}:{port}/?token={TOKEN}", timeout=5)


def test_a_run_is_shown_from_its_start(viewer):
    told = viewer.told
    assert told["limits"]["names"] == ["gantry", "J1", "J2", "J3", "J5", "J6"]
    assert told["names"] == ["xn", "yn", "an", "alpha"]
    given = told["state"]
    assert (given["scheme"], given["start"], given["camera"], given["gains"]) == (
        "moments", "2016", "", {"gain": 5.0})
    assert 0.0 < told["real_time_factor"] < 2.0
    assert len(viewer.samples) > 30
    errors = [row[1] for row in viewer.samples if row[1]]
    assert max(map(abs, errors[-1])) < 0.1 * max(map(abs, errors[0]))
    ideal = viewer.shapes["ideal path"]["points"]
    # The camera's comes from another node than the controller's state.
    wait_for(lambda: viewer.shapes["path"]["points"][-3:] == pytest.approx(ideal[-3:], abs=1e-3),
             10.0, "the camera's path to the goal")  # fmt: skip
    assert len(viewer.shapes["path"]["points"]) > 9
    assert viewer.shapes["path"]["points"][:3] == pytest.approx(ideal[:3], abs=1e-3)
    for name in ("desired camera picture", "camera picture", "desired outline"):
        assert viewer.shapes[name]["points"], name
    assert viewer.pictures[-1].startswith(b"\xff\xd8")


def test_the_loop_obeys(viewer):
    assert viewer.ask("hold") == (True, "hold: holding")
    viewer.wait("holding")
    assert viewer.ask("stop") == (True, "stop: stopped")
    viewer.wait("stopped")
    assert viewer.ask("gain", name="gain", value=7.5) == (True, "gain is 7.5")
    wait_for(lambda: viewer.told["state"]["gains"] == {"gain": 7.5}, 20.0, "the new gain")


def test_the_arm_is_driven_by_hand_and_stops_when_let_go(viewer):
    viewer.do("stop")
    viewer.wait("stopped")
    before = viewer.told["joints"][0]
    end = time.monotonic() + 60.0
    while abs(viewer.told["joints"][0] - before) < 0.02 and time.monotonic() < end:
        assert viewer.ask("jog", vx=0.2)[0]
        time.sleep(0.05)
    assert viewer.told["joints"][0] > before + 0.02  # the picture's x is along the gantry
    time.sleep(1.0)
    assert viewer.phase() == "stopped"
    # Servoing begins where the arm was driven to, and does not jump back first.
    moved, began = viewer.told["joints"][0], viewer.told["stamp"]
    viewer.do("start")
    viewer.wait("converged")
    after = [row[4][0] for row in viewer.samples if row[0] > began and row[4]]
    assert abs(after[0] - moved) < 0.02


def test_keys_at_a_terminal_drive_the_camera(viewer, keyboard):
    if keyboard is None:
        pytest.skip("this machine has no terminals to give (/dev/pts)")
    terminal, process = keyboard
    printed = b""
    while b"^C" not in printed:  # its help ends with how it ends
        printed += os.read(terminal, 4096)
    before = viewer.told["joints"][0]
    end = time.monotonic() + 60.0
    while viewer.told["joints"][0] < before + 0.02 and time.monotonic() < end:
        os.write(terminal, b"d")
        time.sleep(0.05)
    assert viewer.told["joints"][0] > before + 0.02
    viewer.wait("stopped")
    os.write(terminal, b"q")
    assert process.wait(20.0) == 0


def test_a_moved_goal(viewer):
    viewer.do("start")
    viewer.wait("converged")
    at = viewer.told["joints"][0]
    viewer.do("pause")
    viewer.do("goal", x=0.03, y=0.0, z=0.0, turn=0.0)
    viewer.do("resume")
    wait_for(lambda: viewer.told["joints"][0] > at + 0.02, 60.0, "the moved goal")
    viewer.wait("converged")


def test_a_bag_is_recorded_and_reported_on_and_a_goal_taught(viewer, directory, port):
    viewer.do("record")
    assert viewer.ask("report")[0] is False
    time.sleep(1.5)
    viewer.do("pause")
    viewer.do("stop_record")
    assert list(directory.glob("bags/*.bag"))
    viewer.do("report")
    viewer.do("resume")
    wait_for(lambda: viewer.told["real_time_factor"] is not None, 20.0, "joint states")
    wait_for(lambda: viewer.told["state"].get("report"), 20.0, "the report's address")
    address = f"http://127.0.0.1:{port}/report/{viewer.told['state']['report']}"
    with urlopen(f"{address}?token={TOKEN}", timeout=20) as page:
        assert b"aras_visual_servo_bench analyze" in page.read()
    viewer.do("teach", name="mine")
    wait_for(lambda: "mine" in viewer.told["choices"]["goals"], 20.0, "the taught goal")


def test_the_camera_is_changed_while_the_nodes_run(viewer):
    """The loop continues with the new camera's images."""
    viewer.do("start")
    viewer.do("camera", preset="wide")
    wait_for(lambda: viewer.told["state"]["camera"] == "wide", 20.0, "the name of the camera")
    last = viewer.told["stamp"]
    wait_for(lambda: [row for row in viewer.samples if row[0] > last + 0.5], 60.0, "samples")
    viewer.wait("converged")
