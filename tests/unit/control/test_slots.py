"""Commands are stored until the next cycle; leaving subscribers, resets and errors do no harm."""

import threading
from math import nan

import pytest

from aras_sim_bridge.errors import ControllerError

PID = {"p": 10.0}
KINDS = {
    "effort_controllers/JointPositionController": {"joint": "a", "pid": PID},
    "effort_controllers/JointVelocityController": {"joint": "a", "pid": PID},
    "effort_controllers/JointEffortController": {"joint": "a"},
    "effort_controllers/JointGroupEffortController": {"joints": ["a"]},
    "effort_controllers/JointGroupPositionController": {"joints": ["a"], "a": {"pid": PID}}}


@pytest.fixture(params=KINDS)
def bench(request, make_rig, make_joint):
    """(rig, controller 'c' running, give a command, the effort it comes to)."""
    own = {"type": request.param, **KINDS[request.param]}
    rig = make_rig([make_joint("a")], {"c": own}, physics=False)
    controller = rig.run("c")
    rig.step()

    def give(value):
        controller.set_command([value] if "Group" in request.param else value)

    return rig, controller, give, lambda: rig.hardware.handles["a"].effort_command


def test_the_latest_of_several_commands_acts_also_after_a_flood(bench):
    rig, controller, give, effort = bench
    for value in (0.5, -1.5, 1.0):
        give(value)
    with pytest.raises(ControllerError):  # which does not push out a good one
        give(nan)
    assert effort() == 0.0
    rig.step()
    acted = effort()
    assert acted in (1.0, 10.0)
    rig.step()
    assert effort() == acted and not controller.slot
    rig, controller, give, effort = bench
    flood = threading.Thread(target=lambda: [give(1.0 - k % 2) for k in range(2001)])
    flood.start()
    while flood.is_alive():
        rig.step()
    rig.step(2)
    assert effort() in (1.0, 10.0) and rig.manager.list()[0].state == "running"


class Leaving:
    """Subscriber that is removed right after it was found, as another thread may do."""

    def __set_name__(self, owner, name):
        self.heard = []

    def __get__(self, owner, kind=None):
        seen, owner.__dict__["left"] = not owner.__dict__.get("left", False), True
        return self.heard.append if seen else None

    def __set__(self, owner, value):
        """Set the value as if there was no subscriber yet."""


@pytest.mark.parametrize(("kind", "pid"), [
    ("effort_controllers/JointPositionController", None),
    ("effort_controllers/JointPositionController", "pid"),
    ("joint_state_controller/JointStateController", None),
    ("effort_controllers/JointTrajectoryController", None)])
def test_a_listener_that_leaves_between_two_looks_aborts_nothing(make_rig, make_joint, kind, pid):
    own = {"type": kind, "joint": "a", "joints": ["a"], "pid": PID, "publish_rate": 100.0,
           "gains": {"a": PID}}
    rig = make_rig([make_joint("a")], {"c": own}, physics=False)
    controller = rig.manager.load("c")
    one = controller.pids[pid] if pid else controller
    one.__class__ = leaving = type("Left", (type(one),), {"__slots__": (), "on_state": Leaving()})
    rig.manager.switch(["c"], [])
    rig.step(60)
    assert rig.manager.list()[0].state == "running", rig.log
    assert len(leaving.__dict__["on_state"].heard) == 1
