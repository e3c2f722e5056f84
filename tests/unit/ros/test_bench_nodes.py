"""Smaller nodes and tools of the bench on a graph, and the programs that start them."""

import contextlib
import gc
import json
import os
import runpy
import signal
import subprocess
import sys
import time
import xmlrpc.client
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import rosbag
import rosgraph
import rospy
from aras_visual_servo_controller.msg import ServoState
from gazebo_msgs.srv import GetModelState, GetWorldProperties, SetModelState
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from graph_helpers import until
from run_messages import ARM, joint_states
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header, String

from aras_visual_servo_bench.errors import BenchError
from aras_visual_servo_bench.ros import (
    controller_watch,
    decompress,
    describe,
    mcap,
    move_target,
    ros_launch,
)
from aras_visual_servo_ros import shutdown

SOURCES = Path(__file__).parents[3] / "src"

OTHERS = {"upstream_names/xacro/scripts/xacro", "upstream_names/xacro/scripts/xacro.py"}
PROGRAMS = {str(one.relative_to(SOURCES)) for folder in ("*/nodes", "upstream_*/*/scripts")
            for one in SOURCES.glob(f"{folder}/*") if one.is_file()} - OTHERS


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_a_program_prints_its_help_and_ends(monkeypatch, capsys, program):
    before, name = signal.getsignal(signal.SIGINT), program.rpartition("/")[2]
    collected = gc.isenabled()
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    if name in ("analyze", "bench", "protocol"):  # whose workers import it too
        runpy.run_path(str(SOURCES / program), run_name="__mp_main__")
    try:
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(SOURCES / program), run_name="__main__")
    finally:
        signal.signal(signal.SIGINT, before)
        gc.unfreeze()
        if not collected:
            gc.disable()
    printed = capsys.readouterr()
    if name == "aras_teleop":  # which asks for a terminal before it looks at its words
        assert ended.value.code == 1 and "from a terminal" in printed.err
    else:
        assert not ended.value.code and len(printed.out) > 60
    early = "program import run" in (SOURCES / program).read_text()
    bench = program.startswith("aras_visual_servo_bench/") or program.endswith(("teleop", "teach"))
    assert early is not bench  # of the others a Ctrl-C while they begin leaves no traceback


XACRO = SOURCES / "upstream_names/xacro/scripts"


@pytest.mark.parametrize("name", ["xacro", "xacro.py"])
def test_xacro_finds_packages_and_takes_older_options(monkeypatch, capsys, tmp_path, name):
    pytest.importorskip("xacro")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(SOURCES))
    file = tmp_path / "a.xacro"
    monkeypatch.setattr(sys, "argv", ["xacro", "--inorder", "-i", str(file)])
    for key in ("ament_index_python", "ament_index_python.packages"):
        monkeypatch.delitem(sys.modules, key, raising=False)
    monkeypatch.setattr(sys, "path", [str(XACRO), *sys.path])
    template = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="$(find {})"/>'
    for package, status in (("aras_sim_bridge", None), ("no_such_package", 1)):
        file.write_text(template.format(package))
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(XACRO / name), run_name="__main__")
        told = capsys.readouterr()
        assert bool(ended.value.code) is bool(status)
        if status:
            assert f"there is no such package in {SOURCES}" in f"{ended.value.code}{told.err}"
        else:
            assert f'name="{SOURCES / "aras_sim_bridge"}"' in told.out
    assert str(XACRO) not in sys.path
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(SystemExit, match="PyPI's xacro is not installed: run ./setup.sh"):
        runpy.run_path(str(XACRO / name), run_name="__main__")


NAMESPACE = 'xmlns:xacro="http://ros.org/wiki/xacro"'
OLD = """<robot {} name="old"><property name="half" value="${{1.0 / 2}}"/>
<macro name="bar" params="name *shape">
  <link name="${{name}}"><insert_block name="shape"/></link></macro>
<bar name="a"><box size="${{half}}"/></bar><sensor><bar width="3"/></sensor>
<if value="${{half > 1}}"><never/></if>
{}<include filename="{}"/><gazebo><include><uri>model://x</uri></include></gazebo></robot>"""


