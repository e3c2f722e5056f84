"""Command-line programs: their requests to the simulator, output and exit status."""

import io
import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace

import pytest
import rosparam
import rospy
from controller_manager_msgs import srv
from controller_manager_msgs.msg import ControllerState, HardwareInterfaceResources
from gazebo_msgs import srv as gz
from gazebo_msgs.msg import ModelStates
from genpy import Message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Empty, EmptyRequest

from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.ros.cli import (
    controller_group,
    controller_manager,
    gzclient,
    gzserver,
    spawn_model,
    spawner,
    unspawner,
)
from aras_sim_bridge.ros.conversions import to_pose
from aras_visual_servo_base.poses import Pose

SERVICES = (
    ("load_controller", srv.LoadController), ("unload_controller", srv.UnloadController),
    ("switch_controller", srv.SwitchController), ("list_controllers", srv.ListControllers),
    ("list_controller_types", srv.ListControllerTypes),
    ("reload_controller_libraries", srv.ReloadControllerLibraries))
NEEDED = ("load_controller", "switch_controller", "unload_controller")


class Program:
    """A program's process: what it asks services for, how it waits, and how it ends."""

    def __init__(self, graph: object, start: object, monkeypatch: pytest.MonkeyPatch) -> None:
        self.graph, self.start, self.patch = graph, start, monkeypatch
        self.asked: list[tuple[str, Message]] = []
        self.faults: dict[str, Exception] = {}  # by service: what a call of it raises
        self.waited: list[tuple[str, float | None]] = []
        self.slept: list[float] = []
        self.asleep: Callable[[], object] = lambda: None  # called while the program sleeps
        for name, value in {"wait_for_service": self._wait, "spin": self.end,
                            "get_namespace": lambda: "/home/", "logwarn_once": rospy.logwarn,
                            "logdebug": lambda *_: None}.items():
            monkeypatch.setattr(rospy, name, value)
        monkeypatch.setattr(rospy.rostime, "wallsleep", self._sleep)

    def serve(self, name: str, kind: type, **answer: object) -> None:
        def service(request: Message) -> Message:
            self.asked.append((name, request))
            if name in self.faults:
                raise self.faults[name]
            return kind._response_class(**answer)

        rospy.Service(name, kind, service)

    def manager(self, namespace: str = "", **running: bool) -> None:
        claims = [HardwareInterfaceResources(f"hw::{kind}", ["j"]) for kind in ("A", "A", "B")]
        found = [ControllerState(name, "running" if runs else "stopped", "t", claims)
                 for name, runs in running.items()]
        answers = {"list_controllers": {"controller": found},
                   "list_controller_types": {"types": ["t/A", "t/B"], "base_classes": ["b", "b"]}}
        for name, kind in SERVICES:
            place = f"{namespace}/controller_manager/{name}"
            self.serve(place, kind, **answers.get(name, {"ok": True}))

    def refuse(self, *names: str) -> None:
        for name, kind in SERVICES:
            if name in names:
                self.serve(f"/controller_manager/{name}", kind, ok=False)

    def calls(self) -> list[tuple]:
        """Service and fields of each call so far, which are forgotten."""
        found = [(name.rpartition("/")[2], *(getattr(request, f) for f in request.__slots__))
                 for name, request in self.asked]
        self.asked.clear()
        return found

    def run(self, module: ModuleType, *argv: str) -> int:
        self.patch.setattr(sys, "argv", [module.__name__, *argv, "x:=y"])
        status = module.main()
        for _, options in self.start.begun:
            assert options["anonymous"] is True  # as upstream's: several may run
        return status

    def end(self) -> None:
        self.start.end("Ctrl-C")

    def _wait(self, name: str, timeout: float | None = None) -> None:
        self.waited.append((name, timeout))
        if fault := self.faults.get("wait"):
            raise fault
        if rospy.resolve_name(name) not in self.graph.services:
            raise rospy.ROSException("timeout exceeded")

    def _sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.asleep()


