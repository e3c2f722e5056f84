"""Server of the live page without a browser, and its messages to viewers."""

import asyncio
import base64
import contextlib
import gzip
import json
import os
import socket
import threading
import time
import urllib.error
import urllib.request
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from page_host import told
from tornado.httpclient import HTTPClientError
from tornado.websocket import websocket_connect

from aras_sim_bridge.description import parse_urdf
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_bench.ros.session_files import SessionFiles
from aras_visual_servo_bench.visualization.drawing_shapes import LINES, DrawingShape
from aras_visual_servo_bench.visualization.robot_visuals import collect_visuals
from aras_visual_servo_bench.visualization.run_drawing import RunDrawing
from aras_visual_servo_bench.web.live.page_state import PageState
from aras_visual_servo_bench.web.live.plot_samples import MAX_SAMPLES
from aras_visual_servo_bench.web.live.robot_model import make_robot_model
from aras_visual_servo_bench.web.live.server import serve
from aras_visual_servo_bench.web.server import NoFreePortError, bind_free_port

SAMPLE = told(error=(0.1, -0.2))


def get(server, path, **headers):
    address = f"http://127.0.0.1:{server.access.port}{path}"
    request = urllib.request.Request(address, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, answer.read(), dict(answer.headers)
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode(), dict(error.headers)


async def opened(server):
    return await websocket_connect(
        f"ws://127.0.0.1:{server.access.port}/live?token={server.access.token}")


def talk(server, *messages, answers=0):
    """Send messages over one socket, and return the answers after the initial messages."""

    async def run():
        viewer = await opened(server)
        heard, told = [], []
        for message in messages:
            await viewer.write_message(message)
        while len(heard) < answers or not told:
            message = await asyncio.wait_for(viewer.read_message(), 20)
            if isinstance(message, str):
                data = json.loads(message)
                (heard if data["kind"] == "answer" else told).append(data)
        viewer.close()
        return heard, told

    return asyncio.run(run())


@pytest.mark.parametrize("path", ["/", "/robot", "/report/x.html", "/live", "/nothing"])
def test_nothing_is_told_without_the_token(server, path, caplog):
    status, text, headers = get(server, path)
    assert (status, headers["Content-Type"]) == (403, "text/plain; charset=utf-8") and text == (
        "Refused: the address has no token: open the address that the simulator has printed.\n")
    assert get(server, f"{path}?token=x")[0] == 403
    for given, why in (({"Host": "evil.example"}, "not available under"),
                       ({"Origin": "http://evil.test"}, "are not allowed")):
        status, text, _ = get(server, f"{path}?token={server.access.token}", **given)
        assert status == 403 and why in text
    assert get(server, f"{path}?token=%ff")[0] == 400
    assert not [entry for entry in caplog.records if entry.name.startswith("tornado")]


def test_whoever_has_it_gets_the_page_and_nothing_that_lets_others_in(server):
    status, text, headers = get(server, f"/?token={server.access.token}")
    assert status == 200 and b"<title>ARAS visual servoing</title>" in text
    assert server.access.token.encode() not in text
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer" and "Server" not in headers
    assert "Access-Control-Allow-Origin" not in headers
    for name, kind in (("app.js", "text/javascript"), ("style.css", "text/css")):
        status, text, headers = get(server, f"/{name}")
        assert (status, headers["Content-Type"]) == (200, f"{kind}; charset=utf-8")
        assert gzip.decompress(get(server, f"/{name}", **{"Accept-Encoding": "gzip"})[1]) == text
    assert b"--goal: #3c78ff;" in text and b".uplot" in text and text.endswith(b"}\n")
    for path in ("/server.js", "/../page_state.py", "/%2e%2e/page_state.py", "/app.js/"):
        assert get(server, f"{path}?token={server.access.token}")[0] == 404


@pytest.mark.parametrize("path", [
    "/report/%00", "/report/a%00b.html", "/report/" + "a" * 5000, "/report/" + "a/" * 3000,
    "/report/%ff", "/report/%2e%2e%2fgoals", "/report/..", "/report/", "/report/%0a", "/%00"])
def test_a_name_that_no_report_has_is_answered_by_one_clear_line(server, reports, tmp_path, path):
    reports(SessionFiles(tmp_path).find_file)
    status, text, _ = get(server, f"{path}?token={server.access.token}")
    assert 400 <= status < 500
    assert text.startswith(("There is n", "<html><title>400: Bad Request"))


def test_a_report_is_a_page_with_scripts_and_pictures_of_its_own(server, reports, tmp_path):
    report = tmp_path / "report.html"
    report.write_text("<title>run \u2116 3</title>", encoding="utf-8")
    reports({"run/report.html": report}.get)
    status, text, headers = get(server, f"/report/run/report.html?token={server.access.token}")
    assert (status, text.decode()) == (200, "<title>run \u2116 3</title>")
    rules = dict(rule.split(" ", 1) for rule in headers["Content-Security-Policy"].split("; "))
    assert rules["script-src"] == rules["style-src"] == "'unsafe-inline'"
    assert rules["img-src"] == "data:" and rules["default-src"] == "'none'"


@pytest.mark.parametrize("host_name", ["127.0.0.1", "0.0.0.0", "::1", "::", ""])
def test_the_address_that_is_printed_answers(host, host_name):
    try:
        with socket.socket(socket.AF_INET6 if ":" in host_name else socket.AF_INET) as probe:
            probe.bind(("::1" if ":" in host_name else "127.0.0.1", 0))
            port = probe.getsockname()[1]
    except OSError as error:
        pytest.skip(f"this machine has no IPv6: {error}")
    said = []
    served = serve(host, host_name, port, "a-token-of-sixteen", said.append)
    try:
        assert any("without encryption" in line for line in said) == (
            host_name not in ("127.0.0.1", "::1"))
        with urllib.request.urlopen(served.access.address, timeout=20) as answer:
            assert answer.status == 200
        assert said[0] == f"the live page is at {served.access.address}"
    finally:
        served.close()


def test_the_robot_is_told_once_there_is_one(server, host):
    path = f"/robot?token={server.access.token}"
    status, text, headers = get(server, path)
    assert status == 200 and json.loads(text)["name"] == "aras_visual_servo"
    assert headers["Content-Type"] == "application/json"
    host.has_robot = False
    assert get(server, path)[:2] == (404, "There is no robot yet.\n")
    host.has_robot = True


def test_requests_are_answered_and_wrong_ones_refused_with_the_reason(server, host):
    host.asked.clear()
    sent = ['{"do": "start"}', '{"do": "step", "steps": -1}', "nonsense", '{"do": "hold"}',
            '{"do": "reset"}']  # fmt: skip
    heard, told = talk(server, *sent, answers=5)
    assert {(str(answer["do"]), answer["ok"], answer["text"]) for answer in heard} == {
        ("start", True, "done: start"), ("step", False, "step: steps is -1, must be >= 1"),
        ("None", False, "a request must be a JSON object"), ("hold", False, "no controller here"),
        ("reset", False, "reset failed: ZeroDivisionError: a fault")}  # fmt: skip
    assert sorted(request.do for request in host.asked) == ["hold", "reset", "start"]
    assert told[0]["kind"] == "full"
    assert told[0]["limits"]["names"] == list(host.arm.names)


def test_what_takes_long_keeps_nobody_waiting(server, host):
    host.waited.clear()
    heard, _ = talk(server, '{"do": "report"}', '{"do": "pause"}', answers=2)
    assert {answer["text"] for answer in heard} == {"done: report", "done: pause"}


def test_of_nine_requests_at_a_time_one_is_refused(server, host):
    async def run():
        viewer, heard = await opened(server), []

        async def answer():
            while True:
                message = await asyncio.wait_for(viewer.read_message(), 20)
                if isinstance(message, str) and '"answer"' in message:
                    return json.loads(message)

        for _ in range(9):  # one after the other
            await viewer.write_message('{"do": "start"}')
            assert (await answer())["text"] == "done: start"
        for _ in range(9):
            await viewer.write_message('{"do": "report"}')
        while len(heard) < 9:
            heard.append(await answer())
            host.waited.set()  # the others may end now
        viewer.close()
        return heard

    host.waited.clear()
    first, *others = asyncio.run(run())
    assert first == {"kind": "answer", "do": None, "ok": False,
                     "text": "8 requests are in progress: wait for their answers"}  # fmt: skip
    assert [other["text"] for other in others] == ["done: report"] * 8


def test_the_ninth_page_is_refused(server):
    async def empty():  # of those before, too
        while server.viewers:
            await asyncio.sleep(0.01)

    async def run():
        await asyncio.wait_for(empty(), 20)
        viewers = [await opened(server) for _ in range(8)]
        own = [viewer.ws_connection.stream.socket for viewer in server.viewers]
        assert all(one.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) for one in own)
        with pytest.raises(HTTPClientError) as refused:
            await opened(server)
        for viewer in viewers:
            viewer.close()
        await asyncio.wait_for(empty(), 20)
        return refused.value

    told = b"Refused: 8 pages are open already: close one of them.\n"
    assert asyncio.run(run()).response.body == told