@pytest.mark.parametrize("unknown", ["", '<xacro:tool name="t"/>'], ids=["known", "unknown"])
def test_xacro_reads_files_of_before_noetic(tmp_path, unknown):
    """Tags and macros without prefix, as up to Melodic; what is Gazebo's stays as it is."""
    pytest.importorskip("xacro")
    (tmp_path / "part.xacro").write_text(
        f'<robot {NAMESPACE}><xacro:bar name="b"><c/></xacro:bar></robot>')
    file = tmp_path / "old.xacro"
    file.write_text(OLD.format(NAMESPACE, unknown, tmp_path / "part.xacro"))
    ran = subprocess.run([sys.executable, XACRO / "xacro.py", file], capture_output=True, text=True,
                         check=False)
    assert ran.returncode == 0, ran.stderr
    root = ElementTree.fromstring(ran.stdout)
    assert [link.get("name") for link in root.findall("link")] == ["a", "b"]
    assert root.find("link/box").get("size") == "0.5"
    assert root.findtext("gazebo/include/uri") == "model://x"
    assert [child.tag for child in root] == ["link", "sensor", "link", "gazebo"]
    said = ran.stderr.splitlines()
    for tag in ("property", "macro", "insert_block", "if", "include", "bar"):
        assert sum(f"<{tag}> without the prefix" in line for line in said) == 1
    assert sum("<xacro:tool>; it is left out" in line for line in said) == bool(unknown)
    assert len(said) == 6 + bool(unknown)


def test_rviz_takes_the_program_s_place_where_there_is_a_display(monkeypatch, capsys):
    run = runpy.run_path(str(SOURCES / "aras_visual_servo_bench/scripts/show_rviz"))
    begun, asked = [], []
    monkeypatch.setattr(os, "execvp", lambda *given: begun.append(given))
    monkeypatch.setattr(sys, "argv", ["show_rviz", "-d", "x"])
    monkeypatch.setenv("DISPLAY", "far:10.0")  # over ssh
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert run["main"]() == 0 and not begun
    assert capsys.readouterr().err == (
        "show_rviz: rviz is not started: rviz is not installed; the run continues without it\n")
    monkeypatch.setattr("shutil.which", lambda name: "/usr/bin/rviz" if name == "rviz" else None)
    assert run["main"]() == 1 and begun == [("rviz", ["rviz", "-d", "x"])]
    monkeypatch.delenv("DISPLAY")
    assert run["main"]() == 0 and len(begun) == 1
    assert "DISPLAY is not set" in capsys.readouterr().err

    def connect(address):
        asked.append(address)
        return 0 if address == "\0/tmp/.X11-unix/X31" else 2

    def make_socket(family):
        assert family == run["socket"].AF_UNIX
        return contextlib.nullcontext(SimpleNamespace(connect_ex=connect))

    monkeypatch.setattr(run["socket"], "socket", make_socket)
    for display, why in ((":31", ""), ("unix:31.2", ""),
                         (":32.0", "no X server answers on display :32.0")):
        assert run["find_display_problem"](display) == why
    assert asked[:2] == ["/tmp/.X11-unix/X31", "\0/tmp/.X11-unix/X31"]


def test_a_node_runs_and_its_fault_is_one_line(graph, life, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["n", "x", "--help"])  # which a node without `about` takes
    done = []
    assert shutdown.node_main("n", "", lambda: done.append(life.is_open), ValueError,
                              anonymous=True) == 0  # fmt: skip
    assert life.begun == [("n", {"disable_signals": True, "anonymous": True})] and done == [True]
    assert set(life.handled_signals) == {signal.SIGINT, signal.SIGTERM}

    def fail():
        raise ValueError("why % not")

    assert shutdown.node_main("n", "", fail, ValueError) == 1
    assert graph.lines == ["why % not"]
    with pytest.raises(ValueError, match="why"):
        shutdown.node_main("n", "", fail, KeyError)


def test_beats_go_on_until_the_node_or_the_master_ends(graph, life, monkeypatch, capsys):
    life.steps = [lambda: None] * 3
    assert len(list(shutdown.iterate_at_period(0.25))) == 4 and set(life.slept) == {0.25}
    life.down, life.steps = False, [lambda: None] * 99

    def gone():
        raise OSError

    monkeypatch.setattr(graph, "getPid", gone)
    assert 1 < len(list(shutdown.iterate_at_period(0.25))) < 9
    (why,) = life.end_reasons
    assert why == "the ROS master does not answer any more"
    assert capsys.readouterr().err == f"{rospy.get_name()[1:]}: {why}: ending\n"


