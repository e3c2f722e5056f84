"""read() and write(): the five command modes, emergency stop, invalid transmissions."""

from dataclasses import replace
from math import inf, nan, pi

import pytest

from aras_sim_bridge.control.joints import EFFORT, POSITION, VELOCITY, RateLimitedEvent
from aras_sim_bridge.control.limits import NO_RULE
from aras_sim_bridge.errors import HardwareError

GAINS = "gazebo_ros_control"


def gains(joint, **values):
    return {GAINS: {"pid_gains": {joint: values}}}


def only(rig, n=1):
    """Return the hardware's last n calls of the model, without the joint's name."""
    return [(call[0], *call[2:]) for call in rig.model.calls[-n:]]


class TestReading:
    def test_state_comes_through_whatever_the_turns(self, make_rig, make_joint):
        rig = make_rig([make_joint("A"), make_joint("B", "continuous")])
        for q in (-2.5, 3.0, -3.0, 40.0):
            rig.model.q[:], rig.model.v[:], rig.model.tau[:] = [q, -q], [1.5, 2.5], [3.5, 4.5]
            rig.hardware.read()
            a, b = rig.hardware.handles.values()
            assert (a.position, a.velocity, a.effort) == (q, 1.5, 3.5)
            assert (b.position, b.velocity, b.effort) == (-q, 2.5, 4.5)


class TestWriting:
    @pytest.mark.parametrize(("interface", "limits", "command", "applied"), [
        (EFFORT, None, 160.0, ("effort", 100.0)), (EFFORT, "none", 1e9, ("effort", 1e9)),
        (VELOCITY, None, 9.0, ("velocity", 5.0, 100.0)),
        (VELOCITY, "none", 0.5, ("velocity", 0.5, inf)),
    ])
    def test_a_command_is_limited_and_applied_in_every_step(
        self, make_rig, make_joint, interface, limits, command, applied
    ):
        rig = make_rig([make_joint("A", type=""), make_joint("J", interface=interface,
                                                             limits=limits)])
        name = {EFFORT: "effort", VELOCITY: "velocity"}[interface]
        setattr(rig.hardware.handles["J"], f"{name}_command", command)
        rig.hardware.write(0, 0.001)
        rig.hardware.write(1, 0.001)
        assert rig.model.calls == [(applied[0], "J", *applied[1:])] * 2


    @pytest.mark.parametrize("values", [{}, {"p": 20.0, "i": 5.0, "i_clamp": 9.0}])
    def test_a_position_joint_stays_where_it_was_put_until_commanded(
        self, make_rig, make_joint, values
    ):
        rig = make_rig([make_joint("J", interface=POSITION)], gains("J", **values), q=[1.0])
        rig.step(3)
        still = ("effort", 0.0) if values else ("position", 1.0)
        assert only(rig) == [still]
        rig.hardware.handles["J"].position_command = 0.2
        rig.step(3)
        assert only(rig) != [still]
        rig.model.q[0] = -1.5
        rig.hardware.hold_positions(["K"])
        rig.step()
        assert rig.hardware.handles["J"].position_command == pytest.approx(
            0.995)  # the limit has stored it
        rig.model.q[0], rig.model.v[0] = -1.5, 0.0
        rig.hardware.hold_positions(["J"])
        rig.step(3)
        assert only(rig) == [("effort", 0.0) if values else ("position", -1.5)]

    @pytest.mark.parametrize(
        ("proves", "kind", "lower", "upper", "position", "command", "effort"),
        [
            ("revolute: p · error", "revolute", -2.0, 2.0, 0.5, 1.0, 5.0),
            ("effort clamped", "revolute", -20.0, 20.0, 0.0, 3.0, 25.0),
            ("prismatic: plain difference", "prismatic", -9.0, 9.0, 2.0, -2.0, -25.0),
            ("continuous: the short way", "continuous", None, None, 3.0, -3.0, 10 * (2 * pi - 6)),
            ("revolute between +-3: the long way", "revolute", -3.0, 3.0, 2.9, -2.9, -25.0),
            ("between +-4: the short way", "revolute", -4.0, 4.0, 3.0, -3.0, 10 * (2 * pi - 6)),
        ],
    )
    def test_position_pid(
        self, make_rig, make_joint, make_limits, proves, kind, lower, upper, position, command,
        effort,
    ):
        limits = make_limits(lower, upper, 1e6, 25.0)
        rig = make_rig([make_joint("J", kind, POSITION, limits)], gains("J", p=10.0))
        rig.model.q[0] = position
        rig.hardware.read()
        rig.hardware.handles["J"].position_command = command
        rig.hardware.write(0, 0.001)
        assert only(rig)[0] == ("effort", pytest.approx(effort)), proves
        assert rig.hardware.pids["J"].gains.p == 10.0

    def test_gains_without_p_mean_no_pid_and_a_line(self, make_rig, make_joint):
        rig = make_rig([make_joint("J", interface=POSITION)], gains("J", i=10.0))
        rig.hardware.write(0, 0.001)
        assert only(rig) == [("position", 0.0)]
        assert "pid_gains/J has no p" in rig.log[0]
        with pytest.raises(HardwareError, match="/robot/gazebo_ros_control/pid_gains/J/p"):
            make_rig([make_joint("J", interface=POSITION)], gains("J", p="much"))

    @pytest.mark.parametrize("bad", [nan, inf, -inf])
    @pytest.mark.parametrize(
        ("interface", "command", "kind"),
        [
            ("EffortJointInterface", "effort_command", "effort"),
            (POSITION, "position_command", "position"),
            (VELOCITY, "velocity_command", "velocity"),
        ],
    )
    def test_a_number_that_is_not_finite_never_reaches_the_motor(
        self, make_rig, make_joint, interface, command, kind, bad
    ):
        first = make_rig([make_joint("J", interface=interface)], q=[0.003])
        first.hardware.start()
        setattr(first.hardware.handles["J"], command, bad)
        first.hardware.write(0, 0.001)
        assert only(first)[0][:2] == (kind, 0.003 if kind == "position" else 0.0)
        rig = make_rig([make_joint("J", interface=interface)])
        handle = rig.hardware.handles["J"]
        setattr(handle, command, 0.004)
        rig.hardware.write(0, 0.001)
        for k in range(5):
            setattr(handle, command, bad)
            rig.hardware.write(k, 0.001)
            assert only(rig)[0][:2] == (kind, 0.004)
        assert len(rig.log) == 1
        assert "not finite" in rig.log[0]


