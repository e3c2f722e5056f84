"""Live page on a running graph: what it shows and executes, and which requests it refuses."""

import contextlib
import json
import os
import pty
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1] / "unit" / "bench"))  # browser
pytest.importorskip("rospy")
websocket = pytest.importorskip("tornado.websocket")

from ros_graph import wait_for, wait_for_message  # noqa: E402
from tornado.httpclient import HTTPClientError  # noqa: E402
from tornado.ioloop import IOLoop  # noqa: E402

NODES = ("/gazebo", "/aras_visual_servo_dashboard", "/aras_visual_servo_markers")
TOKEN = "a-token-for-the-tests"


class Viewer:
    """Client of the page in a thread: it records all messages and waits for answers."""

    def __init__(self, port: int) -> None:
        self.told, self.pictures, self.answers, self.shapes = {}, [], [], {}
        self.samples, self.news = [], 0
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
            self.news += 1
            self.samples += [row for row in data.pop("samples", []) if row[0] != "clear"]
            self.shapes |= data.pop("shapes", {})
            self.told |= data

    def ask(self, do: str, timeout: float = 60.0, **given) -> tuple[bool, str]:
        """Send a request; return whether it was executed, and the answer."""
        self.answers.clear()
        message = json.dumps({"do": do, **given})
        self._loop.add_callback(lambda: self._socket.write_message(message))
        answer = wait_for(lambda: self.answers, timeout, f"an answer to {do}")[0]
        return answer["ok"], answer["text"]

    def phase(self) -> str:
        return self.told.get("controller", {}).get("phase", "")

    def wait(self, phase: str, timeout: float = 60.0) -> None:
        state = f"{phase}, now {self.told.get('controller')}"
        wait_for(lambda: self.phase() == phase, timeout, state)

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
    """The page beside a simulation that goes half as fast as the wall's clock: most of the time it
    goes on while programs start."""
    from gazebo_calls import call
    from gazebo_msgs.srv import GetPhysicsProperties, SetPhysicsProperties

    for name, value in (("token", TOKEN), ("directory", str(directory))):
        ros_master.run(["rosparam", "set", f"/aras_visual_servo_dashboard/{name}", value])
    launched = launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=NODES,
                      dashboard=True, markers=True, dashboard_port=taken,
                      clock_rate=100)  # fmt: skip
    now = call("get_physics_properties", GetPhysicsProperties)
    half = (now.time_step, 0.5 * now.max_update_rate, now.gravity, now.ode_config)
    assert call("set_physics_properties", SetPhysicsProperties, *half).success
    return launched


@pytest.fixture(scope="module")
def port(graph, taken):
    """Return the next free port, which the node has printed."""
    said = wait_for(lambda: re.search(r"http://127\.0\.0\.1:(\d+)/\?token=", graph.output()), 60.0,
                    "the page's address")  # fmt: skip
    assert int(said[1]) > taken
    assert f"port {taken} is taken" in graph.output()
    return int(said[1])


@pytest.fixture(scope="module")
def viewer(port, ros_node):
    found = Viewer(port)
    yield found
    found.close()


def test_strangers_are_refused(port):
    for path, code, why in (
        ("/", 403, "no token"), ("/?token=wrong", 403, "token is wrong"),
        (f"/nothing?token={TOKEN}", 404, "nothing here"),
    ):  # fmt: skip
        with pytest.raises(HTTPError) as refused:
            urlopen(f"http://127.0.0.1:{port}{path}", timeout=20)
        assert refused.value.code == code
        assert why in refused.value.read().decode()
    with pytest.raises(HTTPClientError, match="403"):
        IOLoop().run_sync(
            lambda: websocket.websocket_connect(f"ws://127.0.0.1:{port}/live?token=none"))
    with urlopen(f"http://127.0.0.1:{port}/?token={TOKEN}", timeout=20) as page:
        assert b"ARAS visual servoing" in page.read()
    own = socket.gethostbyname(socket.gethostname())
    if not own.startswith("127."):
        with pytest.raises((URLError, OSError)):
            urlopen(f"http://{own}:{port}/?token={TOKEN}", timeout=5)