def test_a_target_is_moved_from_where_it_lies(graph, life, monkeypatch, capsys):
    asked, faults = [], []
    monkeypatch.setattr(rospy, "Rate", lambda rate: SimpleNamespace(
        sleep=lambda: life.sleep(1 / rate)))
    words = ["velocity=[0.01, 0, 0, 0, 0, 0.1]", "__name:=x"]
    monkeypatch.setattr(sys, "argv", ["move_target", *words])
    assert move_target.main() == 1
    assert capsys.readouterr().err.startswith("move_target: no simulation answers within 10 s: ")
    assert life.waited == [("/gazebo/set_model_state", 10.0)]
    half = 0.5**0.5
    lay = Pose(Point(0.1, 0.2, 0.3), Quaternion(0, 0, half, half))

    def put(request):
        asked.append(request.model_state)
        if faults:
            raise faults.pop()
        return SetModelState._response_class(success=True)

    found = {"success": True, "pose": lay}
    rospy.Service("/gazebo/get_model_state", GetModelState, lambda request: (
        graph.lines.append(request.model_name),
        GetModelState._response_class(**found))[1])
    rospy.Service("/gazebo/set_model_state", SetModelState, put)
    life.steps = [lambda: None] * 60
    assert move_target.main() == 0
    assert life.begun[0] == ("move_target", {"disable_signals": True, "anonymous": True})
    assert graph.lines == ["target"] and len(asked) == 61
    assert graph.proxies[-1][2] == {"persistent": True}
    assert {(s.model_name, s.reference_frame) for s in asked} == {("target", "world")}
    first, last = asked[0].pose, asked[-1].pose
    assert (first.position.x, first.position.y) == pytest.approx((0.1, 0.2))
    # A second at 0.01 m/s and 0.1 rad/s.
    moved = np.hypot(last.position.x - 0.1, last.position.y - 0.2)
    assert moved == pytest.approx(0.01, rel=1e-3) and last.position.z == pytest.approx(0.3)
    turned = 2 * np.arctan2(last.orientation.z, last.orientation.w)
    assert turned == pytest.approx(np.pi / 2 + 0.1)
    life.down, life.steps = False, [lambda: None] * 9
    faults.append(rospy.ServiceException("gone"))
    assert move_target.main(["circle=0.02", "frequency=0.2", "--model", "box"]) == 0
    assert len(asked) == 62 and asked[-1].model_name == graph.lines[-1] == "box"
    found.update(success=False, status_message="none of them")
    assert move_target.main(["circle=0.02", "frequency=0.2", "--model", "box"]) == 1
    assert "has no model 'box' (none of them): launch it" in capsys.readouterr().err
    for words, why in ((["circle=1"], "frequency"), (["begin=2"], "the target does not move"),
                       (["circl=1"], "circle"), (["nonsense"], "nonsense")):
        assert move_target.main(words) == 1 and why in capsys.readouterr().err

    def interrupted(*_):
        raise rospy.ROSInterruptException

    monkeypatch.setattr(rospy, "wait_for_service", interrupted)
    assert move_target.main(["circle=0.02", "frequency=0.2"]) == 0
    capsys.readouterr()


def test_compressed_pictures_are_passed_on_raw(graph, life, monkeypatch):
    spun = []
    monkeypatch.setattr(rospy, "spin", lambda: spun.append(1))
    rospy.set_param("~camera", "/eye/camera/")
    assert decompress.main() == 0 and spun == [1]
    assert life.begun == [("decompress", {"disable_signals": True})]
    publisher = graph.publishers["/eye/camera/image_raw"]
    assert publisher.options == {"queue_size": 2}
    kind, options = graph.heard["/eye/camera/image_raw/compressed"]
    assert kind is CompressedImage and options == {"queue_size": 2}
    hear = graph.subscribers["/eye/camera/image_raw/compressed"]
    header = Header(stamp=rospy.Time(3, 5), frame_id="eye")
    colour = np.zeros((4, 6, 3), np.uint8)
    colour[..., 0], colour[2:, :, 2] = 200, 90
    alpha = np.dstack([colour, np.full((4, 6), 255, np.uint8)])
    for pixels, encoding, raw in ((colour, "rgb8", colour[..., ::-1]),
                                  (alpha, "rgb8", colour[..., ::-1]),
                                  (colour[..., 0], "mono8", colour[..., 0])):
        data = cv2.imencode(".png", pixels)[1].tobytes()
        hear(CompressedImage(header=header, format="png", data=data))
        sent = publisher.sent[-1]
        assert (sent.header, sent.encoding, sent.height, sent.width) == (header, encoding, 4, 6)
        assert bytes(sent.data) == raw.tobytes()
    deep = cv2.imencode(".png", np.zeros((4, 6), np.uint16))[1].tobytes()
    for data in (b"no picture", deep):
        hear(CompressedImage(format="odd", data=data))
    assert graph.lines == ["/eye/camera/image_raw/compressed: cannot decode an image (odd)"] * 2
    assert graph.periods == [5.0, 5.0] and len(publisher.sent) == 3
    life.down = True
    hear(CompressedImage(format="png", data=cv2.imencode(".png", colour)[1].tobytes()))
    assert len(publisher.sent) == 3