def open_files():
    """Count the open files of this process by name; the name of a socket or pipe is its number."""
    found = Counter()
    for number in os.listdir("/proc/self/fd"):
        with contextlib.suppress(FileNotFoundError):  # of the listing itself
            found[os.readlink(f"/proc/self/fd/{number}")] += 1
    return found


def test_an_end_is_told_to_the_viewers_and_leaves_nothing_open(host):
    open_before = open_files()
    own = serve(host, "127.0.0.1", 18700 + os.getpid() % 1000, say=lambda _: None)

    async def run():
        viewer = await opened(own)
        await asyncio.wait_for(viewer.read_message(), 20)
        before = {thread for thread in threading.enumerate() if thread.name == "page"}
        at_work = [own.workers.submit(going_on.wait, 20) for _ in range(9)]
        own.close()
        assert [work.cancelled() for work in at_work] == [False] * 4 + [True] * 5
        assert not any(work.done() for work in at_work[:4])  # nobody waits for them
        going_on.set()
        while await asyncio.wait_for(viewer.read_message(), 20) is not None:
            pass
        return viewer.close_code, before

    going_on = threading.Event()
    code, before = asyncio.run(run())
    assert code == 1001 and len(before & set(threading.enumerate())) == len(before) - 1
    assert not open_files() - open_before  # what tests before have left may be closed meanwhile


