"""Launch files, world, gains, camera presets and rviz configuration are valid for their tools."""

import importlib.machinery
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import types
import xml.etree.ElementTree as ElementTree

import pytest
import yaml
from robot_figures import GAINS, PACKAGE

SHOW_RVIZ = str(PACKAGE.parent / "aras_visual_servo_bench/scripts/show_rviz")
LAUNCH = sorted((PACKAGE / "launch").glob("*.launch"))
GAZEBO_ARGUMENTS = {
    "paused", "use_sim_time", "gui", "headless", "debug", "verbose", "world_name",
    "extra_gazebo_args", "recording", "physics", "output", "respawn_gazebo",
    "use_clock_frequency", "pub_clock_frequency", "enable_ros_network", "server_required",
    "gui_required",
}  # fmt: skip


def root(name: str) -> ElementTree.Element:
    return ElementTree.parse(PACKAGE / "launch" / name).getroot()


def arguments(name: str) -> dict[str, str | None]:
    """Declared arguments of a launch file and their defaults."""
    return {arg.get("name"): arg.get("default") for arg in root(name).findall("arg")}


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.name)
def test_arguments_are_documented_declared_and_used_and_files_are_its_own(path):
    """A name gives the first package of that name: in a workspace over the originals, theirs."""
    for arg in ElementTree.parse(path).getroot().findall("arg"):
        assert arg.get("doc"), f"argument {arg.get('name')} has no doc="
        assert arg.get("default", arg.get("value")) is not None
    text = path.read_text()
    used = set(re.findall(r"\$\(arg (\w+)\)", text)) | set(re.findall(r"arg\('(\w+)'\)", text))
    declared = set(arguments(path.name))
    assert used <= declared and ("pass_all_args" in text or declared <= used)
    assert not re.search(r"(find(\('| )|pkg=\")aras_visual_servo_gazebo", text)
    for name in re.findall(r"\$\(dirname\)/([\w./]+)", text):
        assert (path.parent / name).exists(), name


def test_gazebo_arguments_are_offered_and_passed_on():
    launch = root("aras_visual_servo_gazebo.launch")
    own = arguments("aras_visual_servo_gazebo.launch")
    assert set(own) >= GAZEBO_ARGUMENTS | {"show_rviz"}
    (world,) = [i for i in launch.findall("include") if "empty_world" in i.get("file")]
    assert {arg.get("name") for arg in world.findall("arg")} >= GAZEBO_ARGUMENTS
    both = {**own, **arguments("aras_visual_servo_controller.launch")}
    assert arguments("aras_visual_servo.launch") == both
    (group,) = [g for g in launch.findall("group") if g.get("ns") == "/gazebo/cameras"]
    assert group.get("clear_params") == "true"  # an earlier preset leaves nothing behind
    assert group.find("param").get("name") == "labrob/camera"


def test_every_configured_controller_is_started_with_its_gains():
    controllers = yaml.safe_load((PACKAGE / "config/aras_visual_servo_control.yaml").read_text())
    (spawner,) = root("aras_visual_servo_controller.launch").findall("node[@type='spawner']")
    given = arguments("aras_visual_servo_controller.launch")
    assert given["namespace"] == "/aras_visual_servo"
    assert " ".join(spawner.get("args").split()) == (
        "--namespace=$(arg namespace) joint_state_controller $(arg controllers)")
    robot = controllers["aras_visual_servo"]
    assert robot.pop("joint_state_controller") == {
        "type": "joint_state_controller/JointStateController", "publish_rate": 100}
    assert set(robot) == set(GAINS) == set(given["controllers"].split())
    for name, (joint, p, i, d, i_clamp) in GAINS.items():
        assert robot[name] == {
            "type": "effort_controllers/JointPositionController", "joint": joint,
            "interpolate": True, "pid": {"p": p, "i": i, "d": d, "i_clamp": i_clamp},
        }  # fmt: skip
        # control_toolbox reads doubles; an integer on the parameter server is another type.
        assert all(isinstance(gain, float) for gain in robot[name]["pid"].values())