def test_a_run_is_described_when_something_of_it_is_new(graph, life, monkeypatch):
    near, far = (Pose(Point(x, 0.0, 0.0), Quaternion()) for x in (1e-6, 0.1))
    places, robots, looks = iter([Pose(), near, *[far] * 10]), [], []
    rospy.Service("/gazebo/get_world_properties", GetWorldProperties, lambda _: (
        GetWorldProperties._response_class(model_names=["two", "target"])))
    rospy.Service("/gazebo/get_model_state", GetModelState, lambda asked: (
        robots.append(asked.relative_entity_name),
        GetModelState._response_class(success=True, pose=next(places)))[1])
    fetch = graph.getParam

    def fetched(name):  # the same parameters in another order are not new
        looks.append(life.slept.count(0.2))
        return dict(sorted(fetch(name).items(), reverse=bool(len(looks) % 2)))

    monkeypatch.setattr(graph, "getParam", fetched)
    monkeypatch.setenv("PATH", "")  # without git, which would be waited for by this clock
    graph.parameters |= {"/robot_description": ARM, "/servo/desired": "2015",
                         "/bytes": xmlrpc.client.Binary(b"any")}
    rospy.set_param("~controller", "/servo")
    life.steps = [lambda: None] * 6 + [lambda: rospy.set_param("/more", 1)] + [lambda: None] * 4
    assert describe.main() == 0
    assert life.begun == [("describe", {"disable_signals": True, "disable_rostime": True})]
    assert set(robots) == {"two"} and looks == [0, 5, 10]
    told = graph.told()
    assert told["/aras_visual_servo/experiment"] == (String, 1, True)
    assert told["/aras_visual_servo/target"] == (PoseStamped, 1, True)
    first, second = (json.loads(one.data) for one in
                     graph.publishers["/aras_visual_servo/experiment"].sent)
    assert first["controller"] == "/servo" and first["format"] == 1
    assert first["launch"] == describe.find_launch_commands()
    assert first["versions"]["numpy"] == np.__version__ and "code" in first["versions"]
    assert set(first["goals"]) == {"goal_2015.yaml", "goal_2016.yaml"}
    assert first["parameters"]["bytes"] == "any"
    assert "more" not in first["parameters"] and second["parameters"]["more"] == 1
    lay = [one.pose.position.x for one in graph.publishers["/aras_visual_servo/target"].sent]
    assert lay == [0.0, 0.1]