def test_a_message_too_long_ends_the_socket_and_nothing_else(server):
    async def run():
        viewer = await opened(server)
        await viewer.write_message("x" * 8192)
        while "at most 4096" not in str(await asyncio.wait_for(viewer.read_message(), 20)):
            pass
        await viewer.write_message("x" * 8193)
        while await asyncio.wait_for(viewer.read_message(), 20) is not None:
            pass

    asyncio.run(run())
    assert get(server, f"/?token={server.access.token}")[0] == 200


def test_viewers_are_counted_and_nothing_is_worked_out_without_them(server, host):
    host.viewers.clear()
    talk(server)
    for _ in range(200):
        if host.viewers[-1:] == [0]:
            break
        socket.create_connection(("127.0.0.1", server.access.port)).close()
    assert host.viewers == [1, 0]
    before = host.updates
    time.sleep(0.3)
    assert host.updates == before > 0


def test_a_taken_port_is_said_and_the_next_one_is_taken():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        sockets, word = bind_free_port("127.0.0.1", port)
        assert word == f"port {port} is taken"
        assert port < sockets[0].getsockname()[1] <= port + 20
        for found in sockets:
            found.close()
    with pytest.raises(NoFreePortError, match="cannot listen on 192.0.2.1"):
        bind_free_port("192.0.2.1", port)
    sockets, word = bind_free_port("127.0.0.1", port)
    assert word == "" and sockets[0].getsockname()[1] == port
    for found in sockets:
        found.close()
    with socket.socket() as last:
        last.bind(("127.0.0.1", 65535))
        with pytest.raises(NoFreePortError, match="no free port from 65535 to 65535 on"):
            bind_free_port("127.0.0.1", 65535)


