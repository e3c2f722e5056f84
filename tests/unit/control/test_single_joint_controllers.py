"""Single-joint and group controllers: start set points, clamping, state, bad input."""

from dataclasses import astuple
from math import inf, nan, pi

import pytest

from aras_sim_bridge.errors import ControllerError


@pytest.fixture
def make(make_rig, make_joint, make_limits):
    def _make(type_name, kind="revolute", limits=None, **parameters):
        interface = f"{type_name.split('_')[0].title()}JointInterface"
        joints = [make_joint(name, kind, interface, limits) for name in "ab"]
        return make_rig(joints, {"c": {"type": type_name, **parameters}}, physics=False)

    return _make


PID = {"p": 10.0, "i": 0.0, "d": 0.0}


class TestPosition:
    @pytest.mark.parametrize("output", ["effort", "velocity"])
    def test_starts_by_holding_the_position_and_stops_with_its_last_command(self, make, output):
        rig = make(f"{output}_controllers/JointPositionController", joint="a", pid=PID)
        rig.model.q[0] = 0.7
        controller, handle = rig.run("c"), rig.hardware.handles["a"]
        rig.step()
        assert getattr(handle, f"{output}_command") == 0.0
        controller.set_command(1.0)
        for bad in (nan, inf, "far", None):  # the last one is kept
            with pytest.raises(ControllerError, match="'c'"):
                controller.set_command(bad)
        rig.step()
        assert getattr(handle, f"{output}_command") == pytest.approx(3.0)
        rig.manager.switch([], ["c"])
        rig.step(5)
        assert getattr(handle, f"{output}_command") == pytest.approx(3.0)

    def test_command_beyond_the_limit_is_clamped_in_the_cycle_only_and_told_once(self, make):
        rig = make("effort_controllers/JointPositionController", joint="a", pid=PID)
        rig.model.q[0] = 2.5
        controller = rig.run("c")

        def follows(command, steps, used, count):
            controller.set_command(command)
            rig.step(steps)
            told = [line for line in rig.log if "beyond" in line]
            assert controller.loops[0].make_state(0, 0.001).set_point == used
            assert len(told) == count
            return told

        assert controller.loops[0].make_state(0, 0.001).set_point == 2.0  # where it starts
        rig.model.q[0] = 0.0
        follows(2.0 + 6.8e-8, 2, 2.0, 0)  # by rounding alone
        assert follows(5.0, 2000, 2.0, 1) == [
            "controller 'c': command 5 for joint 'a' is beyond its limits [-2, 2]; 2 is used"]
        assert rig.hardware.handles["a"].effort_command == pytest.approx(20.0)
        follows(1.0, 1500, 1.0, 1)
        follows(-5.0, 3, -2.0, 2)
        for start, stop in (([], ["c"]), (["c"], [])):
            rig.manager.switch(start, stop)
            rig.step()
        follows(-5.0, 1, -2.0, 3)  # as soon, but it began anew

    @pytest.mark.parametrize(("proves", "kind", "bounds", "position", "command", "error"), [
        ("revolute inside +-2.0943 never crosses pi", "revolute", (-2.0943, 2.0943), 2, -2, -4),
        ("revolute with many turns: the short way", "revolute", (-3000, 3000), 0, 10, 10 - 4 * pi),
        ("continuous: the short way", "continuous", (None, None), 3, -3, 2 * pi - 6),
        ("prismatic: the plain difference", "prismatic", (-9, 9), -4, 4, 8)])
    def test_error_goes_the_way_of_the_joint(
        self, make, make_limits, proves, kind, bounds, position, command, error
    ):
        limits = make_limits(*bounds, effort=1e9)
        rig = make("effort_controllers/JointPositionController", kind, limits, joint="a", pid=PID)
        rig.model.q[0] = position
        controller = rig.run("c")
        controller.set_command(command)
        rig.step()
        assert rig.hardware.handles["a"].effort_command == pytest.approx(10 * error), proves

    def test_state_comes_every_tenth_update_with_the_fields_upstream_fills(self, make):
        """Effort that the hardware clamps, and nobody before."""
        pid = {"p": 10.0, "i": 1.0, "d": 0.5, "i_clamp_min": -3.0, "i_clamp_max": 4.0}
        rig = make("effort_controllers/JointPositionController", joint="a", pid=pid)
        rig.model.q[0], rig.model.v[0] = 0.25, 0.125
        controller, states = rig.manager.load("c"), []
        controller.on_state = states.append
        rig.manager.switch(["c"], [])
        rig.step()
        controller.set_command(9.0)
        rig.step()
        assert rig.model.tau[0] == 100.0
        rig.step(24)
        assert [s.stamp_ns for s in states] == [2_000_000, 12_000_000, 22_000_000]
        # error 1.75: 10 · 1.75 + 1 · 0.00175 + 0.5 · 1.75/0.001
        assert astuple(states[0]) == pytest.approx((
            2_000_000, 2.0, 0.25, 0.125, 1.75, 0.001, 17.5 + 0.00175 + 875.0, 10.0, 1.0, 0.5, 4.0,
            False))


