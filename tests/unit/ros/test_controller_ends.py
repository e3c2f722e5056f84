"""What a controller node leaves behind."""

import sys
import types

import numpy as np
import pytest

PACKAGES = ("aras_visual_servo_camera", "aras_visual_servo_controller")


@pytest.fixture
def node(monkeypatch):
    """The node's module, also where no messages were built; what has them is imported anew."""
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


@pytest.mark.parametrize(("output", "zeros"), [("position", 0), ("velocity", 1), ("effort", 1)])
def test_speeds_and_efforts_end_at_zero_whoever_chose_them(node, monkeypatch, output, zeros):
    """The parameter may be the node's own, or come from the robot's file."""
    sent, heard = [], []
    ended = object.__new__(node.ControllerNode)
    settings = types.SimpleNamespace(output=output)
    ended._settings = types.SimpleNamespace(output="position")  # as it was given
    ended.driver = types.SimpleNamespace(settings=settings, stop=heard.append)
    ended.face = types.SimpleNamespace(
        names=("J1", "J2"), commands=types.SimpleNamespace(put=sent.append)
    )
    ended._inputs = types.SimpleNamespace(close=lambda: heard.append("closed"))
    monkeypatch.setattr(node, "LAST_WORDS", 0.0)
    ended.close()
    assert len(sent) == zeros and all(np.array_equal(s, np.zeros(2)) for s in sent)
    assert heard == (["closed", "the node ends"] if zeros else [])
