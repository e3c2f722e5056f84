"""joint_state_controller: order, rate on the simulated clock, extra joints."""

from itertools import pairwise
from math import inf

import pytest

from aras_sim_bridge.errors import ControllerError

TYPE = "joint_state_controller/JointStateController"


@pytest.fixture
def make(make_rig, make_joint):
    def _make(names=("gantry", "J2", "J1"), **parameters):
        parameters = {"jsc": {"type": TYPE, "publish_rate": 100, **parameters}}
        return make_rig([make_joint(name) for name in names], parameters)

    return _make


def states_of(rig):
    controller = rig.manager.load("jsc")
    states = []
    controller.on_state = states.append
    rig.manager.switch(["jsc"], [], 2)
    return states


def test_order_is_by_name_in_byte_order(make):
    rig = make()
    with pytest.raises(ControllerError, match="controller 'jsc' takes no commands"):
        rig.manager.load("jsc").set_command(1.0)
    rig.manager.unload("jsc")
    rig.model.q[:], rig.model.v[:] = [0.1, 0.2, 0.3], [0.4, 0.5, 0.6]
    rig.model.stuck |= {"gantry", "J2", "J1"}
    for handle, effort in zip(rig.hardware.handles.values(), (0.7, 0.8, 0.9), strict=True):
        handle.effort_command = effort
    states = states_of(rig)
    rig.step(2)
    assert states[0].names == ("J1", "J2", "gantry")
    assert (states[0].positions, states[0].velocities, states[0].efforts) == (
        [0.3, 0.2, 0.1], [0.6, 0.5, 0.4], [0.9, 0.8, 0.7])


def test_the_rhythm_and_the_average_rate(make):
    rig = make()
    states = states_of(rig)
    rig.step(5)
    rig.manager.switch([], ["jsc"], 2)
    rig.step(2)
    rig.manager.switch(["jsc"], [], 2)
    rig.step(25)
    # Started at the end of step 1, so first updated in step 2.
    assert [s.stamp_ns for s in states] == [2_000_000, 11_000_000, 21_000_000, 31_000_000]
    rig.step(250)
    states.clear()
    rig.time_ns = 0
    rig.loop.reset()
    rig.step(11)
    assert [s.stamp_ns for s in states] == [1_000_000, 11_000_000]
    rig = make(publish_rate=300)
    states = states_of(rig)
    rig.step(1000)
    assert len(states) == 300
    assert {b.stamp_ns - a.stamp_ns for a, b in pairwise(states)} == {3_000_000, 4_000_000}


@pytest.mark.parametrize("rate", [0, -5])
def test_a_rate_of_zero_or_less_never_publishes(make, rate):
    rig = make(publish_rate=rate)
    states = states_of(rig)
    rig.step(50)
    assert not states and rig.manager.get("jsc").idle_until(rig.time_ns) == inf


@pytest.mark.parametrize("rate", [300, 70, 1000])
def test_the_cycles_to_come_are_those_in_which_it_will_sample(make, rate):
    rig = make(publish_rate=rate)
    controller, states = rig.run("jsc"), []
    controller.on_state = states.append
    rig.step(7)
    states.clear()

    def due(first, last):
        start = rig.time_ns
        return controller.list_due_cycles(
            start + first * rig.step_ns, start + last * rig.step_ns, rig.step_ns)

    expected = due(1, 60)
    rig.step(60)
    assert [s.stamp_ns for s in states] == expected and len(expected) >= 4
    before = due(0, 100)
    controller.count_samples(3)
    assert due(0, 100) == before[3:]


def test_joints_gives_subset_and_order_extra_joints_follow(make):
    rig = make(joints=["gantry", "J1"], extra_joints=[
        {"name": "tip", "position": 1.5}, {"name": "tip", "position": 8.0},
        {"name": "J1", "position": 9.0}, {"name": "base", "velocity": 2.5, "effort": 3.5}])
    states = states_of(rig)
    rig.step(2)
    state = states[0]
    assert state.names == ("gantry", "J1", "tip", "base")
    assert (state.positions, state.velocities, state.efforts) == (
        [0.0, 0.0, 1.5, 0.0], [0.0, 0.0, 0.0, 2.5], [0.0, 0.0, 0.0, 3.5])
