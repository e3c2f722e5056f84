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
def test_every_argument_is_documented_and_has_a_default(path):
    for arg in ElementTree.parse(path).getroot().findall("arg"):
        assert arg.get("doc"), f"argument {arg.get('name')} has no doc="
        assert arg.get("default", arg.get("value")) is not None


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.name)
def test_every_argument_used_is_declared_and_every_declared_one_used(path):
    text = path.read_text()
    used = set(re.findall(r"\$\(arg (\w+)\)", text)) | set(re.findall(r"arg\('(\w+)'\)", text))
    declared = set(arguments(path.name))
    assert used <= declared
    if "pass_all_args" not in text:
        assert declared <= used


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.name)
def test_files_of_this_package_exist_and_are_its_own(path):
    """A name gives the first package of that name: in a workspace over the originals, theirs."""
    text = path.read_text()
    assert not re.search(r"(find(\('| )|pkg=\")aras_visual_servo_gazebo", text)
    for name in re.findall(r"\$\(dirname\)/([\w./]+)", text):
        assert (path.parent / name).exists(), name


def test_gazebo_arguments_are_offered_and_passed_on():
    launch = root("aras_visual_servo_gazebo.launch")
    assert set(arguments("aras_visual_servo_gazebo.launch")) >= GAZEBO_ARGUMENTS | {"show_rviz"}
    (world,) = [i for i in launch.findall("include") if "empty_world" in i.get("file")]
    assert {arg.get("name") for arg in world.findall("arg")} >= GAZEBO_ARGUMENTS


def test_both_in_one_offers_what_the_two_offer():
    both = arguments("aras_visual_servo.launch")
    assert both == {
        **arguments("aras_visual_servo_gazebo.launch"),
        **arguments("aras_visual_servo_controller.launch"),
    }


def test_an_earlier_preset_leaves_nothing_behind():
    groups = root("aras_visual_servo_gazebo.launch").findall("group")
    (group,) = [group for group in groups if group.get("ns") == "/gazebo/cameras"]
    assert group.get("clear_params") == "true"
    assert group.find("param").get("name") == "labrob/camera"


def test_spawner_starts_every_configured_controller():
    controllers = yaml.safe_load((PACKAGE / "config/aras_visual_servo_control.yaml").read_text())
    (spawner,) = root("aras_visual_servo_controller.launch").findall("node[@type='spawner']")
    given = arguments("aras_visual_servo_controller.launch")
    names = ["joint_state_controller", *given["controllers"].split()]
    assert sorted(names) == sorted(controllers["aras_visual_servo"])
    assert given["namespace"] == "/aras_visual_servo"
    assert spawner.get("args").split() == [
        "--namespace=$(arg", "namespace)", "joint_state_controller", "$(arg", "controllers)"
    ]  # fmt: skip


def test_gains():
    controllers = yaml.safe_load((PACKAGE / "config/aras_visual_servo_control.yaml").read_text())
    robot = controllers["aras_visual_servo"]
    assert robot.pop("joint_state_controller") == {
        "type": "joint_state_controller/JointStateController",
        "publish_rate": 100,
    }
    assert set(robot) == set(GAINS)
    for name, (joint, p, i, d, i_clamp) in GAINS.items():
        assert robot[name] == {
            "type": "effort_controllers/JointPositionController",
            "joint": joint,
            "interpolate": True,
            "pid": {"p": p, "i": i, "d": d, "i_clamp": i_clamp},
        }
        # control_toolbox reads doubles; an integer on the parameter server is another type.
        assert all(isinstance(gain, float) for gain in robot[name]["pid"].values())


def test_camera_presets():
    files = (PACKAGE / "config" / "cameras").glob("*.yaml")
    presets = {path.stem: yaml.safe_load(path.read_text()) for path in files}
    size = {"width": 320, "height": 240, "update_rate": 30}
    assert presets["original"] == {"horizontal_fov": 2.0, **size}
    assert presets["calibrated"] == {
        "horizontal_fov": 1.41,
        **size,
        "camera_matrix": {"fx": 195.0507, "fy": 195.0992, "cx": 162.4058, "cy": 127.1973},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": [-0.33060, 0.1170, 0, 0, 0],
    }
    assert arguments("aras_visual_servo_gazebo.launch")["camera"] in presets


