"""Modules of ros_control that scripts import: arguments, filters, finding managers."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import pytest
from controller_manager_msgs import srv
from controller_manager_msgs.msg import ControllerState, HardwareInterfaceResources

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


ARM = controller("arm", "effort_controllers/JointTrajectoryController", "running",
                 Effort=("j1", "j2"), Position=("j3",))
HAND = controller("hand", "position_controllers/JointPositionController", Position=("j4",))
STATES = controller("states", "joint_state_controller/JointStateController", "running")
ALL = [ARM, HAND, STATES]
SERVICES = {name: "controller_manager_msgs/" + name.title().replace("_", "") for name in (
    "list_controllers", "list_controller_types", "load_controller", "unload_controller",
    "switch_controller", "reload_controller_libraries")}


@pytest.fixture
def manager(graph, life):
    """Services of a manager; `asked` lists the requests."""
    made = SimpleNamespace(asked=[], ok=True, controllers=ALL)

    def serve(name, kind):
        def answer(request):
            made.asked.append((name, *(getattr(request, field) for field in request.__slots__)))
            given = {"ok": made.ok, "controller": made.controllers, "types": ["a/A", "b/B"],
                     "base_classes": ["b", "b"]}
            response = kind._response_class
            return response(**{field: given[field] for field in response.__slots__})

        utils.rospy.Service(f"/controller_manager/{name}", kind, answer)

    for name, kind in (("load_controller", srv.LoadController),
                       ("unload_controller", srv.UnloadController),
                       ("switch_controller", srv.SwitchController),
                       ("list_controllers", srv.ListControllers),
                       ("list_controller_types", srv.ListControllerTypes),
                       ("reload_controller_libraries", srv.ReloadControllerLibraries)):
        serve(name, kind)
    return made


@pytest.mark.parametrize(("ask", "ok", "words"), [
    (lambda: interface.load_controller("arm"), True, "Loaded 'arm'"),
    (lambda: interface.load_controller("arm"), False, "Error when loading 'arm'"),
    (lambda: interface.unload_controller("arm"), True, "Unloaded 'arm' successfully"),
    (lambda: interface.unload_controller("arm"), False, "Error when unloading 'arm'"),
    (lambda: interface.start_controller("arm"), True, "Started ['arm'] successfully"),
    (lambda: interface.stop_controllers(["a", "b"]), True, "Stopped ['a', 'b'] successfully"),
    (lambda: interface.stop_controller("arm"), False, "Error when stopping ['arm']"),
    (interface.list_controller_types, True, "a/A\nb/B"),
    (interface.list_controllers, True, f"'arm' - '{EFFORT}+{POSITION}' ( running )\n"
     f"'hand' - '{POSITION}' ( stopped )\n'states' - '' ( running )"),
    (lambda: interface.reload_libraries(True), True,
     "Restore: False\nSuccessfully reloaded libraries"),
    (lambda: interface.reload_libraries(False), False, "Restore: False\nFailed to reload "
     "libraries. Do you still have controllers loaded?"),
])
def test_words_are_upstream_s(manager, capsys, ask, ok, words):
    manager.ok = ok
    assert ask() is ok
    assert capsys.readouterr().out == words + "\n"


def test_a_reload_restores_what_was_loaded_and_what_ran(manager, capsys):
    assert interface.reload_libraries(True, restore=True)
    assert manager.asked[1:] == [
        ("reload_controller_libraries", True), ("load_controller", "arm"),
        ("load_controller", "hand"), ("load_controller", "states"),
        ("switch_controller", ["arm", "states"], [], 2, False, 0.0)]
    out = capsys.readouterr().out
    assert out.startswith("Restore: True\n")
    assert out.endswith("Controllers restored to original state\n")


def test_nothing_loaded_is_said(manager, capsys):
    manager.controllers = []
    interface.list_controllers()
    assert capsys.readouterr().out == "No controllers are loaded in mechanism control\n"


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
    ("resources", ["j3", "j9"], {"hardware_interface": EFFORT, "match_any": True}, []),
])  # fmt: skip
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


def test_a_manager_may_stand_at_the_root(monkeypatch):
    types = {f"/{name}": kind for name, kind in SERVICES.items()}
    monkeypatch.setattr(utils.rosservice, "get_service_list", lambda: list(types))
    monkeypatch.setattr(utils.rosservice, "get_service_type", types.get)
    assert utils.get_controller_managers() == ["/"]
    assert utils.get_controller_managers("/robot") == []


def test_a_controller_is_what_has_a_text_for_its_type(monkeypatch):
    values = {"one": {"type": "A"}, "no": {"type": {"a": "B"}}, "yet": {}, "x": 1,
              "type": {"two": "C"}}
    monkeypatch.setattr(utils.rospy, "get_param", {"/": values}.get)
    assert utils.get_rosparam_controller_names("/") == ["one"]
    assert utils.get_rosparam_controller_names("") == ["one"]