def test_camera_presets():
    files = (PACKAGE / "config" / "cameras").glob("*.yaml")
    presets = {path.stem: yaml.safe_load(path.read_text()) for path in files}
    size = {"width": 320, "height": 240, "update_rate": 30}
    assert presets["original"] == {"horizontal_fov": 2.0, **size}
    assert presets["calibrated"] == {
        "horizontal_fov": 1.41, **size, "distortion_model": "plumb_bob",
        "camera_matrix": {"fx": 195.0507, "fy": 195.0992, "cx": 162.4058, "cy": 127.1973},
        "distortion_coefficients": [-0.33060, 0.1170, 0, 0, 0],
    }  # fmt: skip
    assert arguments("aras_visual_servo_gazebo.launch")["camera"] in presets


def test_the_recording_holds_what_the_graph_carries():
    topics, robot = set(recorder().split()), "/aras_visual_servo"
    assert topics >= {f"{robot}/{name}/command" for name in GAINS}
    assert topics >= {"/clock", "/tf", "/tf_static", "/rosout", "/gazebo/performance_metrics",
                      "/labrob/camera/image_raw/compressed", "/labrob/camera/camera_info"}
    assert "/labrob/camera/image_raw" not in topics
    assert topics >= {f"{robot}/{name}" for name in (
        "joint_states", "experiment", "target", "camera/data", "camera/moments",
        "controller/state", "controller/camera_twist")}  # fmt: skip


def load(path, *given, runs_commands=False, **environment):
    """The configuration of a launch file; by default commands that make parameters are not run."""
    roslaunch = pytest.importorskip("roslaunch")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("ROS_IP", "ROS_HOSTNAME", "ROS_MASTER_URI"):
            patch.delenv(name, raising=False)
        packages = {"ROS_PACKAGE_PATH": f"{PACKAGE.parent}:/usr/share"}
        for name, value in (packages | environment).items():
            patch.setenv(name, value)
        if not runs_commands:
            patch.setattr(roslaunch.xmlloader.XmlLoader, "param_value", lambda *_: "")
        launch = [(str(PACKAGE / "launch" / path), list(given))]
        return roslaunch.config.load_config_default(launch, None, assign_machines=False)


def recorder(*given):
    """The recorder's arguments, as roslaunch works them out."""
    nodes = load("record.launch", "bag:=/tmp/run.bag", *given).nodes
    assert {node.type for node in nodes} == {"record", "describe"}
    return next(node.args for node in nodes if node.type == "record")


@pytest.mark.parametrize(("given", "there", "missing"), [
    ([], ["--output-name=/tmp/run.bag", "--repeat-latched"], ["--split", "--max-splits"]),
    (["raw:=true"], ["/labrob/camera/image_raw"], ["/labrob/camera/image_raw/compressed"]),
    (["split:=200"], ["--split", "--size=200"], ["--max-splits"]),
    (["split:=200", "most:=3"], ["--split", "--size=200", "--max-splits=3"], []),
    (["most:=3"], [], ["--split", "--max-splits=3"]),
    (["camera:=/other/eye"], ["/other/eye/image_raw/compressed", "/other/eye/camera_info"], []),
    (["namespace:=/mine", "controllers:=pan  lift"],
     ["/mine/joint_states", "/mine/pan/command", "/mine/lift/command"],
     ["/aras_visual_servo/joint_states", "/mine/command", "/mine/gantry_position_controller"]),
    (["controllers:="], ["/aras_visual_servo/joint_states"], ["/aras_visual_servo//command"]),
])  # fmt: skip
def test_the_recorder_takes_pictures_and_limits_as_it_is_told(given, there, missing):
    words = recorder(*given).split()
    assert set(there) <= set(words) and not set(missing) & set(words), words


END = PACKAGE.parent / "aras_visual_servo_bench/scripts/report_recorder_end"


def run_recorder(words, script=""):
    """A recorder that is a shell with this script, below the one that reports its end."""
    shell = ["sh", "-c", script] if script else []
    return subprocess.run([sys.executable, END, *shell, *words], timeout=20, check=False, text=True,
                          capture_output=True)  # fmt: skip


def test_a_recorder_that_aborts_is_reported_with_the_room_on_its_disk(tmp_path):
    """rosbag's recorder ended with -6, and the launch's log did not say why."""
    done = run_recorder([f"--output-name={tmp_path}/run.bag"], "kill -ABRT $$")
    assert done.returncode == 134 and done.stderr.count("\n") == 1
    assert "ended by signal 6" in done.stderr and f" MB are free in {tmp_path}" in done.stderr
    done = run_recorder(["true"])
    assert (done.returncode, done.stderr) == (0, "")
    text = {"text": True, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, END, "sh", "-c", "echo up; exec sleep 60"], **text
                          ) as asked:  # fmt: skip
        assert asked.stdout.readline() == "up\n"
        time.sleep(0.3)
        asked.send_signal(signal.SIGINT)
        assert asked.communicate(timeout=20)[1] == ""