def test_a_run_is_seen_from_its_start(viewer, graph, launch):
    wait_for(lambda: viewer.told.get("joints"), 60.0, "joints")
    launch("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
           nodes=("/aras_visual_servo_controller",))  # fmt: skip
    viewer.wait("converged", 120.0)
    told = viewer.told
    assert told["limits"]["names"] == ["gantry", "J1", "J2", "J3", "J5", "J6"]
    assert told["names"] == ["xn", "yn", "an", "alpha"]
    assert told["state"]["gains"] == {"gain": 5.0}
    given = told["state"]
    assert (given["scheme"], given["start"], given["camera"]) == ("moments", "2016", "original")
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


def test_rviz_gets_the_same_shapes(viewer, ros_node):
    from visualization_msgs.msg import Marker, MarkerArray

    array = wait_for_message("/aras_visual_servo/markers", MarkerArray, 20.0)
    by_name = {marker.ns: marker for marker in array.markers}
    path = by_name["path"]
    assert (path.type, path.header.frame_id) == (Marker.LINE_STRIP, "base_link")
    assert len(path.points) * 3 == len(viewer.shapes["path"]["points"])
    assert "moments - converged" in by_name["words"].text
    assert by_name["desired velocity"].action in (Marker.ADD, Marker.DELETE)


def test_the_loop_obeys(viewer):
    assert viewer.ask("hold") == (True, "hold: holding")
    viewer.wait("holding")
    assert viewer.ask("stop") == (True, "stop: stopped")
    viewer.wait("stopped")
    assert viewer.ask("gain", name="gain", value=7.5) == (True, "gain is 7.5")
    wait_for(lambda: viewer.told["state"]["gains"] == {"gain": 7.5}, 20.0, "the new gain")
    done, why = viewer.ask("gain", name="gain", value=1e6)
    assert (done, why) == (False, "gain: value is 1000000.0, must be <= 100")
    done, why = viewer.ask("gain", name="gian", value=1.0)
    assert not done and "did you mean 'gain'?" in why


def test_the_arm_is_driven_by_hand_and_stands_when_let_go(viewer):
    viewer.wait("stopped")
    before = viewer.told["joints"][0]
    end = time.monotonic() + 60.0
    while abs(viewer.told["joints"][0] - before) < 0.02 and time.monotonic() < end:
        assert viewer.ask("jog", vx=0.2)[0]
        time.sleep(0.05)
    assert viewer.told["joints"][0] > before + 0.02  # the picture's x is along the gantry
    time.sleep(3.0)
    first = viewer.told["joints"]
    time.sleep(1.0)
    assert viewer.told["joints"] == pytest.approx(first, abs=1e-3)
    assert viewer.phase() == "stopped"
    # Servoing begins where the arm was driven to, and does not jump back first.
    moved, began = viewer.told["joints"][0], viewer.told["stamp"]
    assert viewer.ask("start")[0]
    viewer.wait("converged")
    after = [row[4][0] for row in viewer.samples if row[0] > began and row[4]]
    assert abs(after[0] - moved) < 0.02


@contextlib.contextmanager
def teleop(ros_master, until: bytes) -> Iterator[int]:
    """Run the teleoperation in a terminal until it prints `until`; `q` ends it."""
    try:
        terminal, other = pty.openpty()
    except OSError as error:
        pytest.skip(f"this machine has no terminals to give (/dev/pts): {error}")
    process = subprocess.Popen(
        ["rosrun", "aras_visual_servo_controller", "aras_teleop"],
        env=ros_master.environment, stdin=other, stdout=other, stderr=other,
    )  # fmt: skip
    os.close(other)
    try:
        said = b""
        while until not in said:
            said += os.read(terminal, 4096)
        yield terminal
        os.write(terminal, b"q")
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        os.close(terminal)