def test_each_thing_is_told_once(host):
    page = PageState()
    page.set_robot(["J1"], [-np.inf], [1.0], [2.0], [False])
    page.add_sample(SAMPLE, [0.5])
    first = page.make_update(host.run_trace, [0.5], [0.0], 1.00049)
    assert first["stamp"] == 1.0  # in milliseconds
    assert first["limits"]["lower"] == [None]
    assert first["samples"] == [[1.0, [0.1, -0.2], [0.0] * 6, [0.0] * 6, [0.5]]]
    assert first["controller"]["phase"] == host.run_trace.state.phase
    assert first["real_time_factor"] == 1.0
    assert (first["choices"], first["state"]) == (page.choices, page.state)
    again = page.make_update(host.run_trace, [0.5], [0.0], 1.1)
    assert set(again) == {"kind", "stamp", "joints", "velocities", "real_time_factor"}
    page.choices, page.state, host.run_trace.factor = {"goals": ["auto"]}, {"robot": 1}, None
    changed = page.make_update(host.run_trace, [0.5], [0.0], 1.15)
    host.run_trace.factor = 1.0
    assert (changed["choices"], changed["state"]) == ({"goals": ["auto"]}, {"robot": 1})
    assert changed["real_time_factor"] is None
    host.move()
    moved = page.make_update(host.run_trace, [0.5], [0.0], 1.2)
    assert "camera picture" in moved["shapes"] and "desired camera picture" not in moved["shapes"]
    whole = page.make_full_message()
    assert whole["samples"] == first["samples"] and whole["controller"] == first["controller"]
    assert whole["shapes"]["camera picture"] == moved["shapes"]["camera picture"]
    json.dumps(whole, allow_nan=False)


def test_what_is_no_more_is_taken_away_from_those_who_saw_it(host):
    page = PageState()
    page.make_update(host.run_trace, [], [], 1.0)
    gone = {s.name for s in host.run_trace.make_shapes() if s.name.startswith("trajectory")}
    assert gone == {"trajectory centre"}
    host.run_trace.clear()
    told = page.make_update(host.run_trace, [], [], 1.1)
    assert told["shapes"]["trajectory centre"] is None
    assert "trajectory centre" not in page.make_full_message()["shapes"]
    assert "shapes" not in page.make_update(host.run_trace, [], [], 1.2)
    host.move()
    goal, host.run_trace.goal = host.run_trace.goal, None
    assert page.make_update(host.run_trace, [], [], 1.3)["shapes"]["desired x"] is None
    host.run_trace.goal = goal
    assert page.make_update(host.run_trace, [], [], 1.4)["shapes"]["desired x"]


@pytest.mark.parametrize(("phases", "kept"), [
    ("servoing converged holding servoing stopped", 5),
    ("servoing stopped waiting approaching approaching servoing", 1),
    ("servoing converged stopped waiting servoing converged", 2),
    ("waiting approaching servoing servoing", 2),
    ("servoing waiting servoing converged waiting converged", 6),  # images that are late
])  # fmt: skip
def test_the_plots_show_one_run(phases, kept):
    page = PageState()
    for number, phase in enumerate(phases.split()):
        page.add_sample(replace(SAMPLE, stamp=1.0 + 0.1 * number, phase=phase), [])
    rows = page.make_full_message()["samples"]
    assert [row[0] for row in rows] == pytest.approx([1.0 + 0.1 * (number - k)
                                                      for k in reversed(range(kept))])  # fmt: skip


def test_other_features_or_a_clock_that_went_back_begin_the_plots_anew_and_none_do_not():
    page = PageState()
    page.add_sample(SAMPLE, [])
    page.add_sample(replace(SAMPLE, stamp=1.1, scheme_output=None), [])
    page.add_sample(replace(SAMPLE, stamp=1.2), [])
    update = page.make_update(None, [], [], 0.0)
    assert [row[1] for row in update["samples"]] == [[0.1, -0.2], [], [0.1, -0.2]]
    assert update["names"] == list(SAMPLE.names)
    page.add_sample(told(1.5, names=("x0",), error=(float("nan"),)), [])
    assert page.make_update(None, [], [], 0.0)["samples"] == [["clear"], [1.5, [None], [0.0] * 6,
                                                                   [0.0] * 6, []]]  # fmt: skip
    page.add_sample(told(0.1, names=("x0",), error=(1.0,)), [])
    assert len(page.make_full_message()["samples"]) == 1