def test_a_recorder_does_not_start_on_a_full_disk():
    done = run_recorder(["--output-name=/proc/run.bag"], "echo up")
    assert (done.returncode, done.stdout) == (0, "") and done.stderr.count("\n") == 1
    assert "does not start: the disk is full, 0.0 MB are free in /proc: make room" in done.stderr


@pytest.mark.parametrize(("script", "words"), [
    ("trap 'exit 0' INT; while :; do sleep 0.1; done", "recorded until then is in the bag"),
    ("trap 'exit 3' INT; while :; do sleep 0.1; done", "rosbag reindex BAG.active recovers the"),
])  # fmt: skip
def test_a_recorder_ends_before_its_disk_is_full(tmp_path, monkeypatch, capfd, script, words):
    """What it has to write then has room: a file without a name is kept for it until then."""
    loader = importlib.machinery.SourceFileLoader("report_recorder_end", str(END))
    module = types.ModuleType(loader.name)
    loader.exec_module(module)
    looks, kept, make, used = iter([9e9] * 5), [], tempfile.TemporaryFile, shutil.disk_usage("/")

    def keep(**options):
        kept.append(make(**options))
        return kept[-1]

    monkeypatch.setattr(tempfile, "TemporaryFile", keep)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: used._replace(free=next(looks, 1e6)))
    monkeypatch.setattr(sys, "argv", ["x", "sh", "-c", script, f"--output-name={tmp_path}/a.bag"])
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        assert module.main() == 0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    line = capfd.readouterr().err
    assert line.count("\n") == 1 and words in line and f"disk of {tmp_path} is full" in line
    assert [file.closed for file in kept] == [True]


def test_world_has_floor_and_sun_but_no_shadows():
    world = ElementTree.parse(PACKAGE / "world" / "aras_visual_servo.world").getroot().find("world")
    assert world.find("scene/shadows").text == "0"
    assert world.find("light[@type='directional']/cast_shadows").text == "0"
    assert world.find("model[@name='ground_plane']/static").text == "1"
    assert float(world.find("physics/max_step_size").text) == 0.001
    assert world.find("gravity").text.split() == ["0", "0", "-9.8"]