def test_keys_at_a_terminal_drive_the_camera(viewer, ros_master):
    with teleop(ros_master, b"^C") as terminal:  # its help ends with how it ends
        before = viewer.told["joints"][0]
        end = time.monotonic() + 60.0
        while viewer.told["joints"][0] < before + 0.02 and time.monotonic() < end:
            os.write(terminal, b"d")
            time.sleep(0.05)
        assert viewer.told["joints"][0] > before + 0.02
        viewer.wait("stopped")
    assert viewer.ask("start")[0]


def test_time_stands_still_steps_and_begins_anew(viewer):
    assert viewer.ask("pause")[0]
    time.sleep(0.5)
    before = viewer.told["stamp"]
    assert viewer.ask("step", steps=500)[0]
    wait_for(lambda: viewer.told["stamp"] > before + 0.4, 20.0, "half a second")
    time.sleep(0.5)
    assert viewer.told["stamp"] == pytest.approx(before + 0.5, abs=0.02)
    done, why = viewer.ask("step", steps=1.5)
    assert (done, why) == (False, "step: steps is 1.5, must be a whole number")
    assert viewer.ask("resume")[0]
    assert viewer.ask("reset")[0]
    wait_for(lambda: viewer.told["stamp"] < before, 30.0, "time 0")
    viewer.wait("converged", 120.0)


def test_another_scheme_and_a_moved_goal(viewer):
    done, why = viewer.ask("servo", scheme="os:system", law="proportional", start="2016",
                           goal="auto")  # fmt: skip
    assert not done
    assert why.startswith("servo: scheme is 'os:system', which does not exist: use one of alpha, ")
    done, why = viewer.ask("servo", scheme="luminance", law="proportional", start="2015",
                           goal="2016", timeout=90.0)  # fmt: skip
    assert not done
    assert why.startswith("the controller did not start: goal_2016.yaml holds no image"), why
    wait_for(lambda: not viewer.phase(), 20.0, "the page to know that no controller is there")
    wait_for(lambda: not viewer.told["state"]["controller"], 20.0, "the same of its state")
    # Corners, which the goal's file does not hold, are those of the target's geometry.
    done, text = viewer.ask("servo", scheme="points", law="proportional", start="none",
                            goal="2016", timeout=90.0)  # fmt: skip
    assert done, text
    wait_for(lambda: viewer.told["controller"]["scheme"] == "points", 60.0, "points")
    wait_for(lambda: viewer.told["state"]["controller"], 20.0, "the controller")
    viewer.wait("converged", 120.0)
    at = viewer.told["joints"][0]
    done, text = viewer.ask("goal", x=0.03, y=0.0, z=0.0, turn=0.0, timeout=90.0)
    assert done, text
    wait_for(lambda: viewer.told["joints"][0] > at + 0.02, 60.0, "the moved goal")
    viewer.wait("converged", 120.0)


def test_the_camera_is_changed_on_the_page_while_the_nodes_run(viewer, port):
    """Pressed in a browser while the loop servoes: it goes on with the new camera's pictures."""
    browser = pytest.importorskip("browser")
    if browser.chromium() is None:
        pytest.skip(browser.HOW)
    done, text = viewer.ask("servo", scheme="moments", law="proportional", start="none",
                            goal="auto", timeout=90.0)  # fmt: skip
    assert done, text
    wait_for(lambda: viewer.phase() in ("servoing", "converged"), 60.0, "the loop")
    with browser.Browser() as opened:
        tab = opened.open(f"http://127.0.0.1:{port}/?token={TOKEN}")
        tab.wait("window.arasPage && arasPage.state.choices.cameras")
        tab.js("""(() => { const s = document.getElementById("choose-camera"); s.value = "wide";
            s.dispatchEvent(new Event("change"));
            document.querySelector("[data-do=camera]").click(); })()""")
        assert tab.js("document.querySelector('[data-do=camera]').getAttribute('aria-busy')") == (
            "true")  # fmt: skip
        tab.wait("document.querySelector('[data-do=camera]').getAttribute('aria-busy') === 'false'",
                 120.0)  # fmt: skip
        assert not tab.js("document.getElementById('answer').classList.contains('refused')"), (
            tab.js("document.getElementById('answer').textContent"))  # fmt: skip
        tab.wait("arasPage.state.values.camera === 'wide'")
        last = tab.js("arasPage.state.samples.length ? arasPage.state.samples.at(-1)[0] : 0")
        tab.wait(f"arasPage.state.samples.some((s) => s[0] > {last} + 0.5)", 60.0)
        tab.wait("arasPage.state.controller.phase === 'converged'", 120.0)
        assert tab.js("document.querySelectorAll('#plot-error .uplot').length") >= 1


