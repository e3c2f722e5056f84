"""read() and write(): the five command modes, emergency stop, invalid transmissions."""

from dataclasses import replace
from math import inf, nan, pi

import pytest

from aras_sim_bridge.control.joints import EFFORT, POSITION, VELOCITY, RateLimitedEvent
from aras_sim_bridge.control.limits import NO_RULE
from aras_sim_bridge.errors import HardwareError

GAINS = "gazebo_ros_control"
COMMANDS = {EFFORT: "effort_command", POSITION: "position_command", VELOCITY: "velocity_command"}


def gains(joint, **values):
    return {GAINS: {"pid_gains": {joint: values}}}


def only(rig, n=1):
    """Return the hardware's last n calls of the model, without the joint's name."""
    return [(call[0], *call[2:]) for call in rig.model.calls[-n:]]


def test_state_comes_through_whatever_the_turns(make_rig, make_joint):
    rig = make_rig([make_joint("A"), make_joint("B", "continuous", POSITION)])
    rig.model.q[:], rig.model.v[:], rig.model.tau[:] = [-2.5, 40.0], [1.5, 2.5], [3.5, 4.5]
    rig.hardware.read()
    assert [(one.position, one.velocity, one.effort) for one in rig.hardware.handles.values()] == [
        (-2.5, 1.5, 3.5), (40.0, 2.5, 4.5)]
    assert rig.hardware.interfaces == {
        EFFORT: {"A"}, POSITION: {"B"}, VELOCITY: set(), "JointStateInterface": {"A", "B"}}
    assert not rig.log


class TestWriting:
    @pytest.mark.parametrize(("interface", "limits", "command", "applied"), [
        (EFFORT, None, 160.0, ("effort", "J", 100.0)), (EFFORT, "none", 1e9, ("effort", "J", 1e9)),
        (VELOCITY, None, 9.0, ("velocity", "J", 5.0, 100.0)),
        (VELOCITY, "none", 0.5, ("velocity", "J", 0.5, inf))])
    def test_a_command_is_limited_and_applied_in_every_step(
        self, make_rig, make_joint, interface, limits, command, applied
    ):
        rig = make_rig([make_joint("A", type=""),
                        make_joint("J", interface=interface, limits=limits)])
        setattr(rig.hardware.handles["J"], COMMANDS[interface], command)
        rig.hardware.write(0, 0.001)
        rig.hardware.write(1, 0.001)
        assert rig.model.calls == [applied] * 2

    @pytest.mark.parametrize("values", [{}, {"p": 20.0, "i": 5.0, "i_clamp": 9.0}])
    def test_a_position_joint_stays_where_it_was_put_until_commanded(
        self, make_rig, make_joint, values
    ):
        rig = make_rig([make_joint("J", interface=POSITION)], gains("J", **values), q=[1.0])
        handle = rig.hardware.handles["J"]
        rig.step(3)
        still = ("effort", 0.0) if values else ("position", 1.0)
        assert only(rig) == [still]
        handle.position_command = 0.2
        rig.step(3)
        assert only(rig) != [still]
        rig.model.q[0] = -1.5
        rig.hardware.hold_positions(["K"])
        rig.step()
        assert handle.position_command == pytest.approx(0.995)  # the limit has stored it
        rig.model.q[0], rig.model.v[0] = -1.5, 0.0
        rig.hardware.hold_positions(["J"])
        rig.step(3)
        assert only(rig) == [("effort", 0.0) if values else ("position", -1.5)]

    @pytest.mark.parametrize(
        ("proves", "kind", "lower", "upper", "position", "command", "effort"),
        [
            ("revolute: p · error", "revolute", -2.0, 2.0, 0.5, 1.0, 5.0),
            ("prismatic: plain difference, clamped", "prismatic", -9.0, 9.0, 2.0, -2.0, -25.0),
            ("continuous: the short way", "continuous", None, None, 3.0, -3.0, 10 * (2 * pi - 6)),
            ("revolute between +-3: the long way", "revolute", -3.0, 3.0, 2.9, -2.9, -25.0),
            ("between +-4: the short way", "revolute", -4.0, 4.0, 3.0, -3.0, 10 * (2 * pi - 6))],
    )
    def test_position_pid(
        self, make_rig, make_joint, make_limits, proves, kind, lower, upper, position, command,
        effort,
    ):
        limits = make_limits(lower, upper, 1e6, 25.0)
        rig = make_rig([make_joint("J", kind, POSITION, limits)], gains("J", p=10.0), q=[position])
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

    @pytest.mark.parametrize("bad", [nan, -inf])
    @pytest.mark.parametrize("interface", [EFFORT, POSITION, VELOCITY])
    def test_a_number_that_is_not_finite_never_reaches_the_motor(
        self, make_rig, make_joint, interface, bad
    ):
        field = COMMANDS[interface]
        kind = field.removesuffix("_command")
        first = make_rig([make_joint("J", interface=interface)], q=[0.003])
        first.hardware.start()
        setattr(first.hardware.handles["J"], field, bad)
        first.hardware.write(0, 0.001)
        assert only(first)[0][:2] == (kind, 0.003 if kind == "position" else 0.0)
        rig = make_rig([make_joint("J", interface=interface)])
        for k, command in enumerate([0.004, *[bad] * 5]):
            setattr(rig.hardware.handles["J"], field, command)
            rig.hardware.write(k, 0.001)
            assert only(rig)[0][:2] == (kind, 0.004)
        assert len(rig.log) == 1 and "not finite" in rig.log[0]