def test_hard_velocity_limits_are_those_of_the_joints_that_have_one(make_rig, make_joint):
    joints = [make_joint("A"), make_joint("B", interface=POSITION),
              make_joint("C", limits="none")]
    rig = make_rig(joints, {GAINS: {"hard_velocity_limits": True},
                            "joint_limits": {"B": {"has_velocity_limits": False}}}, physics=False)
    assert rig.model.calls == [("bound", "A", 5.0)]


@pytest.mark.parametrize("interface", [POSITION, VELOCITY])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pid_drive_drives_no_joint_on_that_is_too_fast(make_rig, make_joint, interface, sign):
    """5 rad/s are the limit, either way; it may be held back with all its effort."""
    rig = make_rig([make_joint("J", interface=interface)], gains("J", p=1000.0))
    handle = rig.hardware.handles["J"]
    for speed, wanted, effort in ((4.9, 2.0, 100.0), (5.1, 2.0, 0.0), (5.1, -2.0, -100.0)):
        rig.model.v[0] = sign * speed
        rig.hardware.read()
        if interface == POSITION:
            handle.position_command = handle.position + sign * wanted
            rig.hardware.drives[0].rule.reset()
            rig.hardware.write(0, 1.0)
        else:
            handle.velocity_command = sign * (20.0 if wanted > 0 else -20.0)
            rig.hardware.drives[0].rule.row[0] = NO_RULE
            rig.hardware.write(0, 0.001)
        assert only(rig) == [("effort", sign * effort)]


