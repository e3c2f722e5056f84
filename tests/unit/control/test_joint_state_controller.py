"""joint_state_controller: order, rate on the simulated clock, extra joints."""

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
    assert states[0].positions == [0.3, 0.2, 0.1]
    assert states[0].velocities == [0.6, 0.5, 0.4]
    assert states[0].efforts == [0.9, 0.8, 0.7]


def test_first_sample_in_the_first_cycle_then_every_ten_ms(make):
    rig = make()
    states = states_of(rig)
    rig.step(100)
    # Started at the end of step 1, so first updated in step 2; the rhythm counts from the start.
    assert [s.stamp_ns for s in states] == [2_000_000] + [1_000_000 + 10_000_000 * k
                                                          for k in range(1, 10)]


def test_average_rate_is_exact_where_it_does_not_divide_the_step(make):
    rig = make(publish_rate=300)
    states = states_of(rig)
    rig.step(1000)
    assert len(states) == 300
    assert {b.stamp_ns - a.stamp_ns for a, b in zip(states, states[1:], strict=False)} == {
        3_000_000, 4_000_000
    }


@pytest.mark.parametrize("rate", [0, -5])
def test_a_rate_of_zero_or_less_never_publishes(make, rate):
    rig = make(publish_rate=rate)
    states = states_of(rig)
    rig.step(50)
    assert not states and rig.manager.get("jsc").idle_until(rig.time_ns) == inf


@pytest.mark.parametrize("rate", [300, 70, 1000])
def test_the_cycles_to_come_are_those_in_which_it_will_sample(make, rate):
    rig = make(publish_rate=rate)
    controller = rig.run("jsc")
    states = []
    controller.on_state = states.append
    rig.step(7)
    due = controller.list_due_cycles(
        rig.time_ns + rig.step_ns, rig.time_ns + 60 * rig.step_ns, rig.step_ns
    )
    states.clear()
    rig.step(60)
    assert [s.stamp_ns for s in states] == due and len(due) >= 4
    before = controller.list_due_cycles(rig.time_ns, rig.time_ns + 100_000_000, rig.step_ns)
    controller.count_samples(3)
    after = controller.list_due_cycles(rig.time_ns, rig.time_ns + 100_000_000, rig.step_ns)
    assert after == before[3:]


def test_restart_keeps_the_rhythm(make):
    rig = make()
    states = states_of(rig)
    rig.step(5)
    rig.manager.switch([], ["jsc"], 2)
    rig.step(2)
    rig.manager.switch(["jsc"], [], 2)
    rig.step(10)
    assert [s.stamp_ns for s in states] == [2_000_000, 11_000_000]


def test_a_clock_set_back_does_not_silence_it(make):
    rig = make()
    rig.step(250)
    states = states_of(rig)
    rig.step(250)
    states.clear()
    rig.time_ns = 0
    rig.loop.reset()
    rig.step(11)
    assert [s.stamp_ns for s in states] == [1_000_000, 11_000_000]


def test_joints_gives_subset_and_order_extra_joints_follow(make):
    rig = make(
        joints=["gantry", "J1"],
        extra_joints=[
            {"name": "tip", "position": 1.5},
            {"name": "tip", "position": 8.0},
            {"name": "J1", "position": 9.0},
            {"name": "base", "velocity": 2.5, "effort": 3.5},
        ],
    )
    states = states_of(rig)
    rig.step(2)
    assert states[0].names == ("gantry", "J1", "tip", "base")
    assert states[0].positions == [0.0, 0.0, 1.5, 0.0]
    assert states[0].velocities == [0.0, 0.0, 0.0, 2.5]
    assert states[0].efforts == [0.0, 0.0, 0.0, 3.5]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"publish_rate": "fast"}, "publish_rate is 'fast', must be a finite number"),
        ({"joints": ["J9"]}, "joint 'J9' does not have"),
        ({"joints": []}, "joints is .., must be a non-empty"),
        ({"extra_joints": [{"name": "a", "position": 1}]}, "must be a double.*write 0.0"),
        ({"extra_joints": [{"position": 1.0}]}, r"extra_joints\[0\]/name"),
        ({"extra_joints": "a"}, "extra_joints must be a list"),
        ({"extra_joints": [3]}, r"extra_joints\[0\] must have a name, found 3"),
    ],
)
def test_bad_parameters_are_named(make, change, text):
    with pytest.raises(ControllerError, match=text):
        make(**change).manager.load("jsc")


@pytest.mark.parametrize("wanted", [True, False])
def test_true_stamps_are_what_the_parameter_says(make, wanted):
    rig = make(true_stamps=wanted)
    assert rig.manager.load("jsc").true_stamps is wanted
    assert make().manager.load("jsc").true_stamps is False