def test_the_recording_holds_what_the_graph_carries():
    topics = set(recorder().split())
    assert topics >= {f"/aras_visual_servo/{name}/command" for name in GAINS}
    assert topics >= {"/clock", "/tf", "/tf_static", "/rosout", "/aras_visual_servo/joint_states"}
    assert topics >= {"/labrob/camera/image_raw/compressed", "/labrob/camera/camera_info"}
    assert "/labrob/camera/image_raw" not in topics
    assert topics >= {"/aras_visual_servo/experiment", "/gazebo/performance_metrics"}
    assert "/aras_visual_servo/target" in topics
    assert topics >= {f"/aras_visual_servo/camera/{t}" for t in ("data", "moments")}
    assert topics >= {f"/aras_visual_servo/controller/{t}" for t in ("state", "camera_twist")}


def without_commands(roslaunch, patch):
    """Commands that make parameters are not run."""
    patch.setattr(roslaunch.xmlloader.XmlLoader, "param_value", lambda *_: "")


def recorder(*given):
    """The recorder's arguments, as roslaunch works them out."""
    roslaunch = pytest.importorskip("roslaunch")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_PACKAGE_PATH", f"{PACKAGE.parent}:/usr/share")
        without_commands(roslaunch, patch)
        launch = [(str(PACKAGE / "launch" / "record.launch"), ["bag:=/tmp/run.bag", *given])]
        config = roslaunch.config.load_config_default(launch, None, assign_machines=False)
    (args,) = [node.args for node in config.nodes if node.type == "record"]
    assert {node.type for node in config.nodes} == {"record", "describe"}
    return args


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
])  # fmt: skip
def test_without_a_display_rviz_says_so_and_the_run_goes_on(display, why):
    done = subprocess.run(
        [sys.executable, SHOW_RVIZ, "-d", "x.rviz"],
        env={"PATH": os.environ["PATH"], "DISPLAY": display}, capture_output=True, text=True,
        timeout=20, check=False,
    )  # fmt: skip
    assert done.returncode == 0
    assert done.stderr == f"show_rviz: rviz is not started: {why}; the run continues without it\n"


def test_rviz_is_shown_where_there_is_a_display(tmp_path):
    tmp_path.joinpath("rviz").write_text("#!/bin/sh\necho \"shown $@\"\n")
    tmp_path.joinpath("rviz").chmod(0o755)
    name = f":{os.getpid()}"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(f"\0/tmp/.X11-unix/X{os.getpid()}")
        server.listen()
        done = subprocess.run(
            [sys.executable, SHOW_RVIZ, "-d", "x.rviz"],
            env={"PATH": f"{tmp_path}:{os.environ['PATH']}", "DISPLAY": name},
            capture_output=True, text=True, timeout=20, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "shown -d x.rviz\n")


def test_markers_come_with_rviz_or_when_asked_for(monkeypatch):
    roslaunch = pytest.importorskip("roslaunch")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{PACKAGE.parent}:/usr/share")
    path = str(PACKAGE / "launch" / "aras_visual_servo_gazebo.launch")
    without_commands(roslaunch, monkeypatch)

    def nodes(*given):
        config = roslaunch.config.load_config_default([(path, list(given))], None,
                                                      assign_machines=False)  # fmt: skip
        return {node.type for node in config.nodes} & {"markers", "show_rviz", "dashboard"}

    assert nodes() == set()
    assert nodes("show_rviz:=true") == {"markers", "show_rviz"}
    assert nodes("show_rviz:=true", "markers:=false") == {"show_rviz"}
    assert nodes("markers:=true") == {"markers"}
    assert nodes("dashboard:=true") == {"dashboard"}


def test_a_replay_is_shown_as_a_run_is():
    """The same window with the same drawing in it, or the same line where there is no display."""
    trees = [root(f"{name}.launch") for name in ("aras_visual_servo_gazebo", "replay")]
    for kind in ("markers", "show_rviz"):
        run, replay = ([n.attrib for n in tree.iter("node") if n.get("type") == kind]
                       for tree in trees)  # fmt: skip
        assert run == replay and len(run) == 1
    run, replay = (tree.find("arg[@name='markers']").get("default") for tree in trees)
    assert run == replay == "$(arg show_rviz)"