@pytest.mark.parametrize(("e_stop", "speed", "effort"), [(False, 1.0, 30.0), (True, 2.0, -20.0)])
def test_a_velocity_pid_drives_the_joint_and_brakes_it_in_an_emergency(
    make_rig, make_joint, e_stop, speed, effort
):
    """The joint is the second of two, of which the first has no transmission."""
    rig = make_rig([make_joint("A", type=""), make_joint("J", interface=VELOCITY)],
                   gains("J", p=10.0))
    rig.model.v[:] = [7.0, speed]
    rig.hardware.read()
    rig.hardware.handles["J"].velocity_command = 4.0
    rig.hardware.e_stop = e_stop
    rig.hardware.write(0, 0.001)
    assert only(rig) == [("effort", effort)]


class TestReporting:
    def test_after_a_second_without_it_or_a_reset_a_trouble_is_news_again(self):
        trouble = RateLimitedEvent()
        assert trouble.record(5) and not trouble.record(6)
        assert not trouble.record(1_000_000_006) and trouble.record(2_000_000_007)
        trouble.reset()
        assert trouble.record(2_000_000_008) and not trouble.record(2_000_000_009)

    def test_a_position_beyond_the_range_is_told_once_an_occurrence(self, make_rig, make_joint):
        rig = make_rig([make_joint("J", interface=POSITION)])
        handle = rig.hardware.handles["J"]

        def command(value, start_ns, n):
            for k in range(n):
                handle.position_command = value
                rig.hardware.write(start_ns + k * 1_000_000, 0.001)

        command(9.0, 0, 3000)
        assert len(rig.log) == 1
        assert "'J'" in rig.log[0] and "9" in rig.log[0] and "2" in rig.log[0]
        command(1.0, 3_000_000_000, 2000)
        command(9.0, 5_000_000_000, 3)
        assert len(rig.log) == 2
        free = make_rig([make_joint("J", "continuous", POSITION)])
        for k in range(3000):
            free.hardware.handles["J"].position_command = -9.0
            free.hardware.write(k * 1_000_000, 0.001)
        assert free.log == []  # it has no range

    def test_a_joint_that_rests_at_a_stop_within_its_range_is_told(self, make_rig, make_joint):
        rig = make_rig([make_joint("J", interface=POSITION)])
        rig.model.stops["J"] = 1.23
        for k in range(300):
            rig.hardware.handles["J"].position_command = 1.75
            rig.hardware.write(k * 10_000_000, 0.01)
        assert rig.log == ["joint 'J': position command 1.25 is beyond the joint's stop at 1.23; "
                           "the joint stays at this stop; change the command or joint_limits"]

    @pytest.mark.parametrize("interface", [EFFORT, POSITION, VELOCITY])
    def test_a_command_that_is_beyond_a_limit_by_rounding_is_not_worth_a_line(
        self, make_rig, make_joint, interface
    ):
        """As after a conversion from degrees, or a sum of steps."""
        rig = make_rig([make_joint("J", interface=interface)])
        handle = rig.hardware.handles["J"]
        limits = handle.limits
        bound = {EFFORT: limits.effort, POSITION: limits.upper, VELOCITY: limits.velocity}
        name = {EFFORT: "effort", POSITION: "position", VELOCITY: "velocity"}[interface]
        for k in range(2000):
            sign = 1.0 if k < 1000 else -1.0
            setattr(handle, f"{name}_command", sign * bound[interface] * (1.0 + 1e-15))
            rig.hardware.write(k * 1_000_000, 0.001)
        assert rig.log == []

    def test_a_short_saturation_of_effort_is_not_worth_a_line_a_lasting_one_is(
        self, make_rig, make_joint
    ):
        rig = make_rig([make_joint("J")])
        handle = rig.hardware.handles["J"]
        for k in range(1000):
            handle.effort_command = 160.0
            rig.hardware.write(k * 1_000_000, 0.001)
            if k == 100:
                assert not rig.log
        assert len(rig.log) == 1


