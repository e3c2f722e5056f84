"""Single-joint and group controllers: start set points, clamping, state, bad input."""

from math import inf, nan, pi

import pytest

from aras_sim_bridge.errors import ControllerError

PREFIX = {"effort": "EffortJointInterface", "position": "PositionJointInterface",
          "velocity": "VelocityJointInterface"}


@pytest.fixture
def make(make_rig, make_joint, make_limits):
    """A rig with joints 'a' and 'b' of one interface and a controller 'c' of a type."""

    def _make(type_name, kind="revolute", limits=None, **parameters):
        interface = PREFIX[type_name.split("_")[0]]
        joints = [make_joint(name, kind, interface, limits) for name in "ab"]
        return make_rig(joints, {"c": {"type": type_name, **parameters}}, physics=False)

    return _make


PID = {"p": 10.0, "i": 0.0, "d": 0.0}


class TestPosition:
    """effort_controllers/JointPositionController, and its velocity twin."""

    @pytest.fixture(params=["effort", "velocity"])
    def output(self, request):
        return request.param

    def test_starts_by_holding_the_position(self, make, output):
        rig = make(f"{output}_controllers/JointPositionController", joint="a", pid=PID)
        rig.model.q[0] = 0.7
        controller = rig.run("c")
        rig.step()
        assert getattr(rig.hardware.handles["a"], f"{output}_command") == 0.0
        controller.set_command(1.0)
        rig.step()
        assert getattr(rig.hardware.handles["a"], f"{output}_command") == pytest.approx(3.0)

    def test_start_beyond_a_limit_moves_to_it(self, make):
        rig = make("effort_controllers/JointPositionController", joint="a", pid=PID)
        rig.model.q[0] = 2.5
        controller = rig.run("c")
        assert controller.loops[0].make_state(0, 0.001).set_point == 2.0

    def test_a_command_beyond_the_limit_by_rounding_alone_is_not_told(self, make):
        rig = make("effort_controllers/JointPositionController", joint="a", pid=PID)
        controller = rig.run("c")
        for command, told in ((2.0 + 6.8e-8, 0), (2.0 + 1e-5, 1)):
            controller.set_command(command)
            rig.step(2)
            assert controller.loops[0].make_state(0, 0.001).set_point == 2.0
            assert sum("beyond" in line for line in rig.log) == told

    def test_command_beyond_the_limit_is_clamped_in_the_cycle_only_and_told_once(self, make):
        rig = make("effort_controllers/JointPositionController", joint="a", pid=PID)
        controller = rig.run("c")
        controller.set_command(5.0)
        rig.step(2000)
        assert rig.hardware.handles["a"].effort_command == pytest.approx(20.0)
        assert [line for line in rig.log if "beyond" in line] == [
            "controller 'c': command 5 for joint 'a' is beyond its limits [-2, 2]; 2 is used"
        ]
        controller.set_command(1.0)
        rig.step(1500)
        controller.set_command(-5.0)
        rig.step(3)
        assert len([line for line in rig.log if "beyond" in line]) == 2
        rig.manager.switch([], ["c"])
        rig.step()
        rig.manager.switch(["c"], [])
        rig.step()
        controller.set_command(-5.0)  # as soon, but it began anew
        rig.step()
        assert len([line for line in rig.log if "beyond" in line]) == 3

    @pytest.mark.parametrize(
        ("proves", "kind", "bounds", "position", "command", "error"),
        [
            ("revolute inside +-2.0943 never crosses pi", "revolute", (-2.0943, 2.0943), 2, -2, -4),
            ("revolute with many turns: the short way", "revolute", (-3000, 3000), 0, 10,
             10 - 4 * pi),
            ("continuous: the short way", "continuous", (None, None), 3, -3, 2 * pi - 6),
            ("prismatic: the plain difference", "prismatic", (-9, 9), -4, 4, 8),
        ],
    )
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

    def test_effort_is_unclamped_in_the_controller_and_clamped_by_the_handle(self, make):
        rig = make("effort_controllers/JointPositionController", joint="a", pid={"p": 1000.0})
        controller = rig.run("c")
        controller.set_command(1.0)
        rig.step()
        assert controller.loops[0].make_state(0, 0.001).command == 1000.0
        assert rig.model.tau[0] == 100.0

    def test_state_comes_every_tenth_update_with_the_fields_upstream_fills(self, make):
        pid = {"p": 10.0, "i": 1.0, "d": 0.5, "i_clamp_min": -3.0, "i_clamp_max": 4.0}
        rig = make("effort_controllers/JointPositionController", joint="a", pid=pid)
        rig.model.q[0], rig.model.v[0] = 0.25, 0.125
        controller = rig.manager.load("c")
        states = []
        controller.on_state = states.append
        rig.manager.switch(["c"], [])
        rig.step()
        controller.set_command(9.0)
        rig.step(25)
        assert [s.stamp_ns for s in states] == [2_000_000, 12_000_000, 22_000_000]
        first = states[0]
        # error 1.75: 10 · 1.75 + 1 · 0.00175 + 0.5 · 1.75/0.001
        assert first.command == pytest.approx(17.5 + 0.00175 + 875.0)
        assert (first.set_point, first.process_value, first.process_value_dot) == (2.0, 0.25, 0.125)
        assert (first.error, first.time_step) == (1.75, 0.001)
        assert (first.p, first.i, first.d, first.i_clamp, first.antiwindup) == (
            10.0, 1.0, 0.5, 4.0, False
        )

    def test_stopping_leaves_the_last_command(self, make):
        rig = make("effort_controllers/JointPositionController", joint="a", pid=PID)
        controller = rig.run("c")
        controller.set_command(1.0)
        rig.step()
        rig.manager.switch([], ["c"])
        rig.step(5)
        assert rig.model.tau[0] == pytest.approx(10.0)

    @pytest.mark.parametrize("bad", [nan, inf, -inf, "far", None])
    def test_a_bad_command_is_refused_and_the_last_one_kept(self, make, bad):
        rig = make("effort_controllers/JointPositionController", joint="a", pid=PID)
        controller = rig.run("c")
        controller.set_command(1.0)
        with pytest.raises(ControllerError, match="'c'"):
            controller.set_command(bad)
        rig.step()
        assert rig.model.tau[0] == pytest.approx(10.0)


