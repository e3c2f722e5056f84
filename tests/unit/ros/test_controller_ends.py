"""Shutdown of a controller node."""

import sys
import types

import pytest

PACKAGES = ("aras_visual_servo_camera", "aras_visual_servo_controller")


@pytest.fixture
def node(monkeypatch):
    """Module of the node, reimported with generated messages if none were built."""
    for name in list(sys.modules):
        if name.startswith("aras_visual_servo_controller.ros"):
            monkeypatch.delitem(sys.modules, name)
    for package in PACKAGES:
        messages = types.ModuleType(f"{package}.msg")
        messages.__getattr__ = lambda name: type(name, (), {})
        monkeypatch.setitem(sys.modules, messages.__name__, messages)
    from aras_visual_servo_controller.ros import node

    yield node
    for name in list(sys.modules):  # they hold messages that are none
        if name.startswith("aras_visual_servo_controller.ros"):
            del sys.modules[name]


@pytest.mark.parametrize("output", ["position", "velocity", "effort"])
def test_the_loop_ends_with_the_node_whoever_chose_its_output(node, monkeypatch, output):
    """The parameter may be the node's own, or come from the robot's file."""
    heard = []
    ended = object.__new__(node.ControllerNode)
    settings = types.SimpleNamespace(output=output)
    ended._settings = types.SimpleNamespace(output="position")  # as it was given
    ended.runner = types.SimpleNamespace(settings=settings, shut_down=heard.append)
    ended._inputs = types.SimpleNamespace(close=lambda: heard.append("closed"))
    monkeypatch.setattr(node, "SHUTDOWN_TIME", 0.0)
    ended.close()
    assert heard == ([] if output == "position" else ["closed", "the node ends"])