def test_another_target_is_put_there_and_drawn(viewer):
    def edges() -> int:
        return len(viewer.shapes["target"]["points"]) // 6

    wait_for(lambda: edges() == 24, 20.0, "the plates' edges, of two boxes")
    done, text = viewer.ask("target", name="l_shape")
    assert done, text
    wait_for(lambda: edges() == 6, 20.0, "the edges of the L")
    done, text = viewer.ask("target", name="aras")
    assert done, text


def test_a_bag_is_recorded_and_reported_on_and_a_goal_taught(viewer, directory, port):
    done, text = viewer.ask("record")
    assert done, text
    assert viewer.ask("report")[0] is False
    done, why = viewer.ask("teach", name="../../mine")
    assert not done and "letters, digits" in why
    time.sleep(2.0)
    done, text = viewer.ask("stop_record")
    assert done, text
    assert list(directory.glob("bags/*.bag"))
    assert viewer.ask("pause")[0]
    done, text = viewer.ask("report", timeout=200.0)
    assert done, text
    assert viewer.ask("resume")[0]
    wait_for(lambda: viewer.told["real_time_factor"] is not None, 20.0, "joint states")
    wait_for(lambda: viewer.told["state"].get("report"), 20.0, "the report's address")
    address = f"http://127.0.0.1:{port}/report/{viewer.told['state']['report']}"
    with urlopen(f"{address}?token={TOKEN}", timeout=20) as page:
        assert b"aras_visual_servo_bench analyze" in page.read()
    with pytest.raises(HTTPError):
        urlopen(address, timeout=20)
    done, text = viewer.ask("teach", name="mine", timeout=90.0)
    assert done, text
    wait_for(lambda: "mine" in viewer.told["choices"]["goals"], 20.0, "the taught goal")


def test_a_target_that_was_taken_away_is_said_and_not_asked_for_again(viewer, graph, ros_node):
    import rospy
    from gazebo_msgs.srv import DeleteModel

    wait_for(lambda: viewer.told["real_time_factor"] is not None, 20.0, "joint states")
    assert viewer.told["state"]["no_target"] == ""
    assert rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("target").success
    wait_for(lambda: viewer.told["state"]["no_target"], 20.0, "that there is no target")
    assert viewer.told["state"]["no_target"] == "the simulation has no model named target"
    wait_for(lambda: not viewer.shapes["target"]["points"], 20.0, "no target to be drawn")
    before = graph.output()
    time.sleep(3.0)
    assert "get_model_state" not in graph.output()[len(before) :]
    began = time.monotonic()
    done, text = viewer.ask("teach", name="nothing")
    assert not done and "bring it into view" in text, text
    assert time.monotonic() - began < 2.0


def test_without_a_viewer_nothing_is_drawn(viewer, port, ros_node, ros_master):
    second = Viewer(port)
    wait_for(lambda: second.told.get("joints"), 20.0, "the second viewer's joints")
    second.close()
    viewer.close()

    def looking() -> list[str]:
        _, subscribers, _ = ros_master.api.getSystemState()
        nodes = dict(subscribers).get("/aras_visual_servo/camera/overlay", [])
        return [name for name in nodes if "dashboard" in name]

    wait_for(lambda: not looking(), 20.0, "nobody to look at the overlay", 0.5)
