"""Type strings of controllers: built-in classes and classes of a user's package."""

import sys

import pytest

from aras_sim_bridge.control.controllers import Controller, ControllerTypes, register
from aras_sim_bridge.errors import ControllerError

SOURCE = """
from aras_sim_bridge.control.controllers import Controller

class Mine(Controller):
    interface = "EffortJointInterface"
    version = {version}

class NoController:
    pass
"""


@pytest.fixture
def users_module(tmp_path, monkeypatch):
    path = tmp_path / "users_controllers.py"
    path.write_text(SOURCE.format(version=1))
    (tmp_path / "quitting_controllers.py").write_text("import sys; sys.exit(3)")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield path
    sys.modules.pop("users_controllers", None)


@pytest.mark.parametrize(("type_name", "classes"), [
    ("users_controllers:Mine", {}),
    ("mine/sub/Mine", {"mine/sub/Mine": "users_controllers:Mine"}),
    ("mine/sub/Mine", {"mine": {"sub": {"Mine": "users_controllers:Mine"}}}),  # as a server nests
])
def test_it_loads_and_runs_without_a_line_changed_here(
    users_module, make_rig, make_joint, type_name, classes
):
    rig = make_rig([make_joint("a")], {"controller_classes": classes, "own": {"type": type_name}})
    controller = rig.run("own")
    assert (controller.version, controller.context.where) == (1, "/robot/own")
    expected = sorted([*ControllerTypes().list_types(), *(["mine/sub/Mine"] if classes else [])])
    assert rig.manager.list_types() == [
        (name, "controller_interface::ControllerBase") for name in expected]


@pytest.mark.parametrize(("classes", "why"), [
    ({"mine": {"Mine": 7}}, "'mine/Mine': '7' is not of the form"),
    (7, "/robot/controller_classes must map type names to 'package.module:Class', found 7"),
])
def test_a_users_type_without_a_class_is_named(users_module, make_rig, make_joint, classes, why):
    rig = make_rig([make_joint("a")], {"controller_classes": classes, "own": {"type": "mine/Mine"}})
    with pytest.raises(ControllerError, match=why):
        rig.manager.load("own")


def test_reload_takes_the_new_source_also_of_what_others_have_imported(users_module):
    registry, another = ControllerTypes(), ControllerTypes()
    extra = {"mine/Mine": "users_controllers:Mine"}
    for one, version in ((registry, 22), (another, 333)):
        before = registry.find("mine/Mine", extra).version
        users_module.write_text(SOURCE.format(version=version))
        assert registry.find("mine/Mine", extra).version == before
        one.reload(extra)
        assert one.find("mine/Mine", extra).version == version


@pytest.mark.parametrize(("type_name", "text"), [
    ("effort_controllers/JointPositonController",
     "did you mean 'effort_controllers/JointPositionController'"),
    ("xyz", "use one of"), ("users_controllers:", "not of the form"),
    ("users_controllers:Nobody", "users_controllers has no Nobody"),
    ("no_such_package:Mine", "cannot import.*no_such_package"),
    ("users_controllers:NoController", "NoController is not a class derived from Controller"),
    ("quitting_controllers:Mine", "importing quitting_controllers raised SystemExit: 3")])
def test_what_cannot_be_found_is_explained(users_module, type_name, text):
    with pytest.raises(ControllerError, match=text):
        ControllerTypes().find(type_name)


def test_a_type_name_belongs_to_one_class():
    with pytest.raises(ControllerError, match="already exists"):

        @register("effort_controllers/JointPositionController")
        class Impostor(Controller):
            pass


PID = {"p": 1.0}
POSITION, GROUP, TRAJECTORY, GRIPPER = (f"effort_controllers/{name}" for name in (
    "JointPositionController", "JointGroupPositionController", "JointTrajectoryController",
    "GripperActionController"))
STATES = "joint_state_controller/JointStateController"


@pytest.mark.parametrize(("kind", "parameters", "text"), [
    (POSITION, {"joint": None}, "/robot/c/joint is missing"),
    (POSITION, {"pid": None}, "/robot/c/pid/p"), (POSITION, {"pid": 3}, "/robot/c/pid"),
    (POSITION, {"interpolate": 1}, "/robot/c/interpolate is .*, must be true or false"),
    (POSITION, {"joint": "z"},
     "joint 'z' does not have the EffortJointInterface; joints with it: a, b"),
    (POSITION, {"joint": "p"}, "only the PositionJointInterface"),
    (GROUP, {"joints": []}, "non-empty list"), (GROUP, {"joints": ["a", "a"]}, "different"),
    (GROUP, {"joints": ["a"]}, "/robot/c/a/pid/p"),
    (STATES, {"publish_rate": "fast"}, "publish_rate is 'fast', must be a finite number"),
    (STATES, {"joints": ["J9"]}, "joint 'J9' does not have"),
    (STATES, {"extra_joints": [{"name": "a", "position": 1}]}, "must be a double.*write 0.0"),
    (STATES, {"extra_joints": [{"position": 1.0}]}, r"extra_joints\[0\]/name"),
    (STATES, {"extra_joints": "a"}, "extra_joints must be a list"),
    (STATES, {"extra_joints": [3]}, r"extra_joints\[0\] must have a name, found 3"),
    (TRAJECTORY, {"joints": []}, "non-empty list"),
    (TRAJECTORY, {"constraints": {"a": {"goal": "near"}}}, "constraints/a/goal"),
    (TRAJECTORY, {"stop_trajectory_duration": -1.0}, "negative"),
    (TRAJECTORY, {"gains": {}}, "/robot/c/gains/a/p"),
    (TRAJECTORY, {"velocity_ff": {"a": True}}, "velocity_ff/a"), (GRIPPER, {"joint": 3}, "joint"),
    (GRIPPER, {"stall_timeout": "x"}, "stall"), (GRIPPER, {"gains": {"a": {"p": "x"}}}, "gains/a")])
def test_a_parameter_that_cannot_be_is_named(make_rig, make_joint, kind, parameters, text):
    given = {"joint": "a", "joints": ["a"], "pid": PID, "gains": {"a": PID}}
    given = {"publish_rate": 100} if kind == STATES else given
    given = {key: value for key, value in {**given, **parameters}.items() if value is not None}
    joints = [make_joint("a"), make_joint("b"), make_joint("p", interface="PositionJointInterface")]
    rig = make_rig(joints, {"c": {"type": kind, **given}})
    with pytest.raises(ControllerError, match=f"cannot load controller 'c'.*{text}"):
        rig.manager.load("c")