def test_rviz_shows_the_robot_its_frames_the_images_and_the_run():
    config = yaml.safe_load((PACKAGE / "rviz" / "aras_visual_servo.rviz").read_text())
    manager = config["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "base_link"
    shown = [d for d in manager["Displays"] if d["Enabled"]]
    assert {"rviz/RobotModel", "rviz/Grid"} <= {d["Class"] for d in shown}
    assert "rviz/TF" in {d["Class"] for d in manager["Displays"]}  # to be ticked: it hides the run
    assert {d["Image Topic"] for d in shown if d["Class"] == "rviz/Image"} == {
        "/labrob/camera/image_raw",
        "/aras_visual_servo/camera/thresholded_image",
        "/aras_visual_servo/camera/overlay",
    }
    drawn = {d["Marker Topic"] for d in shown if d["Class"] == "rviz/MarkerArray"}
    assert drawn == {"/aras_visual_servo/markers"}


@pytest.mark.parametrize(("display", "why"), [
    ("", "DISPLAY is not set"), (":4711", "no X server answers on display :4711"),
    (":{process}", ""),
])  # fmt: skip
def test_without_a_display_rviz_says_so_and_the_run_goes_on(tmp_path, display, why):
    tmp_path.joinpath("rviz").write_text("#!/bin/sh\necho \"shown $@\"\n")
    tmp_path.joinpath("rviz").chmod(0o755)
    display = display.format(process=os.getpid())  # a display that no other process has
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(f"\0/tmp/.X11-unix/X{os.getpid()}")
        server.listen()
        done = subprocess.run(
            [sys.executable, SHOW_RVIZ, "-d", "x.rviz"], capture_output=True, text=True, timeout=20,
            env={"PATH": f"{tmp_path}:{os.environ['PATH']}", "DISPLAY": display}, check=False,
        )  # fmt: skip
    said = f"show_rviz: rviz is not started: {why}; the run continues without it\n"
    assert (done.returncode, done.stdout, done.stderr) == (
        (0, "", said) if why else (0, "shown -d x.rviz\n", ""))


def test_markers_come_with_rviz_or_when_asked_for_and_a_replay_is_shown_as_a_run_is():
    """The same window with the same drawing in it, or the same line where there is no display."""
    for given, wanted in (((), set()), (("show_rviz:=true",), {"markers", "show_rviz"}),
                          (("show_rviz:=true", "markers:=false"), {"show_rviz"}),
                          (("markers:=true",), {"markers"}),
                          (("dashboard:=true",), {"dashboard"})):  # fmt: skip
        types = {node.type for node in load("aras_visual_servo_gazebo.launch", *given).nodes}
        assert types & {"markers", "show_rviz", "dashboard"} == wanted
    trees = [root(f"{name}.launch") for name in ("aras_visual_servo_gazebo", "replay")]
    for kind in ("markers", "show_rviz"):
        run, replay = ([n.attrib for n in tree.iter("node") if n.get("type") == kind]
                       for tree in trees)  # fmt: skip
        assert run == replay and len(run) == 1
    run, replay = (tree.find("arg[@name='markers']").get("default") for tree in trees)
    assert run == replay == "$(arg show_rviz)"


def test_the_description_is_the_shipped_one_with_what_is_asked_for():
    """A moved camera, and joints without friction; what is made of it: test_programs.py."""
    plain, changed = (
        load("aras_visual_servo_gazebo.launch", *given, runs_commands=True
             ).params["/robot_description"].value
        for given in ((), ("camera_rpy:=-0.1 0 0", "camera_xyz:=0.01 0 0", "joint_friction:=False"))
    )  # fmt: skip
    assert plain == (PACKAGE / "robots" / "aras_visual_servo.urdf").read_text()
    robot = ElementTree.fromstring(changed)
    origin = robot.find("joint[@name='camera_mount_joint']/origin")
    values = [[float(v) for v in origin.get(key).split()] for key in ("xyz", "rpy")]
    assert values == [[0.01, 0, 0], [-0.1, 0, 0]]
    assert {float(one.get("friction")) for one in robot.iter("dynamics")} == {0.0}


@pytest.mark.parametrize(("scheme", "layout"), [("kernel", "kernel"),
                                                ("my_lab.schemes:Mine", "moments")])
def test_the_layout_follows_the_scheme(scheme, layout):
    config = load("aras_visual_servo_nodes.launch", f"scheme:={scheme}", runs_commands=True)
    values = {name: parameter.value for name, parameter in config.params.items()}
    assert values["/aras_visual_servo_camera/layout"] == layout
    assert values["/aras_visual_servo_controller/scheme"] == scheme
    assert values["/aras_visual_servo_controller/start"] == 2016


LAUNCH_FILES = sorted(
    path
    for folder in (PACKAGE, PACKAGE.parent / "aras_sim_bridge", PACKAGE.parent / "upstream_names")
    for path in folder.rglob("*.launch")
    if "<node" in path.read_text()
)


def addresses(path, environment=(), given=()):
    """The ROS_IP that a launch file gives to its nodes."""
    bag = ["bag:=/tmp/run.bag"] if "record" in path.stem else []
    return {dict(node.env_args).get("ROS_IP")
            for node in load(path, *given, *bag, **dict(environment)).nodes}  # fmt: skip


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: f"{path.parts[-3]}-{path.stem}")
def test_nodes_listen_to_this_machine_alone(path):
    assert addresses(path) == {"127.0.0.1"}
    assert addresses(path, {"ROS_IP": "10.0.0.3"}) == {None}


@pytest.mark.parametrize(("environment", "arguments", "expected"), [
    ({"ROS_MASTER_URI": "http://localhost:11311"}, [], "127.0.0.1"),
    ({"ROS_MASTER_URI": "http://127.0.0.1:11312"}, [], "127.0.0.1"),
    ({"ROS_MASTER_URI": "http://robot:11311"}, [], None), ({"ROS_HOSTNAME": "lab"}, [], None),
    ({}, ["open_network:=true"], None),
])
def test_who_opens_the_network_is_heard(environment, arguments, expected):
    path = PACKAGE / "launch" / "aras_visual_servo_nodes.launch"
    assert addresses(path, environment, arguments) == {expected}
