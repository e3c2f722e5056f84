"""GripperActionController, with steps of 10 ms and another joint, which must not count."""

from math import inf, nan

import pytest

from aras_sim_bridge.control.controllers.gripper import GripperGoal, GripperResult

STEP = 10_000_000
GAINS = {"p": 50.0, "d": 12.0}


@pytest.fixture
def make(make_rig, make_joint):
    """A started controller 'c' of joint 'b' and its rig; `kind`: position or effort."""

    def _make(kind="effort", start=0.3, **parameters):
        given = {"type": f"{kind}_controllers/GripperActionController", "joint": "b", **parameters}
        if kind == "effort":
            given.setdefault("gains", {"b": GAINS})
        interface = f"{kind.title()}JointInterface"
        joints = [make_joint(name, "prismatic", interface, "none") for name in "ab"]
        rig = make_rig(joints, {"c": given}, STEP, physics=kind != "position", q=[-0.7, start])
        return rig.run("c"), rig

    return _make


@pytest.mark.parametrize(("kind", "gains", "command"), [
    ("position", {}, 0.3), ("effort", {"b": (50.0, 12.0)}, 0.0)])
def test_it_starts_where_the_joint_is(make, kind, gains, command):
    controller, rig = make(kind)
    assert controller.get_loop_gains() == gains
    rig.step(5)
    assert getattr(rig.hardware.handles["b"], f"{kind}_command") == command


@pytest.mark.parametrize("kind", ["position", "effort"])
def test_a_goal_is_reached(make, kind):
    controller, rig = make(kind)
    handle, ended = controller.submit_goal(GripperGoal(0.9, 25.0)), []
    handle.on_done = ended.append
    while not ended and rig.time_ns < 4e9:
        rig.step()
    assert handle.status == "succeeded" and ended == [handle]
    result = handle.result
    assert result.reached_goal and not result.stalled
    assert result.position == rig.hardware.handles["b"].position
    assert result.position == pytest.approx(0.9, abs=0.01)
    assert kind == "effort" or result.effort == 25.0
    rig.step(300)  # and stays
    assert rig.model.q[1] == pytest.approx(0.9, abs=1e-3)


def test_the_effort_is_what_the_goal_allows(make):
    controller, rig = make(gains={"b": {"p": 1000.0}})
    # The effort's size counts, as upstream, where without one a goal does nothing.
    for goal, effort in ((GripperGoal(0.9, -4.0), 4.0), (GripperGoal(-0.9, 3.0), -3.0),
                         (GripperGoal(0.9), 0.0)):
        last = controller.submit_goal(goal)
        rig.step()
        assert rig.hardware.handles["b"].effort_command == effort
    controller.cancel_goal(last)  # and what it holds, it holds with max_effort: 0
    rig.model.q[1] += 0.5
    rig.step()
    assert rig.hardware.handles["b"].effort_command == 0.0


@pytest.mark.parametrize(("given", "steps"), [({"stall_timeout": 0.2}, 21), ({}, 101)])
def test_what_is_held_ends_the_goal_as_stalled(make, given, steps):
    controller, rig = make(**given)
    rig.model.stuck.add("b")
    handle = controller.submit_goal(GripperGoal(0.9, 7.0))
    rig.step(steps)
    assert handle.status == "active"
    rig.step()
    assert handle.status == "aborted"
    assert handle.result == GripperResult(0.3, 7.0, stalled=True)
    rig.step(10)  # it goes on pressing
    assert rig.hardware.handles["b"].effort_command == 7.0


@pytest.mark.parametrize(("given", "slow"), [({"stall_velocity_threshold": 0.05}, 0.05),
                                             ({}, 0.001)])
def test_a_joint_that_creeps_has_not_stalled(make, given, slow):
    controller, rig = make(stall_timeout=0.1, **given)
    rig.model.stuck.add("b")
    handle = controller.submit_goal(GripperGoal(0.9, 7.0))
    for k in range(40):
        rig.model.v[1] = slow * (1.1 if k % 8 == 0 else 0.8)
        rig.step()
    assert handle.status == "active"
    rig.model.v[1] = slow  # not faster
    rig.step(12)
    assert handle.status == "aborted"


def test_the_tolerance_and_the_time_at_a_stop(make):
    controller, rig = make("position", goal_tolerance=-0.2)
    rig.model.stuck.add("b")
    handle = controller.submit_goal(GripperGoal(0.501))
    rig.step(3)
    assert handle.status == "active"
    rig.model.q[1] = 0.302
    rig.step()
    assert handle.status == "succeeded"
    controller, rig = make(stall_timeout=0.2)
    rig.model.stuck.add("b")
    rig.step(100)
    handle = controller.submit_goal(GripperGoal(0.9, 7.0))
    rig.step(5)
    rig.time_ns = 0
    rig.loop.reset()
    rig.step(21)
    assert handle.status == "active"
    rig.step(2)
    assert handle.status == "aborted"


def test_a_goal_is_preempted_and_cancelled(make):
    controller, rig = make()
    first = controller.submit_goal(GripperGoal(0.9, 5.0))
    rig.step(3)
    second = controller.submit_goal(GripperGoal(0.1, 5.0))
    assert first.status == "preempted" and second.status == "active"
    rig.manager.switch([], ["c"], 2)
    rig.step()
    assert second.status == "preempted"
    refused = controller.submit_goal(GripperGoal(0.2))
    assert refused.status == "rejected" and "not running" in refused.result.text
    controller, rig = make(max_effort=9.0)
    handle = controller.submit_goal(GripperGoal(0.9, 5.0))
    rig.step(20)
    at = rig.hardware.handles["b"].position
    assert 0.3 < at < 0.9
    assert controller.cancel_goal(handle) and handle.status == "preempted"
    assert not controller.cancel_goal(handle)
    rig.step(600)
    assert rig.model.q[1] == pytest.approx(at, abs=1e-3)


@pytest.mark.parametrize("goal", [GripperGoal(nan, 1.0), GripperGoal(0.1, inf)])
def test_a_goal_of_no_number_is_refused(make, goal):
    controller, rig = make()
    present = controller.submit_goal(GripperGoal(0.9, 5.0))
    handle = controller.submit_goal(goal)
    assert handle.status == "rejected" and "not finite" in handle.result.text
    assert not handle.result.stalled and not handle.result.reached_goal
    assert present.status == "active"
    rig.manager.switch([], ["c"])
    rig.step()
    rig.manager.unload("c")
    early = rig.manager.load("c").submit_goal(GripperGoal(0.9, 5.0))
    assert early.status == "rejected" and "is not running; start it first" in early.result.text