class TestEmergencyStop:
    def test_effort_and_velocity_go_to_zero_position_holds_where_it_was(self, make_rig, make_joint):
        rig = make_rig([
            make_joint("E"),
            make_joint("V", interface=VELOCITY),
            make_joint("P", interface=POSITION),
        ])
        handles = rig.hardware.handles
        rig.model.q[2] = 0.3
        rig.hardware.read()
        rig.hardware.e_stop = True
        handles["E"].effort_command = 5.0
        handles["V"].velocity_command = 1.0
        for _ in range(2):
            handles["P"].position_command = 1.0
            rig.hardware.write(0, 0.001)
            assert only(rig, 3) == [("effort", 0.0), ("velocity", 0.0, 100.0), ("position", 0.3)]
        rig.hardware.e_stop = False
        rig.hardware.write(0, 0.001)
        assert only(rig, 3)[0] == ("effort", 5.0)
        rig.model.q[2] = 0.303  # as far as its velocity limit lets a command go
        rig.hardware.read()
        rig.hardware.e_stop = True
        rig.hardware.write(0, 0.001)
        # Each stop holds its own place.
        assert only(rig, 3)[2] == ("position", pytest.approx(0.303))


class TestTransmissions:
    def test_all_interfaces_exist_and_every_joint_has_a_state(self, make_rig, make_joint):
        rig = make_rig([make_joint("A"), make_joint("B", interface=POSITION)])
        assert rig.hardware.interfaces == {
            "EffortJointInterface": {"A"}, POSITION: {"B"}, VELOCITY: set(),
            "JointStateInterface": {"A", "B"},
        }
        assert not rig.log

    @pytest.mark.parametrize(
        "more",
        [{"has_actuator": False}, {"type": ""}, {"interface": ""}, {"joint": ""},
         {"joints": ("J", "K")}],
    )
    def test_an_incomplete_one_is_skipped_aloud(self, make_rig, make_joint, more):
        rig = make_rig([make_joint("J", **more)])
        assert not rig.hardware.handles
        assert "J_transmission" in rig.log[0]

    def test_one_for_states_alone_commands_nothing_and_refuses_nothing(self, make_rig, make_joint):
        """TIAGo lists its mimicking fingers so, and the state's interface before its others."""
        state = "JointStateInterface"
        rig = make_rig([
            make_joint("J", interface=state, interfaces=(state,)),
            make_joint("K", interface=state, interfaces=(state, f"hardware_interface/{POSITION}")),
        ])
        assert set(rig.hardware.handles) == {"K"}
        assert rig.hardware.handles["K"].interface == POSITION
        assert len(rig.log) == 1
        assert "J_transmission' is skipped: hardware_interface/JointStateInterface" in rig.log[0]

    def test_of_several_interfaces_the_first_counts(self, make_rig, make_joint):
        rig = make_rig([make_joint("J", interfaces=("EffortJointInterface", POSITION))])
        assert rig.hardware.handles["J"].interface == "EffortJointInterface"
        assert "only the first of the interfaces" in rig.log[0]

    def test_interface_without_prefix_is_taken_with_one_line_for_all(self, make_rig, make_joint):
        rig = make_rig([(joint, replace(transmission, interface="EffortJointInterface"))
                        for joint, transmission in map(make_joint, "AB")])
        assert set(rig.hardware.handles) == {"A", "B"}
        assert len(rig.log) == 1
        assert "A, B" in rig.log[0]

    def test_unknown_interface_joint_and_double_drive_are_refused(self, make_rig, make_joint):
        with pytest.raises(HardwareError, match="PushInterface.*'J'"):
            make_rig([make_joint("J", interface="PushInterface")])
        with pytest.raises(HardwareError, match="'K' is not a movable joint"):
            make_rig([make_joint("J", joint="K")])
        with pytest.raises(HardwareError, match="'J' is not a movable joint"):
            make_rig([make_joint("J", "fixed")])
        with pytest.raises(HardwareError, match="'J' already has a transmission"):
            make_rig([make_joint("J"), make_joint("J2", joint="J")])