@pytest.fixture
def program(graph, start, monkeypatch):
    return Program(graph, start, monkeypatch)


MODEL = '<sdf a="package://p/q" b="package://r"/>'


@pytest.fixture
def gazebo(program):
    for name, kind, answer in (
        ("spawn_sdf_model", gz.SpawnModel, {"success": True, "status_message": "here it is"}),
        ("set_model_configuration", gz.SetModelConfiguration, {"success": True}),
        ("unpause_physics", Empty, {}), ("delete_model", gz.DeleteModel, {"success": True}),
        ("get_physics_properties", gz.GetPhysicsProperties, {"pause": True}),
        ("pause_physics", Empty, {})):
        program.serve(f"/gz/{name}", kind, **answer)
    return program


def spawn(gazebo: Program, tmp_path, *more: str) -> int:
    (tmp_path / "m.sdf").write_text(MODEL)
    return gazebo.run(spawn_model, "-sdf", "-file", str(tmp_path / "m.sdf"), "-model", "m",
                      "-gazebo_namespace", "/gz/", *more)


def test_every_argument_of_spawn_model_reaches_the_simulator(gazebo, tmp_path):
    assert spawn(gazebo, tmp_path, "-robot_namespace", "/ns", "-reference_frame", "ball", "-x", "1",
                 "-y", "2", "-z", "3", "-R", ".1", "-P", ".2", "-Y", ".3", "-J", "a", ".5", "-J",
                 "b", "-2", "-unpause", "-package_to_model") == 0
    pose = to_pose(Pose.from_rpy((1.0, 2.0, 3.0), (0.1, 0.2, 0.3)))
    model = MODEL.replace("package", "model")
    assert gazebo.asked == [
        ("/gz/get_physics_properties", gz.GetPhysicsPropertiesRequest()),
        ("/gz/spawn_sdf_model", gz.SpawnModelRequest("m", model, "/ns", pose, "ball")),
        ("/gz/set_model_configuration",
         gz.SetModelConfigurationRequest("m", "robot_description", ("a", "b"), (0.5, -2.0))),
        ("/gz/unpause_physics", EmptyRequest())]
    assert {name for name, _ in gazebo.waited} == {name for name, _ in gazebo.asked}
    assert gazebo.graph.lines[-1] == "here it is"


@pytest.mark.parametrize("refused", [False, True])
def test_time_stands_until_the_joints_are_where_they_are_to_start(gazebo, tmp_path, refused):
    """A Jaco that was spawned while time ran stood in the ground with its joints at 0, and flew."""
    gazebo.serve("/gz/get_physics_properties", gz.GetPhysicsProperties, pause=False)
    gazebo.serve("/gz/spawn_sdf_model", gz.SpawnModel, success=not refused, status_message="so")
    assert spawn(gazebo, tmp_path, "-J", "a", "1") == refused
    names = [name.rpartition("/")[2] for name, _ in gazebo.asked]
    assert names == ["get_physics_properties", "pause_physics", "spawn_sdf_model",
                     *["set_model_configuration"] * (not refused), "unpause_physics"]
    gazebo.asked.clear()
    spawn(gazebo, tmp_path)
    assert [name for name, _ in gazebo.asked] == ["/gz/spawn_sdf_model"]


def test_what_spawn_model_takes_where_nothing_is_said(gazebo, monkeypatch):
    text = '<robot a="package://p"/>'
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))
    gazebo.serve("/gazebo/spawn_urdf_model", gz.SpawnModel, success=True)
    gazebo.graph.parameters["/text"] = text
    at = to_pose(Pose((0.0, 0.0, 0.0)))
    for source in (["-stdin"], ["-param", "text"]):
        assert gazebo.run(spawn_model, "-urdf", *source, "-model", "m") == 0
        assert gazebo.asked.pop() == (
            "/gazebo/spawn_urdf_model", gz.SpawnModelRequest("m", text, "/home/", at, ""))
    assert not gazebo.asked and not gazebo.start.ending


