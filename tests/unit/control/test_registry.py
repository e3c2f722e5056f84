"""Type strings of controllers: built-in classes and classes of a user's package."""

import sys

import pytest

from aras_sim_bridge.control.controllers import Controller, ControllerTypes, register
from aras_sim_bridge.errors import ControllerError

SOURCE = """
from aras_sim_bridge.control.controllers import Controller

class Mine(Controller):
    interface = "EffortJointInterface"
    command_kind = "float64"
    version = {version}

    def set_command(self, value):
        self.value = value

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


def test_a_users_class_by_path_or_by_parameter(users_module):
    registry = ControllerTypes()
    cls = registry.find("users_controllers:Mine")
    assert cls.version == 1
    extra = {"mine/Mine": "users_controllers:Mine"}
    assert registry.find("mine/Mine", extra) is cls
    assert "mine/Mine" in registry.list_types(extra)


def test_it_loads_and_runs_without_a_line_changed_here(users_module, make_rig, make_joint):
    rig = make_rig([make_joint("a")], {"mine": {"type": "users_controllers:Mine"}})
    controller = rig.run("mine")
    assert (controller.context.where, controller.command_kind) == ("/robot/mine", "float64")


@pytest.mark.parametrize("classes", [
    {"mine/sub/Mine": "users_controllers:Mine"},
    {"mine": {"sub": {"Mine": "users_controllers:Mine"}}},  # as a parameter server nests it
])
def test_a_slash_in_a_users_type_may_nest(users_module, make_rig, make_joint, classes):
    rig = make_rig([make_joint("a")], {
        "controller_classes": classes, "own": {"type": "mine/sub/Mine"}})
    assert rig.run("own").version == 1
    assert ("mine/sub/Mine", "controller_interface::ControllerBase") in rig.manager.list_types()


@pytest.mark.parametrize(("classes", "why"), [
    ({"mine": {"Mine": 7}}, "'mine/Mine': '7' is not of the form"),
    (7, "/robot/controller_classes must map type names to 'package.module:Class', found 7"),
])
def test_a_users_type_without_a_class_is_named(users_module, make_rig, make_joint, classes, why):
    rig = make_rig([make_joint("a")], {
        "controller_classes": classes, "own": {"type": "mine/Mine"}})
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


@pytest.mark.parametrize(
    ("type_name", "text"),
    [
        ("effort_controllers/JointPositonController",
         "did you mean 'effort_controllers/JointPositionController'"),
        ("xyz", "use one of"),
        ("users_controllers:", "not of the form"),
        ("users_controllers:Nobody", "users_controllers has no Nobody"),
        ("no_such_package:Mine", "cannot import.*no_such_package"),
        ("users_controllers:NoController", "NoController is not a class derived from Controller"),
        ("quitting_controllers:Mine", "importing quitting_controllers raised SystemExit: 3"),
    ],
)
def test_what_cannot_be_found_is_explained(users_module, type_name, text):
    with pytest.raises(ControllerError, match=text):
        ControllerTypes().find(type_name)


def test_a_type_name_belongs_to_one_class():
    with pytest.raises(ControllerError, match="already exists"):

        @register("effort_controllers/JointPositionController")
        class Impostor(Controller):
            pass