def test_effort_velocity_controller(make):
    rig = make("effort_controllers/JointVelocityController", limits="none", joint="a", pid=PID)
    rig.model.v[0] = 1.0
    controller = rig.run("c")
    states = []
    controller.on_state = states.append
    rig.step()
    assert rig.model.tau[0] == -10.0  # starts with set point 0
    controller.set_command(3.0)
    rig.step(10)
    assert rig.model.tau[0] == 20.0
    state = states[-1]
    assert (state.set_point, state.process_value, state.process_value_dot) == (3.0, 1.0, 0.0)
    assert (state.error, state.command) == (2.0, 20.0)
    assert (state.stamp_ns, state.time_step) == (12_000_000, 1e-3)
    rig.step(20)
    assert len(states) == 4  # of updates 0, 10, 20 and 30
    rig.step(4)
    assert len(states) == 4


@pytest.mark.parametrize(
    ("type_name", "command", "at_start"),
    [
        ("effort_controllers/JointEffortController", "effort_command", 0.0),
        ("position_controllers/JointPositionController", "position_command", 0.5),
        ("velocity_controllers/JointVelocityController", "velocity_command", 0.0),
    ],
)
def test_forward_controllers(make, type_name, command, at_start):
    rig = make(type_name, joint="a")
    rig.model.q[0] = 0.5
    controller = rig.run("c")
    handle = rig.hardware.handles["a"]
    controller.update(0, 0.001)
    assert getattr(handle, command) == at_start
    controller.set_command(99.0)
    controller.update(0, 0.001)
    assert getattr(handle, command) == 99.0  # not clamped in the controller
    assert controller.state_kind is None


@pytest.mark.parametrize(
    ("type_name", "command", "at_start"),
    [
        ("effort_controllers/JointGroupEffortController", "effort_command", [0.0, 0.0]),
        ("position_controllers/JointGroupPositionController", "position_command", [0.5, -0.5]),
        ("velocity_controllers/JointGroupVelocityController", "velocity_command", [0.0, 0.0]),
    ],
)
def test_forward_group_controllers(make, type_name, command, at_start):
    rig = make(type_name, joints=["b", "a"])
    rig.model.q[:] = [-0.5, 0.5]
    controller = rig.run("c")
    handles = [rig.hardware.handles[name] for name in "ba"]
    controller.update(0, 0.001)
    assert [getattr(handle, command) for handle in handles] == at_start
    controller.set_command([0.25, 0.75])
    for bad in ([1.0], [1.0, 2.0, 3.0], [1.0, nan], 3.0, None):
        with pytest.raises(ControllerError, match="'c'"):
            controller.set_command(bad)
    controller.update(0, 0.001)
    assert [getattr(handle, command) for handle in handles] == [0.25, 0.75]
    assert controller.claimed_resources[0].resources == ("a", "b")


def test_group_position_controller_for_efforts(make):
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


@pytest.mark.parametrize(
    ("type_name", "parameters", "text"),
    [
        ("effort_controllers/JointPositionController", {"pid": PID}, "/robot/c/joint is missing"),
        ("effort_controllers/JointPositionController", {"joint": "a"}, "/robot/c/pid/p"),
        ("effort_controllers/JointPositionController", {"joint": "a", "pid": 3}, "/robot/c/pid"),
        ("effort_controllers/JointPositionController", {"joint": "z", "pid": PID},
         "joint 'z' does not have the EffortJointInterface; joints with it: a, b"),
        ("effort_controllers/JointEffortController", {}, "/robot/c/joint is missing"),
        ("effort_controllers/JointGroupEffortController", {"joints": []}, "non-empty list"),
        ("effort_controllers/JointGroupEffortController", {"joints": ["a", "a"]}, "different"),
        ("effort_controllers/JointGroupPositionController", {"joints": ["a"]}, "/robot/c/a/pid/p"),
    ],
)
def test_missing_parameters_are_named(make, type_name, parameters, text):
    with pytest.raises(ControllerError, match=f"cannot load controller 'c'.*{text}"):
        make(type_name, **parameters).manager.load("c")


def test_a_joint_of_another_interface_is_named_with_its_own(make):
    rig = make("position_controllers/JointPositionController", joint="a")
    rig.manager.parameters = {"c": {"type": "effort_controllers/JointEffortController",
                                    "joint": "a"}}
    with pytest.raises(ControllerError, match="only the PositionJointInterface"):
        rig.manager.load("c")