def test_velocity_and_group_position_controllers_of_efforts(make):
    rig = make("effort_controllers/JointVelocityController", limits="none", joint="a", pid=PID)
    rig.model.v[0] = 1.0
    controller, states = rig.run("c"), []
    controller.on_state = states.append
    rig.step()
    assert rig.model.tau[0] == -10.0  # starts with set point 0
    controller.set_command(3.0)
    rig.step(10)
    assert rig.model.tau[0] == 20.0
    assert astuple(states[-1])[:7] == (12_000_000, 3.0, 1.0, 0.0, 2.0, 1e-3, 20.0)
    rig.step(24)
    assert len(states) == 4  # of updates 0, 10, 20 and 30
    rig = make("effort_controllers/JointGroupPositionController", joints=["b", "a"],
               a={"pid": {"p": 10.0}}, b={"pid": {"p": 20.0}})
    rig.model.q[:] = [0.5, 0.25]
    controller = rig.run("c")
    rig.step()
    assert rig.model.tau == [0.0, 0.0]
    controller.set_command([1.25, 9.0])
    rig.step()
    assert rig.model.tau == pytest.approx([10 * 1.5, 20 * 1.0])
    assert set(controller.pids) == {"a/pid", "b/pid"}
    assert controller.state_kind is None


@pytest.mark.parametrize(("output", "single", "at_start"), [
    ("effort", "JointEffortController", [0.0, 0.0]),
    ("position", "JointPositionController", [0.5, -0.5]),
    ("velocity", "JointVelocityController", [0.0, 0.0])])
@pytest.mark.parametrize("group", [False, True])
def test_forward_controllers(make, output, single, at_start, group):
    kind = f"{output}_controllers/{single.replace('Joint', 'JointGroup') if group else single}"
    rig = make(kind, **({"joints": ["b", "a"]} if group else {"joint": "b"}))
    rig.model.q[:] = [-0.5, 0.5]
    controller = rig.run("c")

    def commands():
        controller.update(0, 0.001)
        found = [getattr(rig.hardware.handles[name], f"{output}_command") for name in "ba"]
        return found if group else found[:1]

    assert commands() == (at_start if group else at_start[:1])
    controller.set_command([99.0, 0.75] if group else 99.0)  # not clamped in the controller
    for bad in ([1.0], [1.0, 2.0, 3.0], [1.0, nan], None, *([3.0] if group else [nan])):
        with pytest.raises(ControllerError, match="'c'"):
            controller.set_command(bad)
    assert commands() == ([99.0, 0.75] if group else [99.0])
    assert controller.claimed_resources[0].resources == (("a", "b") if group else ("b",))
    assert controller.state_kind is None
