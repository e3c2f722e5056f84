"""Modules of ros_control that scripts import: filters, finding managers."""

import importlib.util
from pathlib import Path

import pytest
from controller_manager_msgs.msg import ControllerState, HardwareInterfaceResources

from aras_sim_bridge.ros.cli import controller_manager

SOURCES = Path(__file__).parents[3] / "src"
EFFORT, POSITION = (f"hardware_interface::{k}JointInterface" for k in ("Effort", "Position"))


def module(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


utils = module(SOURCES / "upstream_msgs/controller_manager_msgs/src/controller_manager_msgs/"
               "utils.py")
interface = module(SOURCES / "upstream_names/controller_manager/src/controller_manager/"
                   "controller_manager_interface.py")


def controller(name, kind="a/A", state="stopped", **claims):
    return ControllerState(name, state, kind, [
        HardwareInterfaceResources(f"hardware_interface::{key}JointInterface", list(joints))
        for key, joints in claims.items()])


def test_functions_are_those_of_the_program_and_find_controllers_by_their_types(monkeypatch):
    for name in interface.__all__:
        assert getattr(interface, name) is getattr(controller_manager, name)
    values = {"one": {"type": "A"}, "no": {"type": {"a": "B"}}, "yet": {}, "x": 1,
              "type": {"two": "C"}}
    monkeypatch.setattr(utils.rospy, "get_param", {"/": values}.get)
    assert utils.get_rosparam_controller_names("/") == ["one"]
    assert utils.get_rosparam_controller_names("") == ["one"]


ARM = controller("arm", "effort_controllers/JointTrajectoryController", "running",
                 Effort=("j1", "j2"), Position=("j3",))
HAND = controller("hand", "position_controllers/JointPositionController", Position=("j4",))
STATES = controller("states", "joint_state_controller/JointStateController", "running")
ALL = [ARM, HAND, STATES]
SERVICES = {name: "controller_manager_msgs/" + name.title().replace("_", "") for name in (
    "list_controllers", "list_controller_types", "load_controller", "unload_controller",
    "switch_controller", "reload_controller_libraries")}


@pytest.mark.parametrize(("by", "asked", "more", "expected"), [
    ("name", "arm", {}, [ARM]), ("name", "a", {}, []),
    ("name", "a", {"match_substring": True}, ALL), ("state", "running", {}, [ARM, STATES]),
    ("type", "Position", {"match_substring": True}, [HAND]),
    ("state", "run", {}, []), ("type", "joint_", {}, []),
    ("hardware_interface", POSITION, {}, [ARM, HAND]), ("hardware_interface", "Effort", {}, []),
    ("hardware_interface", "Effort", {"match_substring": True}, [ARM]),
    ("resources", ["j1", "j3"], {}, [ARM]), ("resources", ["j4"], {}, [HAND]),
    ("resources", ["j1", "j3"], {"hardware_interface": EFFORT}, []),
    ("resources", ["j1", "j4"], {}, []),
    ("resources", ["j1", "j4"], {"match_any": True}, [ARM, HAND]),
    ("resources", ["j3", "j9"], {"hardware_interface": EFFORT, "match_any": True}, [])])
def test_filters(by, asked, more, expected):
    assert getattr(utils, f"filter_by_{by}")(ALL, asked, **more) == expected


def test_managers_are_found_by_their_services(monkeypatch):
    types = {f"{place}/{name}": kind for name, kind in SERVICES.items()
             for place in ("/left/controller_manager", "/right/arm/controller_manager")}
    types["/fake/list_controllers"] = "other/ListControllers"
    types["/rightmost/list_controllers"] = "controller_manager_msgs/ListControllers"
    monkeypatch.setattr(utils.rosservice, "get_service_list", lambda: list(types))
    monkeypatch.setattr(utils.rosservice, "get_service_type", types.get)
    assert utils.get_controller_managers() == [
        "/left/controller_manager", "/right/arm/controller_manager"]
    assert utils.ControllerManagerLister("/right")() == ["/right/arm/controller_manager"]
    del types["/left/controller_manager/load_controller"]
    assert not utils.is_controller_manager("/left/controller_manager")
    assert utils.get_controller_managers("/left") == []
    # One of a look before counts while it lists controllers.
    assert utils.get_controller_managers("/left", ["/left/controller_manager", "/left/none"]) == [
        "/left/controller_manager"]
    assert utils.get_controller_managers("/left", ["/right/arm/controller_manager"]) == []
    types.clear()
    types.update({f"/{name}": kind for name, kind in SERVICES.items()})
    assert utils.get_controller_managers() == ["/"]
    assert utils.get_controller_managers("/robot") == []

    def nobody():
        raise utils.rosservice.ROSServiceIOException("no master")

    monkeypatch.setattr(utils.rosservice, "get_service_list", nobody)
    assert utils.get_controller_managers() == []


def test_the_controllers_of_a_manager_are_listed(graph):
    lister = utils.ControllerLister("/left/controller_manager")
    assert lister.namespace == "/left/controller_manager" and lister() == []  # nobody answers
    utils.rospy.Service("/left/controller_manager/list_controllers", utils.ListControllers,
                        lambda _: utils.ListControllers._response_class(controller=ALL))
    assert lister() == ALL

    def gone(_):
        raise utils.rospy.ROSException

    graph.services["/left/controller_manager/list_controllers"] = gone
    assert lister() == []
    assert utils.ControllerLister().namespace == "/controller_manager"