def test_arguments_of_spawn_model_that_cannot_be(program):
    for given in ("-urdf -sdf -stdin -model m", "-stdin -model m", "-urdf -model m", "-urdf -stdin",
                  "-urdf -stdin -param p -model m", "-urdf -stdin -model m -R a",
                  "-urdf -stdin -model m -J a"):
        with pytest.raises(SystemExit):
            program.run(spawn_model, *given.split())


def test_spawn_model_waits_for_another_model(gazebo, tmp_path, monkeypatch):
    heard = iter([rospy.ROSException("none"), ModelStates(name=["a"]), ModelStates(name=["b"])])
    asked = []

    def wait(*given: object, **more: object) -> ModelStates:
        asked.append((given, more))
        assert not gazebo.asked
        if isinstance(message := next(heard), Exception):
            raise message
        return message

    monkeypatch.setattr(rospy, "wait_for_message", wait)
    assert spawn(gazebo, tmp_path, "-wait", "b") == 0
    assert asked == 3 * [(("/gz/model_states", ModelStates), {"timeout": 1.0})]
    assert len(gazebo.asked) == 1 and gazebo.slept == [0.1]
    assert gazebo.graph.lines[0] == "Waiting for model b before spawning"


@pytest.mark.parametrize(("refusing", "fault", "line"), [
    ("spawn_sdf_model", None, "Spawning m failed: so not"),
    ("set_model_configuration", None, "Spawning m failed: so not"),
    ("spawn_sdf_model", rospy.ServiceException("x"),
     "Spawning m failed, because the simulator refused the call: x"),
    ("unpause_physics", rospy.ROSException("y"), "Spawning m failed: y"),
    ("spawn_sdf_model", rospy.ROSInterruptException("z"), None),
    ("-down", rospy.ROSException("y"), None)])
def test_what_fails_in_spawn_model_is_one_line(gazebo, tmp_path, refusing, fault, line):
    if fault is not None:
        gazebo.faults["wait" if refusing == "-down" else f"/gz/{refusing}"] = fault
    else:
        kind = gz.SpawnModel if "spawn" in refusing else gz.SetModelConfiguration
        gazebo.serve(f"/gz/{refusing}", kind, success=False, status_message="so not")
    gazebo.start.down = refusing == "-down"
    assert spawn(gazebo, tmp_path, "-J", "a", "1", "-unpause", "-b") == 1
    said = [text for text in gazebo.graph.lines if "failed" in text]
    assert said == ([] if line is None else [line]) and not gazebo.start.ending


@pytest.mark.parametrize(("arguments", "why"), [
    ("-stdin", "the model is empty"), ("-param /nothing", "parameter /nothing does not exist"),
    ("-file no.urdf", "cannot read the model file"),
    ("-file bytes.urdf", "cannot read the model file"),
    ("-database m", "there is no model database"),
    ("-file box.urdf -J a b", "-J takes a joint name and a number")])