def test_launches_of_the_same_master_are_found(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://here:1/")
    for pid, words, master in (
        (9, ["python3", "/opt/bin/roslaunch", "p", "a.launch", "x:=1"], "http://here:1"),
        (10, ["/opt/bin/roslaunch", "p", "b.launch"], "http://here:1/"),
        (11, ["roslaunch", "p", "c.launch"], "http://there:1"),
        (12, ["vi", "a", "b", "roslaunch"], "http://here:1")):
        entry = tmp_path / str(pid)
        entry.mkdir()
        (entry / "cmdline").write_bytes("\0".join([*words, ""]).encode())
        (entry / "environ").write_bytes(f"A=b=c\0ROS_MASTER_URI={master}\0".encode())
    (tmp_path / "13").mkdir()
    (tmp_path / "self").symlink_to("9")
    assert describe.find_launch_commands(tmp_path) == [["p", "a.launch", "x:=1"], ["p", "b.launch"]]


def test_a_demo_follows_the_controller(graph, life):
    watch = controller_watch.ControllerWatch()
    assert life.begun == [("aras_visual_servo_demo", dict.fromkeys(
        ("anonymous", "disable_signals", "disable_rostime"), True))]
    assert (watch.phase, watch.start_stamp, watch.has_joint_states) == ("", None, False)
    waiting = {topic.rpartition("/")[2]: more for topic, (_, more) in graph.heard.items()}
    assert waiting == {"joint_states": {"queue_size": 1}, "state": {"queue_size": 10}}
    graph.subscribers["/aras_visual_servo/joint_states"](joint_states(1.0))
    assert watch.has_joint_states and "/aras_visual_servo/joint_states" not in graph.subscribers
    hear = graph.subscribers["/aras_visual_servo/controller/state"]
    for stamp, phase, began, converged in (
        (1.5, "approaching", None, None), (2.5, "servoing", 2.5, None),
        (3.5, "converged", 2.5, 3.5), (4.5, "converged", 2.5, 3.5), (5.5, "holding", 2.5, None),
        (6.5, "converged", 2.5, 6.5)):
        hear(ServoState(header=Header(stamp=rospy.Time.from_sec(stamp)), phase=phase,
                        reason=f"for {phase}"))
        assert (watch.phase, watch.reason) == (phase, f"for {phase}")
        stamps = watch.stamp, watch.start_stamp, watch.convergence_stamp
        assert stamps == (stamp, began, converged)


def test_a_master_is_waited_for_while_its_launch_runs(life, monkeypatch):
    answers = [False, OSError(), True]

    def online(uri):
        assert uri == "http://x"
        answer = answers.pop(0) if answers else False
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(rosgraph, "is_master_online", online)
    life.steps = [lambda: None] * 99
    assert controller_watch.wait_for_master("http://x", lambda: True, 5.0) is True
    assert life.slept == [0.1, 0.1]
    assert controller_watch.wait_for_master("http://x", lambda: False, 5.0) is False
    assert len(life.slept) == 2
    assert controller_watch.wait_for_master("http://x", lambda: True, 1.0) is False
    assert 11 <= len(life.slept) <= 13


def test_a_recorder_is_ended_and_its_bag_waited_for(life, monkeypatch, tmp_path):
    bag = tmp_path / "run.bag"
    assert controller_watch.stop_recorder("http://x", bag) is False
    bag.touch()
    assert controller_watch.stop_recorder("http://x", bag) is True and not life.slept
    bag.unlink()
    active, asked = tmp_path / "run.bag.active", []
    active.touch()
    monkeypatch.setattr(rosgraph, "Master", lambda *given: asked.append(given) or SimpleNamespace(
        lookupNode=lambda node: f"http://{node}"))
    monkeypatch.setattr(controller_watch.xmlrpc.client, "ServerProxy", lambda uri: SimpleNamespace(
        shutdown=lambda *given: asked.append((uri, *given))))
    life.steps = [bag.touch, active.unlink]
    assert controller_watch.stop_recorder("http://x", bag) is True and life.slept == [0.1, 0.1]
    assert asked == [("/aras_visual_servo_demo", "http://x"),
                     ("http:///record", "/aras_visual_servo_demo", "the run has ended")]
    active.touch()
    began, life.steps = life.now, [lambda: None] * 400
    assert controller_watch.stop_recorder("http://x", bag) is False
    assert life.now - began == pytest.approx(15.0, abs=0.2)


def test_a_bag_is_converted_message_by_message(tmp_path):
    reader = pytest.importorskip("mcap.reader")
    path, out, parts = tmp_path / "a.bag", tmp_path / "a.mcap", []
    with rosbag.Bag(str(path), "w") as bag:
        for k in range(501):
            bag.write("/a", String(f"text {k}"), rospy.Time(10, 1000 * k))
        bag.write("/joints", joint_states(1.5), rospy.Time(11))
    assert mcap.convert(path, out, parts.append) == {"/a": 501, "/joints": 1}
    assert parts == [0.0, 500 / 502] and not (tmp_path / "a.mcap.part").exists()
    with out.open("rb") as stream:
        found = reader.make_reader(stream)
        rows = list(found.iter_messages())
        header, metadata = found.get_header(), list(found.iter_metadata())
    assert (header.profile, header.library) == ("ros1", "aras_visual_servo_bench")
    assert [(one.name, one.metadata) for one in metadata] == [("bag", {"source": "a.bag"})]
    assert len(rows) == 502
    schema, channel, message = rows[-2]
    assert (schema.name, schema.encoding) == ("std_msgs/String", "ros1msg")
    assert "string data" in schema.data.decode() and channel.topic == "/a"
    assert channel.message_encoding == "ros1" and channel.metadata == {
        "md5sum": String._md5sum, "topic": "/a"}
    assert (message.log_time, message.publish_time) == (10 * 10**9 + 500_000,) * 2
    assert message.sequence == 500 and String().deserialize(message.data).data == "text 500"
    def full(part):
        assert (tmp_path / "b.mcap.part").exists()
        raise OSError("no room")

    with pytest.raises(BenchError, match=r"^cannot convert .*a\.bag into .*b\.mcap: no room$"):
        mcap.convert(path, tmp_path / "b.mcap", full)
    assert not list(tmp_path.glob("b.*"))
    path.write_bytes(b"no bag")
    with pytest.raises(BenchError, match=r"^cannot convert .*a\.bag into .*b\.mcap: "):
        mcap.convert(path, tmp_path / "b.mcap")
    assert not list(tmp_path.glob("b.*"))
    with rosbag.Bag(str(tmp_path / "e.bag"), "w"):
        pass
    assert mcap.convert(tmp_path / "e.bag", out) == {}


@pytest.fixture
def launch(tmp_path, roslaunch, monkeypatch):
    """A roslaunch that is a script; a signal to a process of any other session is a failure."""
    begin, kill, sessions = subprocess.Popen, os.kill, set()

    def popen(*given, **more):
        made = begin(*given, **more)
        sessions.add(made.pid)
        return made

    def guarded(pid, number):
        if os.getsid(pid) not in sessions:
            raise AssertionError(f"process {pid} is none of ours")
        kill(pid, number)

    monkeypatch.setattr(subprocess, "Popen", popen)
    monkeypatch.setattr(os, "kill", guarded)
    monkeypatch.setenv("MINE", "yes")

    def start(script):
        roslaunch(script)
        begun.append(ros_launch.RosLaunch(["a", "b:=1"], tmp_path / "the.log"))
        return begun[-1]

    begun = []
    yield start
    for one in begun:
        one.stop(0.1)


def test_a_launch_says_what_died_and_its_last_words(launch):
    one = launch('echo "$@ $MINE"; cat; echo; echo ended >&2; exec sleep 60')
    until(lambda: "ended" in one.read_log())
    assert one.running and one.find_death_message() == ""
    assert one.read_log() == "a b:=1 yes\n\nended\n"
    assert one.read_last_lines() == "    a b:=1 yes\n    ended"
    with one.log.open("ab") as log:  # what a node prints need not be text
        log.write(b"\x1b[31m[ERROR] one\x1b[0m\n[FATAL] two\nthree \xff\n"
                  b"[node-2] process has died [pid 1]\n")
    assert one.find_death_message() == "node node-2 died"
    assert one.read_last_lines() == "    [ERROR] one\n    [FATAL] two"
    assert one.read_last_lines(1) == "    [FATAL] two"
    one.stop()
    assert not one.running and one.find_death_message() == "roslaunch (the) ended"


def test_nothing_of_a_launch_is_left_behind(launch, monkeypatch):
    slept, sent, kill = [], set(), os.kill
    clock, wait = time.monotonic, time.sleep
    monkeypatch.setattr(time, "monotonic", lambda: 20.0 * clock())  # less patient
    monkeypatch.setattr(time, "sleep", lambda seconds: (slept.append(seconds), wait(seconds)))
    # A name that is no text: any bytes will do.
    one = launch("trap '' INT TERM; (printf '\\377' >/proc/$BASHPID/comm; echo $BASHPID; sleep 20; "
                 "true) & wait; wait")
    until(lambda: one.read_log().strip().isdigit())
    child = int(one.read_log())
    assert os.getsid(child) != os.getsid(0)
    monkeypatch.setattr(os, "kill", lambda *given: (sent.add(given), kill(*given)))
    one.stop(0.1)
    assert {(child, signal.SIGTERM), (child, signal.SIGKILL)} <= sent and 0.1 in slept
    assert not one.running and until(lambda: not Path(f"/proc/{child}").exists() or (
        b"Z" in Path(f"/proc/{child}/stat").read_bytes().rpartition(b")")[2].split()[:1]))


def test_a_launch_is_interrupted_when_its_parent_is_killed(launch):
    # PR_GET_PDEATHSIG
    ask = "import ctypes as c; n = c.c_int(); c.CDLL(None).prctl(2, c.byref(n)); print(n.value)"
    one = launch(f"exec {sys.executable} -SE -c '{ask}'")
    assert until(lambda: not one.running) and int(one.read_log()) == signal.SIGINT