@pytest.fixture
def load(monkeypatch):
    """The configuration of a launch file of this package with these arguments."""
    roslaunch = pytest.importorskip("roslaunch")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{PACKAGE.parent}:/usr/share")

    def load(name, *given):
        path = str(PACKAGE / "launch" / f"{name}.launch")
        return roslaunch.config.load_config_default([(path, list(given))], None,
                                                    assign_machines=False)  # fmt: skip

    return load


def test_the_description_is_the_shipped_one_with_what_is_asked_for(load):
    """A moved camera, and joints without friction."""
    shipped = (PACKAGE / "robots" / "aras_visual_servo.urdf").read_text()
    plain = load("aras_visual_servo_gazebo").params["/robot_description"].value
    changed = load("aras_visual_servo_gazebo", "camera_rpy:=-0.1 0 0", "camera_xyz:=0.01 0 0",
                   "joint_friction:=False").params["/robot_description"].value  # fmt: skip
    assert plain == shipped
    joints = {j.get("name"): j for j in ElementTree.fromstring(changed).findall("joint")}
    assert joints["camera_joint"].find("child").get("link") == "camera_mount"
    mount = joints["camera_mount_joint"]
    assert mount.find("child").get("link") == "camera_link"
    values = {key: [float(v) for v in mount.find("origin").get(key).split()]
              for key in ("xyz", "rpy")}  # fmt: skip
    assert values == {"xyz": [0.01, 0, 0], "rpy": [-0.1, 0, 0]}
    dynamics = [d for d in (j.find("dynamics") for j in joints.values()) if d is not None]
    assert [float(d.get("friction")) for d in dynamics] == [0.0] * 6
    assert float(joints["J2"].find("dynamics").get("damping")) == 0.1


@pytest.mark.parametrize(("scheme", "layout"), [("kernel", "kernel"),
                                                ("my_lab.schemes:Mine", "moments")])
def test_the_layout_follows_the_scheme(load, scheme, layout):
    config = load("aras_visual_servo_nodes", f"scheme:={scheme}")
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


def addresses(monkeypatch, path, environment, arguments):
    """The ROS_IP that a launch file gives to its nodes."""
    roslaunch = pytest.importorskip("roslaunch")
    without_commands(roslaunch, monkeypatch)
    for name in ("ROS_IP", "ROS_HOSTNAME", "ROS_MASTER_URI"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"ROS_PACKAGE_PATH": f"{PACKAGE.parent}:/usr/share", **environment}.items():
        monkeypatch.setenv(name, value)
    given = [*arguments, "bag:=/tmp/run.bag"] if "record" in path.stem else arguments
    config = roslaunch.config.load_config_default([(str(path), given)], None, assign_machines=False)
    return {dict(node.env_args).get("ROS_IP") for node in config.nodes}


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: f"{path.parts[-3]}-{path.stem}")
def test_nodes_listen_to_this_machine_alone(monkeypatch, path):
    assert addresses(monkeypatch, path, {}, []) == {"127.0.0.1"}
    assert addresses(monkeypatch, path, {"ROS_IP": "10.0.0.3"}, []) == {None}


@pytest.mark.parametrize(("environment", "arguments", "expected"), [
    ({"ROS_MASTER_URI": "http://localhost:11311"}, [], "127.0.0.1"),
    ({"ROS_MASTER_URI": "http://127.0.0.1:11312"}, [], "127.0.0.1"),
    ({"ROS_MASTER_URI": "http://robot:11311"}, [], None),
    ({"ROS_HOSTNAME": "lab"}, [], None),
    ({}, ["open_network:=true"], None),
])
def test_who_opens_the_network_is_heard(monkeypatch, environment, arguments, expected):
    path = PACKAGE / "launch" / "aras_visual_servo_nodes.launch"
    assert addresses(monkeypatch, path, environment, arguments) == {expected}