def test_a_model_that_cannot_be_read_is_refused(program, monkeypatch, tmp_path, arguments, why):
    monkeypatch.setattr(sys, "stdin", io.StringIO(" \n"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bytes.urdf").write_bytes(b"<robot name='\xff'/>")
    (tmp_path / "box.urdf").write_text("<robot/>")
    assert program.run(spawn_model, "-urdf", *arguments.split(), "-model", "m") == 1
    assert why in program.graph.lines[-1]


@pytest.mark.parametrize("gone", [None, rospy.ServiceException, rospy.ROSException])
def test_a_bond_takes_the_model_out_at_the_end(gazebo, tmp_path, gone):
    if gone is not None:
        gazebo.faults["/gz/delete_model"] = gone("gone")
    assert spawn(gazebo, tmp_path, "-b") == 0
    assert gazebo.asked[1:] == [("/gz/delete_model", gz.DeleteModelRequest("m"))]
    told = gazebo.graph.lines[-1] == "model m was not deleted: the simulator has ended"
    assert told is (gone is not None)


LOADED = [("load_controller", "a"), ("load_controller", "b")]
STARTED = ("switch_controller", ["a", "b"], [], 2, False, 0.0)
STOPPED = [("switch_controller", [], ["a", "b"], 2, False, 0.0), ("unload_controller", "b"),
           ("unload_controller", "a")]


@pytest.mark.parametrize(("given", "namespace", "timeout", "starts"), [
    ([], "", 30.0, True), (["--stopped"], "", 30.0, False),
    (["--namespace", "/rig"], "/rig", 30.0, True), (["--namespace=/rig/"], "/rig", 30.0, True),
    (["--timeout", "0.5"], "", 0.5, True), (["--timeout", "0"], "", None, True),
    (["--no-timeout"], "", None, True), (["--shutdown-timeout", "0.1"], "", 30.0, True)])
def test_spawner_loads_starts_and_undoes_it(program, given, namespace, timeout, starts):
    program.manager(namespace)
    assert program.run(spawner, *given, "a", "b") == 0
    assert program.calls() == LOADED + starts * [STARTED] + STOPPED
    place = f"{namespace}/" if namespace else ""
    assert program.waited == [(f"{place}controller_manager/{name}", timeout) for name in NEEDED]
    lines = program.graph.lines
    told = sum("--shutdown-timeout has no effect" in line for line in lines)
    assert told == ("--shutdown-timeout" in given)
    waits = f"Waiting for service {namespace}/controller_manager/{NEEDED[2]}"
    assert sum(line.endswith(waits) for line in lines) == 1
    assert "Controller Spawner: Loaded controllers: a, b" in lines
    assert ("Started controllers: a, b" in lines) is starts


def test_spawner_goes_on_without_those_that_cannot_be_loaded(program):
    program.manager()
    program.refuse("load_controller", "switch_controller")
    assert program.run(spawner, "a", "b") == 0
    assert program.calls() == [*LOADED, ("switch_controller", [], [], 2, False, 0.0)]
    assert program.slept == [1.0, 1.0]
    said = [line for line in program.graph.lines if line.startswith("Failed")]
    assert [line.partition(";")[0] for line in said] == [
        "Failed to load a", "Failed to load b", "Failed to start controllers: "]


@pytest.mark.parametrize(("simulated", "ticks", "looks"), [
    (False, True, 1), (True, True, 1), (True, False, 3)])
def test_spawner_waits_longer_for_a_simulator_that_still_starts(
    program, monkeypatch, simulated, ticks, looks
):
    heard = []

    def clock(*given: object, **more: object) -> None:
        heard.append((given, more))
        if len(heard) == 2:
            program.manager()
        if not ticks:
            raise rospy.ROSException("none")

    monkeypatch.setattr(rospy, "wait_for_message", clock)
    program.graph.parameters["/use_sim_time"] = simulated
    assert program.run(spawner, "a", "b") == 0
    assert set(map(str, heard)) <= {str((("/clock", Clock), {"timeout": 1.0}))}
    assert len([1 for name, _ in program.waited if name.endswith("load_controller")]) >= looks
    found = looks == 3
    assert program.calls() == found * [*LOADED, STARTED, *STOPPED]
    said = "couldn't find the expected controller_manager ROS interface in /controller_manager"
    assert any(said in line for line in program.graph.lines) is not found


@pytest.mark.parametrize("fault", ["interrupted", "down", "down while it loads", "gone"])
def test_what_ends_spawner(program, fault):
    program.manager()
    program.start.down = fault == "down"
    if fault == "interrupted":
        program.faults["wait"] = rospy.ROSInterruptException("x")

    def load(_request: Message) -> None:
        program.start.down = "loads" in fault
        raise rospy.ServiceException("x")

    ends = fault in ("gone", "down while it loads")
    if ends:
        program.graph.services["/controller_manager/load_controller"] = load
    assert program.run(spawner, "a") == ends
    said = [line for line in program.graph.lines if "Waiting" not in line and "Loading" not in line]
    assert len(said) == (fault in ("gone", "interrupted"))
    assert all("has ended: x" in line or "couldn't find" in line for line in said)


@pytest.mark.parametrize(("kept", "told"), [("a", 1), ("ab", 0)])
def test_spawner_says_what_it_could_not_unload(program, kept, told):
    """Nothing, where not one could be: the simulator ends too."""
    program.manager()
    program.graph.services["/controller_manager/unload_controller"] = lambda asked: (
        srv.UnloadControllerResponse(ok=asked.name not in kept))
    assert program.run(spawner, "a", "b") == 0
    assert sum("Failed to unload a;" in line for line in program.graph.lines) == told
    assert sum("Failed to unload" in line for line in program.graph.lines) == told


@pytest.mark.parametrize("fault", [rospy.ServiceException, rospy.ROSException, OSError])
def test_a_simulator_that_went_before_spawner_is_no_fault(program, fault):
    program.manager()

    def end() -> None:
        program.faults["/controller_manager/switch_controller"] = fault("gone")
        program.end()

    program.patch.setattr(rospy, "spin", end)
    assert program.run(spawner, "a") == 0
    assert "Shutting down" in program.graph.lines[-1]


def test_spawner_waits_for_a_true(program):
    program.manager()
    sent = iter([False, True])

    def publish() -> None:
        assert program.graph.heard["go"][0] is Bool and not program.asked
        program.graph.subscribers["go"](Bool(next(sent)))

    program.asleep = publish
    assert program.run(spawner, "--wait-for", "go", "a", "b") == 0
    assert program.slept == [0.01, 0.01] and "go" not in program.graph.subscribers
    assert program.calls()[:2] == LOADED
    assert "Controller Spawner: Waiting for topic /go" in program.graph.lines


@pytest.mark.parametrize(("namespace", "place"), [("", "/home/"), ("/rig/", "/rig/")])
def test_spawner_reads_controllers_from_files(program, tmp_path, monkeypatch, namespace, place):
    file, sent = tmp_path / "some.yaml", []
    file.write_text("b: {type: t, joint: j}\na: {type: u}\n---\nd: {type: v}\n_ns: inner\n")
    monkeypatch.setattr(rosparam, "upload_params", lambda *given: sent.append(given))
    assert spawner.read_controller_names(["c", str(file)], namespace) == ["c", "b", "a", "d"]
    assert sent == [(place, {"b": {"type": "t", "joint": "j"}, "a": {"type": "u"}}),
                    (f"{place}inner", {"d": {"type": "v"}})]


@pytest.mark.parametrize("gone", [None, rospy.ServiceException, rospy.ROSException, OSError])
def test_unspawner_keeps_stopped_what_it_is_told_and_starts_it_at_the_end(program, gone):
    program.manager(a=True, b=True, c=False, d=True)
    periods = []

    def sleep() -> None:
        if not program.asked:
            return
        looks.append(sum(program.slept))
        periods.append(program.calls())
        if len(periods) == 2:  # started by somebody
            program.manager(a=True, b=False, c=True)
        if len(periods) == 3:
            program.faults["/controller_manager/list_controllers"] = rospy.ServiceException("x")
        if len(periods) == 4:
            if gone is not None:
                program.faults["/controller_manager/switch_controller"] = gone("y")
            program.end()

    looks: list[float] = []
    program.asleep = sleep
    assert program.run(unspawner, "c", "b", "a") == 0
    assert set(program.slept) == {0.1}
    assert looks == pytest.approx([0.1, 3.1, 6.1, 9.1], abs=0.05)  # every three seconds
    listed = ("list_controllers",)
    assert periods == [
        [listed, ("switch_controller", [], ["b", "a"], 1, False, 0.0)],
        [listed, ("switch_controller", [], ["b", "a"], 1, False, 0.0)],
        [listed, ("switch_controller", [], ["c", "a"], 1, False, 0.0)], [listed]]
    assert program.calls() == [("switch_controller", ["b", "a", "c"], [], 1, False, 0.0)]
    assert program.graph.lines[0].startswith("the controller manager does not answer: x;")
    told = program.graph.lines[-1] == (
        "controllers b, a, c are not started again: the simulator has ended")
    assert told is (gone is not None)


def test_unspawner_without_a_manager_or_with_nothing_to_do(program):
    assert program.run(unspawner, "a") == 1
    program.manager(a=False)
    program.asleep = program.end
    assert program.run(unspawner, "a") == 0
    assert program.calls() == [("list_controllers",)]
    waited = [f"controller_manager/{name}" for name in ("switch_controller", "list_controllers")]
    assert [name for name, _ in program.waited] == [waited[0], *waited]


SWITCH = "switch_controller"
FAILURES = {"load_controller": "Error when ", "unload_controller": "Error when unloading 'a'",
            SWITCH: "Error when ", "reload_controller_libraries": "Failed to reload libraries. Do "}


@pytest.mark.parametrize(("given", "calls", "out"), [
    ("load a b", LOADED, "Loaded 'a'\nLoaded 'b'\n"),
    ("unload a", [("unload_controller", "a")], "Unloaded 'a' successfully\n"),
    ("start a", [(SWITCH, ["a"], [], 2, False, 0.0)], "Started ['a'] successfully\n"),
    ("stop a", [(SWITCH, [], ["a"], 2, False, 0.0)], "Stopped ['a'] successfully\n"),
    ("spawn a b", [*LOADED, (SWITCH, ["a"], [], 2, False, 0.0), (SWITCH, ["b"], [], 2, False, 0.0)],
     "Loaded 'a'\nLoaded 'b'\nStarted ['a'] successfully\nStarted ['b'] successfully\n"),
    ("kl a", [(SWITCH, [], ["a"], 2, False, 0.0), ("unload_controller", "a")],
     "Stopped ['a'] successfully\nUnloaded 'a' successfully\n"),
    ("lc", [("list_controllers",)],
     "'on' - 'hw::A+hw::B' ( running )\n'off' - 'hw::A+hw::B' ( stopped )\n"),
    ("list-types", [("list_controller_types",)], "t/A\nt/B\n"),
    ("reload-libraries", [("reload_controller_libraries", True)],
     "Restore: False\nSuccessfully reloaded libraries\n"),
    ("rl --restore", [
        ("list_controllers",), ("reload_controller_libraries", True), ("load_controller", "on"),
        ("load_controller", "off"), (SWITCH, ["on"], [], 2, False, 0.0)],
     "Restore: True\nSuccessfully reloaded libraries\nControllers restored to original state\n")])
def test_commands_of_controller_manager(program, capsys, given, calls, out):
    program.manager(on=True, off=False)
    assert program.run(controller_manager, *given.split()) == 0
    assert program.calls() == calls and capsys.readouterr().out == out
    assert [name for name, _ in program.waited] == [f"controller_manager/{c[0]}" for c in calls]
    for name in {call[0] for call in calls} & FAILURES.keys():
        program.manager(on=True)
        program.refuse(name)
        assert program.run(controller_manager, *given.split()) == 1
        assert FAILURES[name] in capsys.readouterr().out


def test_words_of_controller_manager(program, capsys):
    program.manager()
    assert program.run(controller_manager, "lc") == 0
    assert capsys.readouterr().out == "No controllers are loaded in mechanism control\n"
    program.refuse("load_controller", SWITCH)
    assert program.run(controller_manager, "spawn", "a", "b") == 1
    assert program.calls()[1:3] == LOADED  # one failure does not keep the other commands back
    assert capsys.readouterr().out.splitlines() == [
        "Error when loading 'a'", "Error when loading 'b'", "Error when starting ['a']",
        "Error when starting ['b']"]
    assert not controller_manager.stop_controller("arm")
    assert capsys.readouterr().out == "Error when stopping ['arm']\n"
    program.manager()
    assert controller_manager.start_controller("arm")
    assert program.calls()[-1] == (SWITCH, ["arm"], [], 2, False, 0.0)
    program.refuse("reload_controller_libraries")
    assert not controller_manager.reload_libraries(False)
    assert program.calls() == [("reload_controller_libraries", False)]


@pytest.mark.parametrize("module", [controller_manager, controller_group])
def test_a_manager_that_does_not_answer(program, capsys, module):
    program.graph.parameters["/controller_groups"] = {"a": ["b"]}
    arguments = {controller_manager: ["lc"], controller_group: ["switch", "a"]}[module]
    for fault, said in ((None, "timeout exceeded"), (rospy.ServiceException("x"), "x"),
                        (rospy.ROSInterruptException("x"), "")):
        if fault:
            program.faults["wait"] = fault
        assert program.run(module, *arguments) == 1
        line = (f"The controller manager did not answer: {said}; spawn the robot, and set __ns to "
                "its namespace\n") if said else ""
        assert capsys.readouterr().err == line


GROUPS = {"position": ["p", "q", "p"], "effort": ["e", "q"], "none": []}


def test_groups_are_listed(program, capsys):
    with pytest.raises(SystemExit):
        program.run(controller_group)
    assert program.run(controller_group, "list") == 0
    program.graph.parameters["/controller_groups"] = GROUPS
    assert program.run(controller_group, "list") == 0
    assert capsys.readouterr().out.splitlines() == [
        "Number of groups: 0", "Number of groups: 3", "  effort", "      e", "      q", "  none",
        "  position", "      p", "      q", "      p"]
    program.graph.parameters["/controller_groups"] = "p"
    assert program.run(controller_group, "spawn", "p") == 1
    assert "groups in /controller_groups: none" in capsys.readouterr().err


def test_a_group_is_spawned(program, capsys):
    program.graph.parameters["/controller_groups"] = GROUPS
    program.manager()
    assert program.run(controller_group, "spawn", "position") == 0
    assert program.calls() == [
        ("load_controller", "p"), ("load_controller", "q"), (SWITCH, ["p"], [], 2, False, 0.0),
        (SWITCH, ["q"], [], 2, False, 0.0)]
    program.refuse("load_controller")
    assert program.run(controller_group, "spawn", "position") == 1
    assert program.calls() == [("load_controller", "p"), ("load_controller", "q")]
    program.manager()
    program.refuse(SWITCH)
    assert program.run(controller_group, "spawn", "position") == 1
    assert len(program.calls()) == 4
    program.graph.services[f"/controller_manager/{SWITCH}"] = lambda asked: (
        srv.SwitchControllerResponse(ok=asked.start_controllers == ["p"]))
    assert program.run(controller_group, "spawn", "position") == 1  # one of the two
    capsys.readouterr()
    for name in ("none", "nobody"):
        assert program.run(controller_group, "spawn", name) == 1
        told = f"no controller defined in group {name}; groups in /controller_groups: effort, no"
        assert told in capsys.readouterr().err


@pytest.mark.parametrize(("running", "calls", "out"), [
    ({"p": False, "q": True, "e": True, "x": True},
     [(SWITCH, ["p"], ["e"], 2, False, 0.0)],
     "Started ['p'] successfully\nStopped ['e'] successfully\n"),
    ({"e": False, "q": True},
     [("load_controller", "p"), (SWITCH, ["p"], [], 2, False, 0.0)],
     "Loaded 'p'\nStarted ['p'] successfully\n"),
    ({"e": True, "p": True, "q": True}, [(SWITCH, [], ["e"], 2, False, 0.0)],
     "Stopped ['e'] successfully\n")])
def test_groups_are_switched(program, capsys, running, calls, out):
    program.graph.parameters["/controller_groups"] = GROUPS
    program.manager(**running)
    assert program.run(controller_group, "switch", "position") == 0
    assert program.waited[0] == ("controller_manager/list_controllers", 5.0)
    assert program.calls() == [("list_controllers",), *calls]
    assert capsys.readouterr().out == out
    program.refuse(SWITCH)
    assert program.run(controller_group, "switch", "position") == 0  # upstream's does so too
    _, start, stop, *_ = calls[-1]
    words = [f"{word} {names}" for word, names in (("starting", start), ("stopping", stop))
             if names]
    assert capsys.readouterr().out.splitlines()[-1] == f"Error when {' and '.join(words)}"


def test_a_group_that_cannot_be_loaded_is_not_switched_to(program, capsys):
    program.graph.parameters["/controller_groups"] = GROUPS
    program.manager(e=True)
    program.refuse("load_controller")
    assert program.run(controller_group, "switch", "position") == 0
    assert program.calls() == [("list_controllers",), ("load_controller", "p")]
    assert capsys.readouterr().out.endswith("Cancel group switching\n")


@pytest.mark.parametrize("module", [
    spawn_model, spawner, unspawner, controller_manager, controller_group, gzserver,
], ids=lambda module: module.__name__.rpartition(".")[2])
def test_help_has_an_example_that_is_understood(program, capsys, module):
    name = module.__name__.rpartition(".")[2]
    with pytest.raises(SystemExit):
        program.run(module, "--help")
    told = capsys.readouterr().out
    lines = told.splitlines()
    for line, after in zip(lines, lines[1:], strict=False):
        if line.startswith("  -"):
            assert "  " in line.strip() or after.startswith(10 * " "), f"{line}: no help"
    told = " ".join(told.split())
    assert told.startswith(f"usage: {name} [-h]") and " ".join(module.__doc__.split()) in told
    start = f"example: rosrun {'gazebo_ros' if module is gzserver else 'aras_sim_bridge'} {name} "
    words = told.partition(start)[2].split()
    program.start.down = True
    if module is gzserver:
        assert gzserver.read_parameters(words)["world"].endswith(words[0])
    else:
        assert program.run(module, *words) in (0, 1)


@pytest.mark.parametrize(("argv", "given"), [
    ([], {"world": "", "paused": False}),
    (["a.world", "-u", "--verbose", "--seed", "7"],
     {"paused": True, "seed": 7, "log_level": "debug"}),
    (["a.world", "--seed=0", "-r", "-e", "ode", "-s", "x.so", "-s", "y.so", "-q", "--lockstep",
      "--iters", "5", "--record_path", "z"], {"paused": False, "seed": 0})])
def test_gzserver_puts_its_arguments_into_parameters(monkeypatch, tmp_path, argv, given):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.world").touch()
    assert gzserver.read_parameters(argv) == {"world": str(tmp_path / "a.world"), **given}


def test_worlds_are_looked_for_where_gazebo_looks(monkeypatch, tmp_path, capsys):
    folders = [tmp_path / name for name in ("here", "a", "b", "ros")]
    for folder in folders:
        folder.mkdir()
    here, a, b, ros = folders
    monkeypatch.chdir(here)
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", f"{a}::{b}")
    packages = SimpleNamespace(get_path={"gazebo_ros": str(ros)}.__getitem__)
    monkeypatch.setattr(gzserver.rospkg, "RosPack", lambda: packages)
    assert gzserver.find_world("") == ""
    with pytest.raises(DescriptionError, match=f"'x' in {here}, {a}, {b}, {ros}; give its full"):
        gzserver.find_world("x")
    for folder in (ros, b, a, here):
        (folder / "x").touch()
        assert gzserver.find_world("x") == str(folder / "x")
    (here / "dir").mkdir()
    monkeypatch.setattr(sys, "argv", ["gzserver", "dir"])
    assert gzserver.main() == 1 and "gzserver: there is no world file 'dir'" in (
        capsys.readouterr().err)

    def missing(_name: str) -> str:
        raise gzserver.rospkg.ResourceNotFound("gazebo_ros")

    packages.get_path = missing
    assert gzserver.find_world("x") == str(here / "x")


def test_gzclient_says_what_to_look_with_and_stays(program):
    assert program.run(gzclient) == 0
    assert program.start.begun[0][0] == "gazebo_gui"
    assert program.start.down and "use rviz" in program.graph.lines[0]