def test_an_image_without_features_keeps_units_and_tolerances(host):
    page, trace = PageState(), RunDrawing(host.arm)
    state = told(names=("xn", "yn", "an", "alpha"), error=(0.1, 0.2, 0.3, 0.4))
    lost = replace(state, stamp=1.1, phase="holding", scheme_output=None)
    page.add_sample(state, [])
    trace.add_state(state, host.q)
    page.make_update(trace, [], [], 0.0)
    page.add_sample(lost, [])
    trace.add_state(lost, host.q)
    controller = page.make_update(trace, [], [], 0.1)["controller"]
    assert controller["phase"] == "holding" and controller["units"] == ["m", "m", "m", "rad"]
    assert len(controller["tolerances"]) == 4


def test_a_long_run_keeps_its_first_seconds(host):
    """An exponential of 0.5 s, then noise of 1e-4 for 3 times as many images as are kept."""
    page, rng = PageState(), np.random.default_rng(0)
    stamps = np.arange(3 * MAX_SAMPLES) / 30
    errors = np.exp(-stamps / 0.5) + 1e-4 * rng.standard_normal(len(stamps))
    state = told(0.0, error=(1.0, 0.0))
    for stamp, error in zip(stamps, errors, strict=True):
        output = replace(state.scheme_output, error=np.array([error, 0.0]))
        page.add_sample(replace(state, stamp=stamp, scheme_output=output), [])
    rows = page.make_full_message()["samples"]
    assert MAX_SAMPLES / 2 < len(rows) <= MAX_SAMPLES == 100 * 30  # 100 s of images
    assert (rows[0][0], rows[-1][0]) == (0.0, pytest.approx(stamps[-1], abs=1e-4))
    assert page.make_update(None, [], [], 0.0)["samples"] == [["clear"], *rows]
    kept = np.interp(stamps, [row[0] for row in rows], [row[1][0] for row in rows])
    assert np.abs(kept - errors)[:90].max() < 2e-3


def test_the_page_is_told_the_tolerances_of_what_it_plots(host):
    """moments: 0.25 % and 0.5 % of the target's depth, 0.005 rad."""
    assert host.run_trace.target == ()
    controller = PageState().make_update(host.run_trace, [], [], 0.0)["controller"]
    assert controller["tolerances"] == [None, None, None, 0.005]
    assert controller["twist_tolerances"] == [None, pytest.approx(np.radians(0.3))]
    goal = host.run_trace.goal
    middle = goal[:3, 3] + 0.3 * goal[:3, 2]
    host.run_trace.target = (
        DrawingShape("target", LINES, middle + np.eye(3) - 1 / 3, (0, 0, 0, 1.0)),
    )
    controller = PageState().make_update(host.run_trace, [], [], 0.0)["controller"]
    host.run_trace.target = ()
    assert controller["tolerances"] == pytest.approx([7.5e-4, 7.5e-4, 1.5e-3, 0.005])
    assert controller["twist_tolerances"] == pytest.approx([4.5e-4, np.radians(0.3)])


def test_the_robots_model_is_the_descriptions(robot, host):
    laughs = "<!DOCTYPE r [<!ENTITY a 'ha'><!ENTITY b '&a;&a;'>]><robot name='&b;'/>"
    with pytest.raises(DescriptionError, match="entity declarations are refused"):
        next(collect_visuals(parse_urdf(robot.urdf, robot.packages.find), laughs))
    model = make_robot_model(robot.urdf, robot.packages.find)
    assert model["name"] == "aras_visual_servo"
    assert {j["name"] for j in model["joints"]} >= set(host.arm.names)
    assert model["links"]["slider"][0]["colour"] == [0.792, 0.82, 0.933, 1.0]
    corners = np.frombuffer(base64.b64decode(model["links"]["base_link"][0]["corners"]), "<f4")
    corners = corners.reshape(-1, 3, 6)
    assert np.abs(corners[..., :3]).max() == pytest.approx(1.75)  # the top of the gantry, m
    edges = np.cross(corners[:, 1, :3] - corners[:, 0, :3], corners[:, 2, :3] - corners[:, 0, :3])
    assert (np.einsum("ij,ij->i", edges, corners[:, 0, 3:]) > 0.0).mean() > 0.99  # faces out