def test_hard_velocity_limits_are_those_of_the_joints_that_have_one(make_rig, make_joint):
    joints = [make_joint("A"), make_joint("B", interface=POSITION), make_joint("C", limits="none")]
    rig = make_rig(joints, {GAINS: {"hard_velocity_limits": True},
                            "joint_limits": {"B": {"has_velocity_limits": False}}}, physics=False)
    assert rig.model.calls == [("bound", "A", 5.0)]


@pytest.mark.parametrize("interface", [POSITION, VELOCITY])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pid_drive_drives_no_joint_on_that_is_too_fast(make_rig, make_joint, interface, sign):
    """5 rad/s are the limit, either way; it may be held back with all its effort."""
    rig = make_rig([make_joint("J", interface=interface)], gains("J", p=1000.0))
    for speed, wanted, effort in ((4.9, 2.0, 100.0), (5.1, 2.0, 0.0), (5.1, -2.0, -100.0)):
        rig.model.v[0] = sign * speed
        rig.hardware.read()
        rig.hardware.drives[0].rule.row[0] = NO_RULE
        far = 1.0 if interface == POSITION else 10.0
        setattr(rig.hardware.handles["J"], COMMANDS[interface], sign * wanted * far)
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
        told = [trouble.record(at) for at in (5, 6, 1_000_000_006, 2_000_000_007)]
        trouble.reset()
        told += [trouble.record(at) for at in (2_000_000_008, 2_000_000_009)]
        assert told == [True, False, False, True, True, False]

    def test_positions_that_cannot_be_reached_are_reported(self, make_rig, make_joint):
        rig = make_rig([make_joint("J", interface=POSITION)])
        for value, start_ns, n, told in ((9.0, 0, 3000, 1), (1.0, 3_000_000_000, 2000, 1),
                                         (9.0, 5_000_000_000, 3, 2)):
            for k in range(n):
                rig.hardware.handles["J"].position_command = value
                rig.hardware.write(start_ns + k * 1_000_000, 0.001)
            assert len(rig.log) == told
        assert "'J'" in rig.log[0] and "9" in rig.log[0] and "2" in rig.log[0]
        rig = make_rig([make_joint("J", interface=POSITION)])
        rig.model.stops["J"] = 1.23
        for k in range(300):
            rig.hardware.handles["J"].position_command = 1.75
            rig.hardware.write(k * 10_000_000, 0.01)
        assert rig.log == ["joint 'J': position command 1.25 is beyond the joint's stop at 1.23; "
                           "the joint stays at this stop; change the command or joint_limits"]

    @pytest.mark.parametrize(("interface", "command", "cycles", "told"), [
        (EFFORT, 160.0, 100, 0), (EFFORT, 160.0, 1000, 1),  # a saturation when it lasts
        # By rounding alone, as after a conversion from degrees, or a sum of steps.
        (EFFORT, 100.0 * (1.0 + 1e-15), 1000, 0), (POSITION, -2.0 * (1.0 + 1e-15), 1000, 0),
        (VELOCITY, 5.0 * (1.0 + 1e-15), 1000, 0),
    ])
    def test_what_is_worth_a_line(self, make_rig, make_joint, interface, command, cycles, told):
        rig = make_rig([make_joint("J", interface=interface)])
        for k in range(cycles):
            setattr(rig.hardware.handles["J"], COMMANDS[interface], command)
            rig.hardware.write(k * 1_000_000, 0.001)
        assert len(rig.log) == told


def test_emergency_stop_ends_effort_and_velocity_and_holds_a_position(make_rig, make_joint):
    rig = make_rig([make_joint("E"), make_joint("V", interface=VELOCITY),
                    make_joint("P", interface=POSITION)], q=[0.0, 0.0, 0.3])
    handles = rig.hardware.handles
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


class TestTransmissions:

    @pytest.mark.parametrize(
        "more",
        [{"has_actuator": False}, {"type": ""}, {"interface": ""}, {"joint": ""},
         {"joints": ("J", "K")}],
    )
    def test_an_incomplete_one_is_skipped_aloud(self, make_rig, make_joint, more):
        rig = make_rig([make_joint("J", **more)])
        assert not rig.hardware.handles
        assert "J_transmission" in rig.log[0]

    def test_interfaces_and_joints_of_transmissions(self, make_rig, make_joint):
        """TIAGo lists its mimicking fingers so, and the state's interface before its others."""
        state, full = "JointStateInterface", f"hardware_interface/{POSITION}"
        rig = make_rig([
            make_joint("J", interface=state, interfaces=(state,)),
            make_joint("K", interface=state, interfaces=(state, full)),
            make_joint("L", interfaces=(EFFORT, full)),
            *((joint, replace(transmission, interface=EFFORT))
              for joint, transmission in map(make_joint, "AB"))])
        assert {name: one.interface for name, one in rig.hardware.handles.items()} == {
            "K": POSITION, "L": EFFORT, "A": EFFORT, "B": EFFORT}
        skipped, several, unprefixed = rig.log
        assert "J_transmission' is skipped: hardware_interface/JointStateInterface" in skipped
        assert "only the first of the interfaces" in several
        assert "A, B" in unprefixed
        for text, *joints in (
            ("PushInterface.*'J'", make_joint("J", interface="PushInterface")),
            ("'K' is not a movable joint", make_joint("J", joint="K")),
            ("'J' is not a movable joint", make_joint("J", "fixed")),
            ("'J' already has a transmission", make_joint("J"), make_joint("J2", joint="J"))):
            with pytest.raises(HardwareError, match=text):
                make_rig(joints)
