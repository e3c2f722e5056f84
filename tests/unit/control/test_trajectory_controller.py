"""JointTrajectoryController, with steps of 10 ms; the cycle after a command is its time 0."""

from itertools import pairwise
from math import nan, pi

import pytest

from aras_sim_bridge.control.controllers.trajectory_types import (
    ErrorCode,
    InvalidTrajectoryError,
    JointTolerance,
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
    TrajectoryResult,
)
from aras_sim_bridge.errors import ControllerError

S = 1_000_000_000
STEP = 10_000_000


def point(time, positions, velocities=(), accelerations=()):
    return TrajectoryPoint(round(time * S), positions, velocities, accelerations)


def line(goal=1.0, time=1.0, joint="a", stamp_ns=0):
    return Trajectory([joint], [point(time, [goal])], stamp_ns)


class Bench:
    """A running controller 'c'; q() is the commanded position of a joint."""

    def __init__(self, rig):
        self.rig = rig
        self.controller = rig.run("c")
        rig.step(3)

    def q(self, joint="a"):
        return self.rig.hardware.handles[joint].position_command

    def after(self, seconds):
        self.rig.step(round(seconds * 100))
        return self.q()


@pytest.fixture
def make(make_rig, make_joint):
    def _make(kind="position", names="a", joint_kind="revolute", start=None, **parameters):
        own = {"type": f"{kind}_controllers/JointTrajectoryController", "joints": list(names),
               **parameters}
        interface = f"{kind.title()}JointInterface"
        joints = [make_joint(name, joint_kind, interface, "none") for name in sorted(names)]
        return make_rig(joints, {"c": own}, STEP, physics=kind != "position", q=start)

    return _make


@pytest.fixture
def bench(make):
    return lambda *args, **kwargs: Bench(make(*args, **kwargs))


