"""JointTrajectoryController: timing, splicing, preemption, tolerances, stopping, bad goals.

Steps of 10 ms; a command takes effect in the cycle after it is given, which is its time 0.
"""

from math import nan, pi

import pytest

from aras_sim_bridge.control.controllers.trajectory_types import (
    ErrorCode,
    InvalidTrajectoryError,
    JointTolerance,
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
)
from aras_sim_bridge.errors import ControllerError

S = 1_000_000_000
STEP = 10_000_000
INTERFACES = {"position": "PositionJointInterface", "effort": "EffortJointInterface",
              "velocity": "VelocityJointInterface"}


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
        """Step on; returns q() at that time of a command just given."""
        self.rig.step(round(seconds * 100))
        return self.q()


@pytest.fixture
def make(make_rig, make_joint):
    def _make(kind="position", names="a", joint_kind="revolute", start=None, **parameters):
        parameters = {
            "c": {"type": f"{kind}_controllers/JointTrajectoryController", "joints": list(names),
                  **parameters}
        }
        joints = [
            make_joint(name, joint_kind, INTERFACES[kind], "none") for name in sorted(names)
        ]
        rig = make_rig(joints, parameters, STEP, physics=kind != "position")
        if start is not None:
            rig.model.q[:] = start
        return rig

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
        (([0.0], [0.0]), 10 * 0.25**3 - 15 * 0.25**4 + 6 * 0.25**5),
    ])
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

    def test_all_of_the_present_one_is_done_until_then(self, bench):
        b = bench()
        points = [point(0.2, [0.2]), point(0.4, [0.6]), point(1.0, [1.2])]
        b.controller.set_command(Trajectory(["a"], points))
        b.rig.step(1)
        b.controller.set_command(line(0.0, 0.5, stamp_ns=b.rig.time_ns + 7 * S // 10))
        assert [b.after(0.1) for _ in range(8)] == pytest.approx(
            [0.1, 0.2, 0.4, 0.6, 0.7, 0.8, 0.9, 0.72])

    def test_a_stamp_in_the_past_drops_points_and_bridges_to_the_next(self, bench):
        b = bench()
        points = [point(0.1, [9.0]), point(0.2, [8.0]), point(1.02, [1.0]), point(2.02, [2.0])]
        b.controller.set_command(Trajectory(["a"], points, b.rig.time_ns - S // 2))
        assert any("2 of 4" in text for text in b.rig.log)
        # Next cycle is 0.51 into it; the bridge reaches 1.0 another 0.51 later.
        states = []
        b.controller.on_state = states.append
        assert b.after(0.01) == pytest.approx(0.0)
        assert b.after(0.255 + 0.005) == pytest.approx(0.26 / 0.51)
        assert states[-1].desired.time_from_start == pytest.approx(0.51)
        assert b.after(0.25) == pytest.approx(1.0)
        assert b.after(0.5) == pytest.approx(1.5)

    def test_a_first_point_at_zero_is_dropped_silently(self, bench):
        b = bench(start=[0.4])
        b.rig.log.clear()
        b.controller.set_command(Trajectory(["a"], [point(0.0, [9.0]), point(1.0, [1.4])]))
        assert not b.rig.log
        assert b.after(0.51) == pytest.approx(0.9)
        points = [point(0.0, [9.0]), point(1.0, [1.4])]
        b.controller.set_command(Trajectory(["a"], points, b.rig.time_ns - STEP))  # as it was meant
        assert "1 of 2 trajectory points are in the past" in b.rig.log[0]

    def test_all_points_past_are_refused_and_the_present_one_goes_on(self, bench):
        b = bench()
        b.controller.set_command(line())
        b.rig.step(1)
        with pytest.raises(InvalidTrajectoryError, match="all 1 trajectory points are in the past"):
            b.controller.set_command(line(9.0, 0.1, stamp_ns=b.rig.time_ns - S // 5))
        assert b.after(0.5) == pytest.approx(0.5)

    def test_no_points_stop_at_the_measured_position(self, bench):
        b = bench()
        b.controller.set_command(line())
        b.rig.step(51)
        b.controller.set_command(Trajectory(["a"], []))
        # Measured is what the previous cycle commanded.
        assert b.after(1.0) == pytest.approx(0.49)

    def test_continuous_joints_take_the_short_way_with_all_points_shifted(self, bench):
        b = bench(joint_kind="continuous", start=[3.0])
        b.controller.set_command(Trajectory(["a"], [point(1.0, [-3.0]), point(2.0, [-2.0])]))
        b.after(1.01)
        assert b.q() == pytest.approx(2 * pi - 3.0)
        assert b.after(1.0) == pytest.approx(2 * pi - 2.0)

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

    def test_revolute_joints_do_not_wrap(self, bench):
        b = bench(start=[3.0])
        b.controller.set_command(line(-3.0, 1.0))
        assert b.after(0.51) == pytest.approx(0.0, abs=1e-12)

    def test_a_clock_set_back_does_not_lose_the_trajectory(self, bench):
        b = bench()
        b.controller.set_command(line())
        b.rig.step(51)
        b.rig.time_ns = 0
        b.rig.loop.reset()
        assert b.after(0.25) == pytest.approx(0.75)


class TestPartial:
    def test_missing_joints_are_refused_unless_allowed(self, bench):
        b = bench(names="ab")
        with pytest.raises(InvalidTrajectoryError, match="allow_partial") as caught:
            b.controller.set_command(line())
        assert caught.value.code == ErrorCode.INVALID_JOINTS

    def test_the_others_follow_on_and_the_goal_waits_for_them(self, bench):
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
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        done = []
        handle.on_done = done.append
        b.rig.step(101)
        assert handle.status == "active" and not done
        b.rig.step(1)
        assert (handle.status, handle.result.error_code) == ("succeeded", ErrorCode.SUCCESSFUL)
        b.rig.step(10)
        assert done == [handle]

    def test_a_goal_after_another_has_its_own_way_to_go(self, bench):
        b = bench()
        for end in (1.0, 1.5):
            handle = b.controller.submit_goal(TrajectoryGoal(line(end)))
            b.rig.step(101)
            assert handle.status == "active"
            b.rig.step(1)
            assert handle.status == "succeeded"

    def test_path_tolerance_aborts_and_says_by_how_much(self, bench):
        b = bench(constraints={"a": {"trajectory": 0.105}})
        b.rig.model.stuck.add("a")
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(11)
        assert handle.status == "active"
        b.rig.step(1)
        assert handle.status == "aborted"
        assert handle.result.error_code == ErrorCode.PATH_TOLERANCE_VIOLATED
        assert handle.result.error_string == "a path error 0.110000"

    def test_goal_tolerance_is_checked_at_once_without_goal_time(self, bench):
        b = bench(constraints={"a": {"goal": 0.05}})
        b.rig.model.stuck.add("a")
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(101)
        assert handle.status == "active"
        b.rig.step(1)
        assert handle.result.error_code == ErrorCode.GOAL_TOLERANCE_VIOLATED
        assert handle.result.error_string == "a goal error 1.000000"

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

    def test_stopped_velocity_tolerance_must_hold_at_the_goal(self, bench):
        b = bench()
        b.rig.model.v[0] = 0.02
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(102)
        assert handle.result.error_code == ErrorCode.GOAL_TOLERANCE_VIOLATED
        b = bench(constraints={"stopped_velocity_tolerance": 0.0})
        b.rig.model.v[0] = 0.02
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(102)
        assert handle.status == "succeeded"

    @pytest.mark.parametrize(
        ("proves", "path", "at_goal", "time", "status"),
        [
            ("above 0 overrides", [JointTolerance("a", 5.0)], [JointTolerance("a", 5.0)], 0.0,
             "succeeded"),
            ("below 0 removes", [JointTolerance("a", -1.0)], [JointTolerance("a", -1.0)], 0.0,
             "succeeded"),
            ("0 keeps the default", [JointTolerance("a", 0.0)], [JointTolerance("a", -1.0)], 0.0,
             "aborted"),
            ("at the goal too", [JointTolerance("a", -1.0)], [JointTolerance("a", 0.0)], 0.0,
             "aborted"),
            ("goal time above 0 waits", [JointTolerance("a", -1.0)], [], 9.0, "active"),
            ("goal time below 0 does not", [JointTolerance("a", -1.0)], [], -1.0, "aborted"),
        ],
    )
    def test_tolerances_of_the_goal(self, bench, proves, path, at_goal, time, status):
        b = bench(constraints={"a": {"trajectory": 0.1, "goal": 0.1}})
        b.rig.model.stuck.add("a")
        handle = b.controller.submit_goal(TrajectoryGoal(line(), path, at_goal, time))
        b.rig.step(110)
        assert handle.status == status, proves

    def test_tolerances_do_not_matter_to_topic_commands(self, bench):
        b = bench(constraints={"a": {"trajectory": 0.1, "goal": 0.1}})
        b.rig.model.stuck.add("a")
        b.controller.set_command(line())
        assert b.after(2.0) == pytest.approx(1.0)

    def test_a_new_goal_and_a_topic_command_preempt(self, bench):
        b = bench()
        first = b.controller.submit_goal(TrajectoryGoal(line()))
        told = []
        first.on_done = told.append
        b.rig.step(51)
        second = b.controller.submit_goal(TrajectoryGoal(line(0.0, 0.5)))
        assert (first.status, second.status, told) == ("preempted", "active", [first])
        assert (first.result.error_code, first.result.error_string) == (
            ErrorCode.SUCCESSFUL, "preempted by a new goal")
        assert b.after(0.26) == pytest.approx(0.51 / 2, abs=0.01)
        b.controller.set_command(line(2.0, 1.0))
        assert second.status == "preempted"
        assert b.after(1.01) == pytest.approx(2.0)

    def test_a_refused_goal_does_not_disturb_the_active_one(self, bench):
        b = bench()
        first = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(1)
        second = b.controller.submit_goal(TrajectoryGoal(line(joint="z")))
        assert second.status == "rejected"
        assert second.result.error_code == ErrorCode.INVALID_JOINTS
        assert first.status == "active"
        assert b.after(0.5) == pytest.approx(0.5)

    def test_cancel_holds(self, bench):
        b = bench()
        handle = b.controller.submit_goal(TrajectoryGoal(line()))
        b.rig.step(51)
        told = []
        handle.on_done = told.append
        assert b.controller.cancel_goal(handle)
        assert (handle.status, told) == ("preempted", [handle])
        assert handle.result.error_code == ErrorCode.SUCCESSFUL
        assert handle.result.error_string == "cancelled"
        assert b.after(1.0) == pytest.approx(0.49)
        assert not b.controller.cancel_goal(handle)

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
            with pytest.raises(ControllerError, match="not running"):
                controller.set_command(line())
            with pytest.raises(ControllerError, match="not running"):
                controller.query_state(b.rig.time_ns)

    def test_a_goal_without_points_succeeds_where_it_is(self, bench):
        b = bench(start=[0.3])
        handle = b.controller.submit_goal(TrajectoryGoal(Trajectory(["a"], [])))
        b.rig.step(2)
        assert handle.status == "succeeded"
        assert b.q() == 0.3

    @pytest.mark.parametrize(
        ("trajectory", "code", "text"),
        [
            (Trajectory(["a", "a"], [point(1, [1, 1])]), ErrorCode.INVALID_JOINTS, "repeated"),
            (Trajectory([], [point(1, [])]), ErrorCode.INVALID_JOINTS, "empty"),
            (Trajectory(["a", "b"], []), ErrorCode.INVALID_JOINTS, "unknown are 'b'"),
            (Trajectory([], []), ErrorCode.INVALID_JOINTS, "empty"),
            (Trajectory(["a"], [point(1, [])]), ErrorCode.INVALID_GOAL, "0 positions for 1"),
            (Trajectory(["a"], [point(1, [1, 2], [1])]), ErrorCode.INVALID_GOAL, "1 velocities"),
            (Trajectory(["a"], [point(1, [1], [1, 2])]), ErrorCode.INVALID_GOAL, "2 velocities"),
            (Trajectory(["a"], [point(1, [nan])]), ErrorCode.INVALID_GOAL, "not finite"),
            (Trajectory(["a"], [point(1, [1], [nan])]), ErrorCode.INVALID_GOAL, "not finite"),
            (Trajectory(["a"], [point(1, [1]), point(1, [2])]), ErrorCode.INVALID_GOAL,
             "strictly increase"),
            (Trajectory(["a"], [point(0, [1])]), ErrorCode.INVALID_GOAL, "past"),
        ],
    )
    def test_bad_goals_are_rejected_with_the_reason(self, bench, trajectory, code, text):
        handle = bench().controller.submit_goal(TrajectoryGoal(trajectory))
        assert (handle.status, handle.result.error_code) == ("rejected", code)
        assert text in handle.result.error_string

    def test_tolerance_for_an_unknown_joint_or_nan_is_rejected(self, bench):
        b = bench()
        for bad in (JointTolerance("z", 1.0), JointTolerance("a", nan)):
            assert b.controller.submit_goal(TrajectoryGoal(line(), [bad])).status == "rejected"
        assert b.controller.submit_goal(TrajectoryGoal(line(), (), (), nan)).status == "rejected"

    def test_an_empty_goal_checks_the_tolerance_that_it_brings(self, bench):
        """It holds where it is; a joint pushed away from there does not succeed."""
        b = bench("effort", gains={"a": {"p": 0.0}}, stop_trajectory_duration=0.5)
        tight = (JointTolerance("a", position=0.01),)
        handle = b.controller.submit_goal(TrajectoryGoal(Trajectory(["a"], []), (), tight))
        b.rig.model.v[0] = 1.0
        b.rig.step(60)
        assert handle.status == "aborted"
        assert handle.result.error_code == ErrorCode.GOAL_TOLERANCE_VIOLATED

    def test_a_listener_may_call_back_into_the_controller(self, bench):
        b = bench()
        handle = b.controller.submit_goal(TrajectoryGoal(line(0.1, 0.1)))
        handle.on_done = lambda _: b.controller.set_command(line(0.5, 0.1))
        assert b.after(1.0) == pytest.approx(0.5)


class TestStopping:
    def test_stop_trajectory_duration_brakes_to_rest(self, bench):
        b = bench(stop_trajectory_duration=0.5)
        b.controller.set_command(line(2.0, 1.0))
        b.rig.step(50)
        begin = b.q()  # moving at 2 a second
        b.controller.set_command(Trajectory(["a"], []))
        positions = [b.after(0.01) for _ in range(80)]
        steps = [later - earlier for earlier, later in zip(positions, positions[1:], strict=False)]
        assert positions[0] == pytest.approx(begin + 0.02, abs=1e-3)
        assert positions[-1] == positions[55]
        assert steps[49:] == pytest.approx([0.0] * len(steps[49:]), abs=1e-3)
        # v t - v t³/(2 T²) + v t⁴/(8 T³), the symmetric quintic, is 5/8 v T at T.
        assert positions[-1] - begin == pytest.approx(0.625 * 2.0 * 0.5)

    def test_who_is_started_while_it_runs_holds_at_once(self, bench):
        b = bench(stop_trajectory_duration=0.5)
        b.controller.set_command(line(2.0, 1.0))
        b.rig.step(50)
        b.rig.manager.switch(["c"], [], 1)
        b.rig.step(2)
        held = b.q()
        assert b.after(0.5) == held == pytest.approx(0.98)


class TestOutputsAndState:

    @pytest.mark.parametrize(("forward", "effort"), [({"a": 3.0}, 63.0), ({}, 60.0)])
    def test_effort_is_feed_forward_and_pid_on_both_errors(self, bench, forward, effort):
        b = bench("effort", gains={"a": {"p": 100.0, "d": 10.0}}, velocity_ff=forward)
        b.rig.model.stuck.add("a")
        b.controller.set_command(line())
        b.rig.step(51)
        # desired 0.5 at velocity 1 against rest: 3 · 1 + 100 · 0.5 + 10 · 1
        assert b.rig.model.tau[0] == pytest.approx(effort)
        assert set(b.controller.pids) == {"gains/a"}

    def test_velocity_variant_commands_velocities(self, bench):
        b = bench("velocity", gains={"a": {"p": 2.0}}, velocity_ff={"a": 1.0})
        b.rig.model.stuck.add("a")
        b.controller.set_command(line())
        b.rig.step(51)
        assert b.rig.hardware.handles["a"].velocity_command == pytest.approx(1.0 + 2.0 * 0.5)

    def test_state_at_fifty_hertz_with_errors_as_angles(self, bench):
        b = bench()
        b.rig.model.stuck.add("a")
        b.rig.model.q[0] = 0.25
        states = []
        b.controller.on_state = states.append
        b.controller.set_command(Trajectory(["a"], [point(1.0, [1.0]), point(2.0, [2.0])]))
        b.rig.step(151)
        gaps = {b.stamp_ns - a.stamp_ns for a, b in zip(states, states[1:], strict=False)}
        assert gaps == {20_000_000}
        state = states[-1]
        assert state.joint_names == ("a",)
        assert state.desired.positions[0] == pytest.approx(1.5, abs=0.011)
        assert state.desired.velocities == [1.0]
        assert (state.actual.positions, state.actual.velocities) == ([0.25], [0.0])
        assert state.desired.time_from_start == 1.0
        assert state.actual.time_from_start == pytest.approx(1.5, abs=0.011)
        assert state.error.time_from_start == pytest.approx(0.5, abs=0.011)
        assert state.error.positions[0] == pytest.approx(state.desired.positions[0] - 0.25)
        assert state.error.velocities == [1.0]
        b.controller.set_command(line(4.25, 0.1))
        b.rig.step(50)
        assert states[-1].error.positions[0] == pytest.approx(4.0 - 2 * pi)

    def test_a_goal_s_feedback_has_a_rhythm_of_its_own(self, bench):
        """At 20 a second: 50 ms after the cycle that takes it, whatever went before."""
        b = bench()
        for pause in (2, 3):
            times = []
            handle = b.controller.submit_goal(TrajectoryGoal(line()))
            handle.on_feedback = lambda state, times=times: times.append(state.stamp_ns)
            begin = b.rig.time_ns
            b.rig.step(10 + pause)
            assert [(time - begin) // 10_000_000 for time in times] == [6, 11]

    def test_the_state_of_the_start_can_be_asked_for(self, make):
        rig = make()
        controller = rig.run("c")
        state = controller.query_state(rig.time_ns)
        assert [*state.positions, *state.velocities, *state.accelerations] == [0.0, 0.0, 0.0]
        # And a trajectory that begins with it has all its points, be they soon.
        points = [TrajectoryPoint(1, [0.5]), TrajectoryPoint(S, [1.5])]
        controller.set_command(Trajectory(["a"], points, rig.time_ns))
        rig.step(50)
        assert rig.hardware.handles["a"].position_command == pytest.approx(1.0) and not rig.log

    def test_rates_of_zero_tell_nothing(self, bench):
        b, seen = bench(state_publish_rate=0.0, action_monitor_rate=0.0), []
        b.controller.on_state = seen.append
        b.controller.submit_goal(TrajectoryGoal(line())).on_feedback = seen.append
        b.rig.step(101)
        assert not seen

    def test_query_state_at_an_absolute_time(self, bench):
        b = bench()
        b.controller.set_command(line(1.0, 1.0))
        at = b.controller.query_state(b.rig.time_ns + STEP + S // 2)
        assert (at.positions, at.velocities) == ([0.5], [1.0])
        with pytest.raises(ControllerError, match="precedes"):
            b.controller.query_state(b.rig.time_ns - S)

    @pytest.mark.parametrize(
        ("kind", "change", "text"),
        [
            ("position", {"joints": []}, "non-empty list"),
            ("position", {"joints": ["z"]}, "joint 'z' does not have"),
            ("position", {"constraints": {"a": {"goal": "near"}}}, "constraints/a/goal"),
            ("position", {"stop_trajectory_duration": -1.0}, "negative"),
            ("effort", {}, "/robot/c/gains/a/p"),
            ("effort", {"gains": {"a": {"p": 1.0}}, "velocity_ff": {"a": True}}, "velocity_ff/a"),
        ],
    )
    def test_bad_parameters_are_named(self, make, kind, change, text):
        with pytest.raises(ControllerError, match=text):
            make(kind, **change).manager.load("c")


def test_error_codes_are_those_of_control_msgs():
    """FollowJointTrajectoryResult.msg."""
    assert {code.name: code.value for code in ErrorCode} == {
        "SUCCESSFUL": 0, "INVALID_GOAL": -1, "INVALID_JOINTS": -2, "OLD_HEADER_TIMESTAMP": -3,
        "PATH_TOLERANCE_VIOLATED": -4, "GOAL_TOLERANCE_VIOLATED": -5,
    }  # fmt: skip
