"""Commands are stored until the next cycle; leaving subscribers, resets and errors do no harm."""

from math import nan

import pytest

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.errors import ControllerError

PID = {"p": 10.0}
KINDS = {
    "effort_controllers/JointPositionController": {"joint": "a", "pid": PID},
    "effort_controllers/JointVelocityController": {"joint": "a", "pid": PID},
    "effort_controllers/JointEffortController": {"joint": "a"},
    "effort_controllers/JointGroupEffortController": {"joints": ["a"]},
    "effort_controllers/JointGroupPositionController": {"joints": ["a"], "a": {"pid": PID}},
}


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


def test_the_latest_of_several_commands_acts_in_the_next_cycle_alone(bench):
    rig, controller, give, effort = bench
    for value in (0.5, -1.5, 1.0):
        give(value)
    assert effort() == 0.0
    rig.step()
    acted = effort()
    assert acted in (1.0, 10.0)
    rig.step()
    assert effort() == acted
    assert not controller.slot


def test_a_refused_command_does_not_push_out_a_good_one(bench):
    rig, controller, give, effort = bench
    give(1.0)
    with pytest.raises(ControllerError):
        give(nan)
    rig.step()
    assert effort() in (1.0, 10.0)


def test_a_reset_and_a_start_forget_what_no_cycle_has_seen(bench):
    rig, controller, give, effort = bench
    give(1.0)
    rig.loop.reset()
    rig.step()
    assert effort() == 0.0
    rig.manager.switch([], ["c"])
    rig.step()
    give(1.0)
    rig.manager.switch(["c"], [])
    rig.step(2)
    assert effort() == 0.0


class Leaving:
    """Subscriber that is removed right after it was found, as another thread may do."""

    def __set_name__(self, owner, name):
        self.heard = []

    def __get__(self, owner, kind=None):
        seen, owner.__dict__["left"] = not owner.__dict__.get("left", False), True
        return self.heard.append if seen else None

    def __set__(self, owner, value):
        """Set the value as if there was no subscriber yet."""


TRAJECTORY = "effort_controllers/JointTrajectoryController"


@pytest.mark.parametrize("kind", [
    "effort_controllers/JointPositionController", "effort_controllers/JointVelocityController",
    "joint_state_controller/JointStateController", TRAJECTORY])
def test_a_listener_that_leaves_between_two_looks_aborts_nothing(make_rig, make_joint, kind):
    own = {"type": kind, "joint": "a", "joints": ["a"], "pid": PID, "publish_rate": 100.0,
           "gains": {"a": PID}}
    rig = make_rig([make_joint("a")], {"c": own}, physics=False)
    controller = rig.manager.load("c")
    leaving = type("Left", (type(controller),), {"on_state": Leaving()})
    controller.__class__ = leaving
    rig.manager.switch(["c"], [])
    rig.step(60)
    assert rig.manager.list()[0].state == "running", rig.log
    assert len(leaving.__dict__["on_state"].heard) == 1


def test_a_pid_s_listener_that_leaves_aborts_nothing(make_rig, make_joint):
    own = {"type": "effort_controllers/JointPositionController", "joint": "a", "pid": PID}
    rig = make_rig([make_joint("a")], {"c": own}, physics=False)
    controller = rig.run("c")
    pid = controller.pids["pid"]
    # The PID looks once whether anybody listens, and once more to call.
    looks = iter([lambda state: None, None])

    class Pid(type(pid)):
        __slots__ = ()
        on_state = property(lambda self: next(looks, None), lambda self, value: None)

    pid.__class__ = Pid
    rig.step(3)
    assert rig.manager.list()[0].state == "running", rig.log


class Faulty(Controller):
    """Commands everything it has, then fails."""

    interface = "VelocityJointInterface"

    def init(self, hardware, parameters, context):
        super().init(hardware, parameters, context)
        self.handle = self.take_handle(hardware, "a")
        self.joints = ("a",)

    def update(self, time_ns, period):
        self.handle.velocity_command = 2.0
        self.handle.effort_command = 3.0
        raise ValueError("mine")


def test_a_controller_that_fails_leaves_no_command_behind(make_rig, make_joint):
    """Its joint gets velocity 0 and the line says why."""
    rig = make_rig([make_joint("a", interface="VelocityJointInterface")],
                   {"c": {"type": f"{Faulty.__module__}:Faulty"}}, physics=False)
    rig.run("c")
    rig.step(2)
    handle = rig.hardware.handles["a"]
    assert (handle.velocity_command, handle.effort_command) == (0.0, 0.0)
    assert rig.model.calls[-1][:3] == ("velocity", "a", 0.0)
    assert rig.manager.list()[0].state == "aborted"
    assert any("ValueError in update(): mine" in line for line in rig.log)