class TestFollowing:
    def test_start_holds_the_measured_position(self, make):
        rig = make(start=[0.4])
        rig.hardware.handles["a"].position_command = 0.9  # somebody else's
        rig.run("c")
        rig.step(50)
        assert {position for _, _, position in rig.model.calls} == {0.4}

    @pytest.mark.parametrize(("more", "quarter"), [
        (([], []), 0.25), (([0.0], []), 3 * 0.25**2 - 2 * 0.25**3),
        (([0.0], [0.0]), 10 * 0.25**3 - 15 * 0.25**4 + 6 * 0.25**5)])
    def test_a_spline_begins_in_the_next_cycle_and_ends_on_the_point(self, bench, more, quarter):
        b = bench()
        b.controller.set_command(Trajectory(["a"], [point(1.0, [1.0], *more)]))
        assert [b.after(time) for time in (0.01, 0.25, 0.75, 3.0)] == pytest.approx(
            [0.0, quarter, 1.0, 1.0])

    def test_joints_in_another_order_are_mapped(self, bench):
        b = bench(names="ba")
        b.controller.set_command(Trajectory(["a", "b"], [point(1.0, [0.25, 0.75])]))
        b.after(2.0)
        assert (b.q("a"), b.q("b")) == (0.25, 0.75)

    def test_points_in_the_past_are_dropped_and_a_present_one_is_finished(self, bench):
        b, states = bench(), []
        points = [point(0.1, [9.0]), point(0.2, [8.0]), point(1.02, [1.0]), point(2.02, [2.0])]
        b.controller.set_command(Trajectory(["a"], points, b.rig.time_ns - S // 2))
        assert any("2 of 4" in text for text in b.rig.log)
        # Next cycle is 0.51 into it; the bridge reaches 1.0 another 0.51 later.
        b.controller.on_state = states.append
        assert [b.after(time) for time in (0.01, 0.26)] == pytest.approx([0.0, 0.26 / 0.51])
        assert states[-1].desired.time_from_start == pytest.approx(0.51)
        assert [b.after(time) for time in (0.25, 0.5)] == pytest.approx([1.0, 1.5])
        b = bench(start=[0.4])
        points = [point(0.0, [9.0]), point(1.0, [1.4])]
        b.controller.set_command(Trajectory(["a"], points))
        assert not b.rig.log
        assert b.after(0.51) == pytest.approx(0.9)
        b.controller.set_command(Trajectory(["a"], points, b.rig.time_ns - STEP))  # as it was meant
        assert "1 of 2 trajectory points are in the past" in b.rig.log[0]
        b = bench()
        points = [point(0.2, [0.2]), point(0.4, [0.6]), point(1.0, [1.2])]
        b.controller.set_command(Trajectory(["a"], points))
        b.rig.step(1)
        b.controller.set_command(line(0.0, 0.5, stamp_ns=b.rig.time_ns + 7 * S // 10))
        assert [b.after(0.1) for _ in range(8)] == pytest.approx(
            [0.1, 0.2, 0.4, 0.6, 0.7, 0.8, 0.9, 0.72])

    @pytest.mark.parametrize(("kind", "shift"), [("continuous", 2 * pi), ("revolute", 0.0)])
    def test_continuous_joints_take_the_short_way_with_all_points_shifted(self, bench, kind, shift):
        b = bench(joint_kind=kind, start=[3.0])
        b.controller.set_command(Trajectory(["a"], [point(1.0, [-3.0]), point(2.0, [-2.0])]))
        assert b.after(0.51) == pytest.approx(shift / 2)
        assert b.after(0.5) == pytest.approx(shift - 3.0)
        assert b.after(1.0) == pytest.approx(shift - 2.0)

    @pytest.mark.parametrize(("wanted", "reached"), [
        *[(0.4 + 2 * pi * turns, 0.4) for turns in (-7, -1, 0, 1, 10)],
        # Only at half a turn the plain difference decides.
        (pi, pi), (-pi, -pi), (pi + 5e-4, 5e-4 - pi), (-pi - 5e-4, pi - 5e-4),
        (pi - 5e-4, pi - 5e-4),
    ])
    def test_a_continuous_joint_sheds_all_full_turns(self, bench, wanted, reached):
        b = bench(joint_kind="continuous")
        b.controller.submit_goal(TrajectoryGoal(line(wanted, 0.1)))
        assert b.after(0.2) == pytest.approx(reached, abs=1e-9)

    def test_a_clock_set_back_does_not_lose_the_trajectory(self, bench):
        b = bench()
        b.controller.set_command(line())
        b.rig.step(51)
        b.rig.time_ns = 0
        b.rig.loop.reset()
        assert b.after(0.25) == pytest.approx(0.75)


def test_joints_that_a_goal_leaves_out_follow_on_and_it_waits_for_them(bench):
    with pytest.raises(InvalidTrajectoryError, match="allow_partial") as caught:
        bench(names="ab").controller.set_command(line())
    assert caught.value.code == ErrorCode.INVALID_JOINTS
    b = bench(names="ab", allow_partial_joints_goal=True)
    b.controller.set_command(Trajectory(["a", "b"], [point(2.0, [1.0, 1.0])]))
    b.rig.step(51)
    handle = b.controller.submit_goal(TrajectoryGoal(line(0.0, 0.5)))
    b.rig.step(53)
    assert (b.q("a"), b.q("b")) == pytest.approx((0.0, (51 + 52) * 0.005))
    assert handle.status == "active"
    b.rig.step(96)
    assert handle.status == "active"  # b arrives with the 201st cycle
    b.rig.step(3)
    assert handle.status == "succeeded"
    assert (b.q("a"), b.q("b")) == pytest.approx((0.0, 1.0))


class TestGoals:
    def test_success_when_the_end_is_reached(self, bench):
        b = bench(constraints={"a": {"goal": 0.02}})
        for end in (1.0, 1.5):
            handle, done = b.controller.submit_goal(TrajectoryGoal(line(end))), []
            handle.on_done = done.append
            b.rig.step(101)
            assert handle.status == "active" and not done
            b.rig.step(1)
            assert (handle.status, handle.result.error_code) == ("succeeded", ErrorCode.SUCCESSFUL)
            b.rig.step(10)
            assert done == [handle]

    @pytest.mark.parametrize(("limits", "steps", "code", "text"), [
        ({"trajectory": 0.105}, 11, ErrorCode.PATH_TOLERANCE_VIOLATED, "a path error 0.110000"),
        ({"goal": 0.05}, 101, ErrorCode.GOAL_TOLERANCE_VIOLATED, "a goal error 1.000000"),
    ])
    def test_a_tolerance_aborts_and_says_by_how_much(self, bench, limits, steps, code, text):
        b = bench(constraints={"a": limits})
        b.rig.model.stuck.add("a")
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(steps)
        assert handle.status == "active"
        b.rig.step(1)
        assert handle.status == "aborted"
        assert (handle.result.error_code, handle.result.error_string) == (code, text)

    @pytest.mark.parametrize(("moves_at", "status"), [(130, "succeeded"), (200, "aborted")])
    def test_goal_time_waits_for_who_arrives_late(self, bench, moves_at, status):
        b = bench(constraints={"goal_time": 0.5, "a": {"goal": 0.05}})
        b.rig.model.stuck.add("a")
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        for step in range(151):
            if step == moves_at:
                b.rig.model.stuck.clear()
            assert handle.status == "active" or step > 130
            b.rig.step()
        assert handle.status == status

    @pytest.mark.parametrize(("given", "code"), [
        ({}, ErrorCode.GOAL_TOLERANCE_VIOLATED),
        ({"stopped_velocity_tolerance": 0.0}, ErrorCode.SUCCESSFUL),
    ])
    def test_stopped_velocity_tolerance_must_hold_at_the_goal(self, bench, given, code):
        b = bench(constraints=given)
        b.rig.model.v[0] = 0.02
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(102)
        assert handle.result.error_code == code

    @pytest.mark.parametrize(("proves", "path", "at_goal", "time", "status"), [
        ("above 0 overrides", 5.0, 5.0, 0.0, "succeeded"),
        ("below 0 removes", -1.0, -1.0, 0.0, "succeeded"),
        ("0 keeps the default", 0.0, -1.0, 0.0, "aborted"),
        ("at the goal too", -1.0, 0.0, 0.0, "aborted"),
        ("goal time above 0 waits", -1.0, None, 9.0, "active"),
        ("goal time below 0 does not", -1.0, None, -1.0, "aborted")])
    def test_tolerances_of_the_goal(self, bench, proves, path, at_goal, time, status):
        b = bench(constraints={"a": {"trajectory": 0.1, "goal": 0.1}})
        b.rig.model.stuck.add("a")
        goals = [] if at_goal is None else [JointTolerance("a", at_goal)]
        handle = b.controller.submit_goal(
            TrajectoryGoal(line(), [JointTolerance("a", path)], goals, time))
        b.rig.step(110)
        assert handle.status == status, proves

    def test_a_listener_may_command_and_tolerances_do_not_matter_to_topic_commands(self, bench):
        b = bench(constraints={"a": {"trajectory": 0.1, "goal": 0.1}})
        handle = b.controller.submit_goal(TrajectoryGoal(line(0.1, 0.1)))
        handle.on_done = lambda _: (
            b.rig.model.stuck.add("a"), b.controller.set_command(line(0.5, 0.1)))
        assert b.after(2.0) == pytest.approx(0.5)

    def test_a_new_goal_and_a_topic_command_preempt(self, bench):
        b = bench()
        first, told = b.controller.submit_goal(TrajectoryGoal(line())), []
        first.on_done = told.append
        b.rig.step(51)
        second = b.controller.submit_goal(TrajectoryGoal(line(0.0, 0.5)))
        assert (first.status, second.status, told) == ("preempted", "active", [first])
        assert first.result == TrajectoryResult(ErrorCode.SUCCESSFUL, "preempted by a new goal")
        assert b.after(0.26) == pytest.approx(0.51 / 2, abs=0.01)
        b.controller.set_command(line(2.0, 1.0))
        assert second.status == "preempted"
        assert b.after(1.01) == pytest.approx(2.0)

    def test_what_is_refused_does_not_disturb_the_active_goal(self, bench):
        b = bench()
        first = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(1)
        second = b.controller.submit_goal(TrajectoryGoal(line(joint="z")))
        assert second.status == "rejected"
        assert second.result.error_code == ErrorCode.INVALID_JOINTS
        with pytest.raises(InvalidTrajectoryError, match="all 1 trajectory points are in the past"):
            b.controller.set_command(line(9.0, 0.1, stamp_ns=b.rig.time_ns - S // 5))
        assert first.status == "active"
        assert b.after(0.5) == pytest.approx(0.5)
        b = bench()
        for path, time in (([JointTolerance("z", 1.0)], 0.0), ([JointTolerance("a", nan)], 0.0),
                           ((), nan)):
            goal = TrajectoryGoal(line(), path, (), time)
            assert b.controller.submit_goal(goal).status == "rejected"

    def test_cancel_and_a_command_without_points_hold_where_it_is(self, bench):
        b = bench()
        handle, told = b.controller.submit_goal(TrajectoryGoal(line())), []
        handle.on_done = told.append
        b.rig.step(51)
        assert b.controller.cancel_goal(handle)
        assert (handle.status, told) == ("preempted", [handle])
        assert handle.result == TrajectoryResult(ErrorCode.SUCCESSFUL, "cancelled")
        # Measured is what the previous cycle commanded.
        assert b.after(1.0) == pytest.approx(0.49)
        assert not b.controller.cancel_goal(handle)
        b.controller.set_command(line())
        b.rig.step(51)
        b.controller.set_command(Trajectory(["a"], []))
        assert b.after(1.0) == pytest.approx(0.49 + 0.49 * 0.51)

    def test_stopping_the_controller_ends_the_goal_and_who_does_not_run_refuses(self, bench, make):
        b = bench()
        handle, told = b.controller.submit_goal(TrajectoryGoal(line())), []
        handle.on_done = told.append
        b.rig.manager.switch([], ["c"])
        b.rig.step(1)
        assert handle.status == "preempted" and told == [handle]
        for controller in (b.controller, make().manager.load("c")):
            late = controller.submit_goal(TrajectoryGoal(line()))
            assert (late.status, late.result.error_code) == ("rejected", ErrorCode.INVALID_GOAL)
            for call in (lambda c=controller: c.set_command(line()),
                         lambda c=controller: c.query_state(b.rig.time_ns)):
                with pytest.raises(ControllerError, match="not running"):
                    call()

    @pytest.mark.parametrize(("joints", "points", "code", "text"), [
        ("aa", [point(1, [1, 1])], ErrorCode.INVALID_JOINTS, "repeated"),
        ("", [point(1, [])], ErrorCode.INVALID_JOINTS, "empty"),
        ("ab", [], ErrorCode.INVALID_JOINTS, "unknown are 'b'"),
        ("a", [point(1, [])], ErrorCode.INVALID_GOAL, "0 positions for 1"),
        ("a", [point(1, [1, 2], [1])], ErrorCode.INVALID_GOAL, "1 velocities"),
        ("a", [point(1, [1], [1, 2])], ErrorCode.INVALID_GOAL, "2 velocities"),
        ("a", [point(1, [nan])], ErrorCode.INVALID_GOAL, "not finite"),
        ("a", [point(1, [1], [nan])], ErrorCode.INVALID_GOAL, "not finite"),
        ("a", [point(1, [1]), point(1, [2])], ErrorCode.INVALID_GOAL, "strictly increase"),
        ("a", [point(0, [1])], ErrorCode.INVALID_GOAL, "past")])
    def test_bad_goals_are_rejected_with_the_reason(self, bench, joints, points, code, text):
        handle = bench().controller.submit_goal(TrajectoryGoal(Trajectory(list(joints), points)))
        assert (handle.status, handle.result.error_code) == ("rejected", code)
        assert text in handle.result.error_string

    @pytest.mark.parametrize(("pushed", "status"), [(0.0, "succeeded"), (1.0, "aborted")])
    def test_an_empty_goal_holds_and_checks_the_tolerance_that_it_brings(
        self, bench, pushed, status
    ):
        b = bench("effort", gains={"a": {"p": 0.0}}, stop_trajectory_duration=0.5)
        tight = (JointTolerance("a", position=0.01),)
        handle = b.controller.submit_goal(TrajectoryGoal(Trajectory(["a"], []), (), tight))
        b.rig.model.v[0] = pushed
        b.rig.step(60)
        assert handle.status == status
        expected = ErrorCode.GOAL_TOLERANCE_VIOLATED if pushed else ErrorCode.SUCCESSFUL
        assert handle.result.error_code == expected


class TestStopping:
    def test_it_brakes_to_rest_and_holds(self, bench):
        b = bench(stop_trajectory_duration=0.5)
        b.controller.set_command(line(2.0, 1.0))
        b.rig.step(50)
        begin = b.q()  # moving at 2 a second
        b.controller.set_command(Trajectory(["a"], []))
        positions = [b.after(0.01) for _ in range(80)]
        assert positions[0] == pytest.approx(begin + 0.02, abs=1e-3)
        assert positions[50:] == pytest.approx([positions[-1]] * 30, abs=1e-3)
        # v t - v t³/(2 T²) + v t⁴/(8 T³), the symmetric quintic, is 5/8 v T at T.
        assert positions[-1] - begin == pytest.approx(0.625 * 2.0 * 0.5)
        b = bench(stop_trajectory_duration=0.5)
        b.controller.set_command(line(2.0, 1.0))
        b.rig.step(50)
        b.rig.manager.switch(["c"], [], 1)
        b.rig.step(2)
        held = b.q()
        assert b.after(0.5) == held == pytest.approx(0.98)

class TestOutputsAndState:
    @pytest.mark.parametrize(("kind", "gains", "forward", "command"), [
        # desired 0.5 at velocity 1 against rest: 3 · 1 + 100 · 0.5 + 10 · 1
        ("effort", {"p": 100.0, "d": 10.0}, {"a": 3.0}, 63.0),
        ("effort", {"p": 100.0, "d": 10.0}, {}, 60.0),
        ("velocity", {"p": 2.0}, {"a": 1.0}, 2.0),
    ])
    def test_commands_are_feed_forward_and_pid_on_both_errors(
        self, bench, kind, gains, forward, command
    ):
        b = bench(kind, gains={"a": gains}, velocity_ff=forward)
        b.rig.model.stuck.add("a")
        b.controller.set_command(line())
        b.rig.step(51)
        handle = b.rig.hardware.handles["a"]
        assert getattr(handle, f"{kind}_command") == pytest.approx(command)
        assert set(b.controller.pids) == {"gains/a"}

    def test_state_at_fifty_hertz_with_errors_as_angles(self, bench):
        b, states = bench(), []
        b.rig.model.stuck.add("a")
        b.rig.model.q[0] = 0.25
        b.controller.on_state = states.append
        b.controller.set_command(Trajectory(["a"], [point(1.0, [1.0]), point(2.0, [2.0])]))
        b.rig.step(151)
        assert {b.stamp_ns - a.stamp_ns for a, b in pairwise(states)} == {20_000_000}
        state = states[-1]
        desired, actual, error = state.desired, state.actual, state.error
        assert state.joint_names == ("a",)
        assert desired.positions[0] == pytest.approx(1.5, abs=0.011)
        assert (desired.velocities, desired.time_from_start) == ([1.0], 1.0)
        assert (actual.positions, actual.velocities) == ([0.25], [0.0])
        assert actual.time_from_start == pytest.approx(1.5, abs=0.011)
        assert error.time_from_start == pytest.approx(0.5, abs=0.011)
        assert error.positions[0] == pytest.approx(desired.positions[0] - 0.25)
        assert error.velocities == [1.0]
        b.controller.set_command(line(4.25, 0.1))
        b.rig.step(50)
        assert states[-1].error.positions[0] == pytest.approx(4.0 - 2 * pi)

    @pytest.mark.parametrize(("rates", "expected"), [
        ({}, [6, 11]), ({"state_publish_rate": 0.0, "action_monitor_rate": 0.0}, [])])
    def test_a_goal_s_feedback_has_a_rhythm_of_its_own(self, bench, rates, expected):
        """At 20 a second: 50 ms after the cycle that takes it, whatever went before."""
        b, states = bench(**rates), []
        b.controller.on_state = states.append
        for pause in (2, 3):
            times, begin = [], b.rig.time_ns
            handle = b.controller.submit_goal(TrajectoryGoal(line()))
            handle.on_feedback = lambda state, times=times: times.append(state.stamp_ns)
            b.rig.step(10 + pause)
            assert [(time - begin) // STEP for time in times] == expected
        assert bool(states) is not bool(rates)

    def test_the_state_at_a_time_can_be_asked_for(self, make):
        rig = make()
        controller = rig.run("c")
        state = controller.query_state(rig.time_ns)
        assert [*state.positions, *state.velocities, *state.accelerations] == [0.0, 0.0, 0.0]
        # And a trajectory that begins with it has all its points, be they soon.
        points = [TrajectoryPoint(1, [0.5]), TrajectoryPoint(S, [1.5])]
        controller.set_command(Trajectory(["a"], points, rig.time_ns))
        at = controller.query_state(rig.time_ns + S // 2)
        assert (at.positions, at.velocities) == (pytest.approx([1.0]), pytest.approx([1.0]))
        with pytest.raises(ControllerError, match="precedes"):
            controller.query_state(rig.time_ns - S)
        rig.step(50)
        assert rig.hardware.handles["a"].position_command == pytest.approx(1.0) and not rig.log


def test_error_codes_are_those_of_control_msgs():
    messages = pytest.importorskip("control_msgs.msg")
    for code in ErrorCode:
        assert code.value == getattr(messages.FollowJointTrajectoryResult, code.name)
