"""Closed loop with an exact camera and lagging joints: convergence, diagnosis, restart."""

from dataclasses import replace

import loop_rig
import numpy as np
import pytest
from loop_rig import CAMERA, IMAGE_PERIOD, STARTS, TICK, Rig, the_arm, the_limits, the_servo

from aras_visual_servo_controller import ConfigurationError, Goal, JointSample, Task
from aras_visual_servo_controller.features.moments import ImageMoments
from aras_visual_servo_controller.kinematics import CommandLimits, DifferentialIK
from aras_visual_servo_controller.laws.proportional import Proportional
from aras_visual_servo_controller.loop.command_integrator import CommandIntegrator
from aras_visual_servo_controller.loop.start_approach import StartApproach
from aras_visual_servo_controller.loop.task_executor import TaskExecutor
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.records.state import JointCommand, ServoSettings, ServoState
from aras_visual_servo_controller.schemes import FeatureScheme, JointController


def speeds(rig):
    return np.diff([c.positions for c in rig.commands if c.positions is not None], axis=0) / TICK


def integrator(limits=None, names=None, **settings):
    """Return an integrator of the arm's commands, or of other joints', that starts at zero."""
    names = names or the_arm().names
    motion = CommandIntegrator(names, limits or the_limits(), ServoSettings(**settings))
    motion.start_at(np.zeros(len(names)))
    return motion


# Limits of two joints that only their acceleration bounds.
WIDE = CommandLimits(("a", "b"), *np.multiply.outer([-9.0, 9.0, 9.0, np.inf], np.ones(2)))


def test_errors_decay_as_the_gain_says(gain=5.0):
    """e(n+1) = e(n) - gain ((T - d) e(n) + d e(n-1)) with the period T and the mean delay d."""
    # The square with its patch, without the thickness that is no matter of the law's.
    x, y = np.array([[-25, -17.5, -17.5, 7.5, 7.5, 25, 25, -25],
                     [-25, -25, -37.5, -37.5, -25, -25, 25, 25]]) / 1000.0  # fmt: skip
    flat, arm, wanted = np.c_[x, y, np.full(8, 0.5905)], the_arm(), loop_rig.the_goal("2016")

    def look(observer, t, joints):
        pose = arm.pose(joints.positions)
        seen = (flat - pose[:3, 3]) @ pose[:3, :3]
        return observer.observe_exact_features(t, CAMERA, joints, contour=seen[:, :2] / seen[:, 2:])

    there = JointSample.from_values(0.0, arm.names, wanted.get_joints(arm.names))
    goal = Goal.teach(None, look(FeatureObserver(arm), 0.0, there), depth=wanted.depth)
    servo = the_servo(law=Proportional(gain), limits=the_limits(velocity=5.0), goal=goal)
    rig = Rig(servo, STARTS["2016"], lag=1e-4, look=look)
    errors = np.array([s.scheme_output.error for s in rig.run(1.5)])[:, [0, 1, 3]]
    part = np.abs(errors / errors[0])
    d = np.mean([10.0, 6.7, 3.3]) * 1e-3 - TICK + 0.5 * TICK
    z = np.roots([1.0, gain * (IMAGE_PERIOD - d) - 1.0, gain * d]).max()
    for error, used in zip(errors.T, ((part < 0.8) & (part > 0.02)).T, strict=True):
        stamps = np.flatnonzero(used) * IMAGE_PERIOD
        decay = -np.polyfit(stamps, np.log(np.abs(error[used])), 1)[0]
        assert decay == pytest.approx(-np.log(z) / IMAGE_PERIOD, rel=0.02)


# -- what interrupts it ------------------------------------------------------------------------
def test_a_lost_target_brings_the_arm_to_rest_and_the_loop_goes_on():
    rig = Rig(the_servo("2016"), STARTS["2016"])
    why = "the target touches the left border"
    rig.lose(0.3, 1.0, why, ("left",))
    states = rig.run(1.2)
    gone = [s for s in states if 0.3 <= s.stamp < 1.0]
    text = f"target lost at 0.30 s over the left border: {why}"
    assert {(s.phase, s.outcome, s.reason) for s in gone} == {("holding", "target_lost", text)}
    assert {c.reason for c in rig.commands if 0.31 <= c.stamp < 1.0} == {why}
    assert {s.scheme for s in states} == {"FeatureScheme"} and not any(s.fault for s in states)
    still = np.array([c.positions for c in rig.commands if 0.3 + 0.2 <= c.stamp < 1.0])
    np.testing.assert_array_equal(still, np.broadcast_to(still[0], still.shape))
    assert np.abs(speeds(rig)[29]).max() > 0.05  # it was moving
    assert (states[-1].phase, states[-1].outcome) == ("servoing", "running")


def test_without_joints_or_time_the_command_says_why():
    servo = the_servo("2016")
    rig = Rig(servo, STARTS["2016"])
    for told, stamp, reason in ((servo.update(np.nan), 0.0, "time is not finite"),
                                (servo.update(0.0), 0.0, "no joint states yet")):  # fmt: skip
        assert (told.stamp, told.positions, told.reason) == (stamp, None, reason)
    state = rig.servo.process_image(
        replace(rig.exact(rig.observer, 0.0, rig.sample(0.0)), joints=None))
    assert (state.phase, state.reason) == ("waiting", "no joint states yet")
    assert servo.update(0.01).positions is None
    rig.run(0.3)
    assert rig.states[-1].achieved_twist.any()
    assert ServoState(0.0, "waiting").achieved_twist.tolist() == [0.0] * 6
    command = servo.update(np.inf)
    assert (command.values, command.reason) == (None, "time is not finite")
    assert command.stamp == pytest.approx(rig.now, abs=1.1 * TICK)
    command = servo.update(rig.now + TICK, missing_reason="no word of J2")
    assert (command.reason, command.phase) == ("no word of J2", "holding")
    assert command.positions.shape == (6,)


def test_late_images_and_stamps_of_zero_change_nothing():
    rigs = [Rig(the_servo("2016"), STARTS["2016"]) for _ in range(2)]
    for rig in rigs:
        rig.run(0.4)
    now = rigs[0].states[-1].stamp
    for stamp in (now - 0.005, 0.0, now, np.nan):
        state = rigs[0].show(now, stamp=stamp)
        why = "is not finite" if np.isnan(stamp) else "it is not newer than the last image"
        assert "ignored" in state.reason and state.reason.endswith(why)
        assert state.phase == "servoing"
    for rig in rigs:
        rig.run(0.5)
    np.testing.assert_array_equal(rigs[0].joints, rigs[1].joints)
    # An image from before the clock went back is left over: a second ahead at most.
    assert rig.show(50.0).reason.endswith("its stamp is ahead of the joint states")
    rig.run(0.1)
    assert rig.servo.phase == "servoing"
    rig.servo.update(2.0, rig.sample(2.0))
    told = [rig.show(50.0, stamp=stamp).has_processed_image for stamp in (3.01, 3.0)]
    assert told == [False, True]


def test_stop_start_and_hold():
    rig = Rig(the_servo("2016"), STARTS["2016"])
    rig.run(0.3)
    rig.servo.stop("the operator")
    rig.servo.update(rig.now, missing_reason="no word of J2")
    assert (rig.servo.phase, rig.servo.outcome.kind) == ("stopped", "running")
    states = [s for s in rig.run(0.5) if s.stamp >= 0.3]
    assert {s.phase for s in states} == {"stopped"}
    assert (states[-1].outcome, rig.servo.outcome.reason) == ("stopped", "the operator")
    np.testing.assert_array_equal(speeds(rig)[-20:], 0.0)
    rig.servo.start()
    rig.run(0.3)
    assert rig.servo.phase == "servoing"
    rig.servo.hold("look at this")
    assert rig.servo.outcome.kind == "held"
    for word in ("a", "b"):  # nor do bad joints end it
        command = rig.servo.update(rig.now, missing_reason=word)
        assert (command.reason, rig.servo.phase) == (word, "holding")
        assert rig.servo.outcome.reason == "look at this"
    states = [s for s in rig.run(0.5) if s.stamp >= 1.1]
    assert {(s.phase, s.reason) for s in states} == {("holding", "look at this")}
    rig.servo.start()
    assert rig.run(0.2)[-1].outcome == "running" and rig.servo.phase == "servoing"
    rig.servo.hold("")
    assert (rig.run(0.1)[-1].reason, rig.servo.outcome.reason) == ("held", "held")


@pytest.mark.parametrize("value", [np.nan, 50.0])
def test_impossible_joints_are_refused_and_never_sent(value):
    rig = Rig(the_servo("2016"), STARTS["2016"])
    rig.believe = lambda t, q: np.where((np.arange(6) == 2) & (0.3 <= t < 0.6), value, q)
    states = rig.run(0.8)
    bad, held = ([each for each in some if 0.31 <= each.stamp < 0.6]
                 for some in (states, rig.commands))  # fmt: skip
    assert {s.phase for s in bad} == {"holding"} and held
    assert all(each.reason.startswith("the measured position ") and "speed" not in each.reason
               for each in (*bad, *held))  # fmt: skip
    commands = np.array([c.positions for c in rig.commands if c.positions is not None])
    assert np.abs(commands[:, :5]).max() < 1.0
    assert states[-1].phase == "servoing"


# -- limits ------------------------------------------------------------------------------------
def test_the_command_does_not_walk_away_from_a_joint_that_is_held(joint=3):
    rig = Rig(the_servo("2016"), STARTS["2016"])
    rig.friction = np.where(np.arange(6) == joint, 1e3, 0.0)
    last = rig.run(3.0)[-1]
    ahead = [abs(c.positions - q)[joint] for c, q in zip(rig.commands, rig.joints, strict=True)]
    assert max(ahead) < 0.05 + 0.1 * 2.0 + 2.0 * 0.15  # and coming to rest
    assert f"waiting for {rig.servo.arm.names[joint]}" in last.reason and last.phase == "servoing"
    np.testing.assert_array_equal(speeds(rig)[-100:], 0.0)


def test_the_arm_is_resolved_where_it_stands_and_not_where_it_was_sent():
    """Held by friction, joints stand elsewhere: the camera is where they are."""
    asked = []

    class Watched(DifferentialIK):
        def solve(self, q, *rest):
            asked.append(np.abs(rig.q - rig.servo.command).max())
            np.testing.assert_array_equal(q, rig.q)
            return super().solve(q, *rest)

    rig = Rig(the_servo("2016", ik=Watched), STARTS["2016"], friction=0.02)
    rig.run(0.5)
    assert len(asked) > 15 and max(asked) > 0.01


def test_commands_keep_to_their_limits_of_speed_and_acceleration():
    limits = the_limits(velocity=[0.1, 0.3, 0.3, 0.3, 0.3, 0.3], acceleration=2.0)
    rig = Rig(the_servo("2016", limits=limits), STARTS["2016"])
    rig.lose(0.6, 0.9)
    rig.run(2.0)
    speed = speeds(rig)
    assert (np.abs(speed) <= limits.velocity * (1 + 1e-9)).all()
    assert np.abs(speed).max() > 0.29
    assert (np.abs(np.diff(speed, axis=0)) <= limits.acceleration * TICK * (1 + 1e-6)).all()


def test_a_scheme_is_told_the_time_since_servoing_began(begin=40.0):
    told = []

    class Timed(FeatureScheme):
        def compute(self, observation, goal, t=0.0):
            told.append((observation.stamp - begin, t))
            return super().compute(observation, goal, t)

    rig = Rig(the_servo("2016", Timed(ImageMoments(), Proportional(5.0))), STARTS["2016"])
    rig.now = rig.next_tick = rig.next_image = begin
    rig.lose(begin + 0.28, begin + 0.88)
    rig.run(1.2)
    first = [(stamp, t) for stamp, t in told if stamp < 0.28]
    np.testing.assert_allclose(*np.transpose(first), atol=1e-9)
    back = [t for stamp, t in told if stamp > 0.88]  # it came to rest, and begins again
    assert back[:2] == pytest.approx([0.0, IMAGE_PERIOD], abs=1e-9)


def test_what_a_controller_of_joints_asks_is_slowed_as_a_whole_and_says_why():
    limits = the_limits(velocity=[1.0, 2.0, 2.0, 2.0, 2.0, 2.0], acceleration=[20.0] + [2.0] * 5)
    motion = integrator(limits)
    asked = np.array([2.0, 1.0, 0.1, 0.1, 0.1, 0.1])
    most = np.array([1.0, -0.25, 0.1, 0.1, 0.1, 0.1])  # 2 rad/s^2 for an eighth of a second
    speed, joint = "velocity scaled to 50 % (speed limit of gantry)", "at the acceleration limit of"
    for velocities, dt, part, words in (
        (asked, 0.0, 0.5, speed), (asked, 0.1, 0.2, f"{speed}; {joint} J1"),
        (0.05 * asked, 0.1, 1.0, ""), (most, 0.125, 1.0, ""), (most, 0.124, 0.992, f"{joint} J1"),
    ):  # fmt: skip
        found, told = motion.limit_velocities(velocities, dt)
        assert found == pytest.approx(part * velocities) and told.endswith(words)
        assert bool(told) == bool(words)


def test_a_joint_that_has_caught_up_is_waited_for_no_more():
    motion = integrator(lead=(1.0, 0.05, 1.0, 1.0, 1.0, 1.0), lag=0.0)
    asked = np.eye(6)[1]
    for _ in range(6):
        motion.integrate(asked, np.zeros(6), 0.01)
    assert motion.is_late.tolist() == [False, True, False, False, False, False]
    assert motion.integrate(asked, motion.command, 0.01) == "" and not motion.is_late.any()
    motion = integrator(WIDE, ("a", "b"), lead=0.05, lag=0.0)
    said = motion.integrate(np.array([0.1, -1.0]), np.array([0.0, 0.3]), 0.5)
    assert said == "waiting for b, which is 0.800 behind its command"
    # A first step longer than the lead is taken: a flying camera that was asked for more than
    # 5 rad/s from rest never set out.
    motion, measured, fast = integrator(lead=0.05), np.zeros(6), np.full(6, 6.0)
    for step in range(1, 4):
        assert motion.integrate(fast, measured, 0.01) == ""
        np.testing.assert_allclose(motion.command, 0.06 * step)
        measured = motion.command + 1e-6  # it follows at once, and is measured with an error
    for _ in range(60):  # and what does not follow is waited for all the same
        said = motion.integrate(fast, measured, 0.01)
    assert "waiting for" in said and motion.is_at_rest
    assert motion.integrate(fast, motion.command, 0.0) == "" and motion.is_at_rest


def test_what_is_off_by_just_what_counts_as_arrived_is_there():
    settings = ServoSettings(start=(0.5, -0.25), arrived=0.125, settle=0.25)
    approach = StartApproach(("a", "b"), np.ones(2), settings)
    begin = approach.compute_command
    begin(0.0, 0.0, np.zeros(2))
    begin(64.0, 0.0, np.array([0.625, -0.375]))
    assert approach.reason == "" and not approach.is_done
    begin(64.25, 0.25, np.array([0.625, -0.375]))
    assert approach.is_done
    approach.reset()
    begin(0.0, 0.0, np.zeros(2))
    for t, off in ((64.0, 0.125), (64.125, 0.126), (64.25, 0.0625), (64.375, 0.0625)):
        command = begin(t, 1.0, np.array([0.5, -0.25 - off]))
    assert not approach.is_done  # it stood there since 64.25 s
    before = begin(64.5, 1.0, np.array([0.5, -0.1875]))
    assert approach.is_done and before[1] < command[1]  # what is half as far off is pushed too
    begin(65.0, 0.0, np.array([0.625, -0.3751]))
    assert approach.reason == "waiting at the start pose for b (at -0.3751, desired -0.2500)"
    approach.reset()  # nor is it pushed any more
    begin(70.0, 0.0, np.zeros(2))
    assert begin(134.0, 0.0, np.array([0.625, -0.375])).tolist() == [0.5, -0.25]
    # 1.5 ways at three tenths of a speed, of which 1000 at most count; no less than 1 ms.
    for speed, half in ((2.0, 1.25), (np.inf, 0.0025), (1e9, 0.0025)):
        settings = ServoSettings(start=(0.0, 1.0))
        approach = StartApproach(("a", "b"), np.array([9.0, speed]), settings)
        approach.compute_command(4.0, 0.0, np.zeros(2))
        assert approach.compute_command(4.0 + half, 0.0, np.zeros(2))[1] == pytest.approx(0.5)
    approach = StartApproach(("a",), np.ones(1), ServoSettings(start=(0.5,), settle=0.25))
    for t, done in ((0.0, False), (9 / 8192, False), (9 / 8192 + 0.25, True)):
        approach.compute_command(t, 0.0, np.array([0.5]))
        assert approach.is_done is done


def test_a_joint_on_the_way_waits_where_it_hangs_and_velocities_are_those_of_the_way():
    start = STARTS["2016"]
    rig = Rig(servo := the_servo("2016", start=start, output="velocity"), np.zeros(6))
    q, asked = np.zeros(6), []
    for t in np.arange(0.0, 3.0, 0.01):
        q = q + 0.01 * servo.update(t, rig.sample(t)).values
        asked.append(servo.is_waiting_for_joints)
    assert not asked[0] and asked[-1] and servo.phase == "approaching"
    np.testing.assert_allclose(q, servo.command, atol=1e-12)
    near, moved = np.array(start) - 0.004, []  # there, and pushed on all the same
    for t in np.arange(3.0, 4.0, 0.01):
        moved.append(servo.update(t, rig.sample(t, near)).values.any())
        if not servo.is_approaching:
            break
    assert moved[0] and not moved[-1] and servo.phase == "waiting"


def test_what_sags_before_the_first_image_is_held_where_it_was():
    """The command stays where the joints stood first, and servoing goes on from there."""
    rig = Rig(the_servo("2016", law=Proportional(0.2)), STARTS["2016"])
    first = rig.servo.update(0.0, rig.sample(0.0))
    sagged = rig.sample(0.1, rig.q - 0.02 * np.eye(6)[0])
    rig.servo.update(0.1, sagged)
    rig.show(0.1, sagged)
    command = rig.servo.update(0.11, sagged)
    assert 0.0 < np.abs(command.positions - first.positions)[0] < 0.01


def test_a_task_is_taken_up_when_its_delay_is_over_and_not_before():
    pursuit = TaskExecutor("any", None, None, None, ServoSettings(delay=0.1))
    first, second, third = (Task.from_twist(np.full(6, float(k))) for k in (1, 2, 3))
    pursuit.set_task(first, None, 0.2, 0.2)  # 0.2 + 0.1 is a little more than 0.3
    pursuit.set_task(second, None, 0.25, 0.25)
    for t, task in ((0.3 - 5e-7, None), (0.3, first), (0.3499995, first), (0.4, second)):
        pursuit.activate_pending(t)
        assert pursuit.task is task
    pursuit.set_task(third, None, 0.5 + 1e-12, 0.5)  # what is only rounded to be later is over too
    pursuit.activate_pending(0.5 + 0.1)
    assert pursuit.task is third


def test_efforts_stay_within_those_of_each_joint():
    motion = integrator(WIDE, ("a", "b"), output="effort", stiffness=(100.0, 200.0),
                        damping=(4.0, 1.0))  # fmt: skip
    for way in (1.0, -1.0):
        motion.velocity = np.array([0.5, 0.0]) * way
        joints = JointSample.from_values(
            0.5, ("a", "b"), [0.05 * way, 0.3 * way], [0.25 * way, 0.0])
        sent = motion.make_command(0.5, joints, np.array([7.0, 30.0]), "why", "servoing")
        assert sent.values == pytest.approx([-4.0 * way, -30.0 * way]) and sent.positions is None
        assert (sent.kind, sent.reason, sent.phase) == ("effort", "why", "servoing")
    assert motion.make_command(0.5, None, np.ones(2), "", "waiting").values is None
    motion.reset()
    assert motion.make_command(0.5, joints, np.ones(2), "", "waiting").values is None
    with pytest.raises(ConfigurationError, match="stiffness is 0: set stiffness"):
        the_servo("2016", output="effort", damping=2.0)
    the_servo("2016", output="effort", stiffness=[0.0, 0.0, 5.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("output", ["velocity", "position"])
def test_joints_that_are_sent_velocities_go_on_from_where_they_came_to_rest(output):
    """A flying camera waited for ever at its own command, of which it never hears."""
    motion = integrator(lead=0.05, output=output, stop_time=0.05)
    measured = np.array([0.2, 0.0, -0.3, 0.0, 0.0, 0.0])
    asked = np.array([-1.0, 0.0, 1.0, 0.2, 0.0, 0.0])
    motion.velocity = 0.5 * asked
    said = [motion.integrate(asked, measured, 0.01) for _ in range(30)]
    assert "waiting for gantry" in said[0]
    if output == "position":
        assert "waiting for" in said[-1] and motion.is_at_rest
        return
    assert all("waiting for" in text for text in said[: said.index("")])
    motion.start_at(np.zeros(6))
    for _ in range(40):
        if not motion.integrate(asked, measured, 0.01):
            break
        assert not motion.is_at_rest or (motion.command == measured).all()
    np.testing.assert_allclose(motion.command, measured + 0.01 * asked)


@pytest.mark.parametrize(("side", "sign"), [("upper", 1.0), ("lower", -1.0)])
def test_the_command_stops_at_its_limits_by_itself(side, sign):
    """Whatever the resolver answers; from beyond one a joint comes back, and does not jump."""
    motion = integrator(the_limits(**{side: {"J1": sign * 0.1}}), lead=10.0, stop_time=0.1)
    for _ in range(30):
        said = motion.integrate(np.full(6, sign * 0.5), np.zeros(6), 0.01)
    assert motion.command[[1, 5]] == pytest.approx([sign * 0.1, sign * 0.15])
    assert said == f"J1 stopped at its limit of {sign * 0.1:.4f}"
    for _ in range(2):  # it brakes as gently the second time, also where the way to the start moves
        motion.velocity = np.full(6, sign * 0.5)
        motion.brake(0.01)
        assert motion.velocity[[0, 2, 3, 4, 5]] == pytest.approx(np.full(5, sign * 0.45))
        for _ in range(12):
            motion.brake(0.01)
        assert motion.is_at_rest and motion.command[1] == pytest.approx(sign * 0.1)
    beyond = np.full(6, sign * 0.2)
    motion.start_at(beyond)
    for way, place in ((0.5, 0.2), (-0.5, 0.195)):
        motion.integrate(np.full(6, sign * way), beyond, 0.01)
        assert motion.command[1] == pytest.approx(sign * place)


# -- the way to the start ----------------------------------------------------------------------
@pytest.mark.parametrize("begin", [0.0, 12.0])
def test_the_start_is_reached_smoothly_before_the_eyes_open(begin):
    rig = Rig(the_servo("2016", start=STARTS["2016"]), np.zeros(6))
    rig.now = rig.next_tick = rig.next_image = begin
    states = rig.run(3.0)
    on_the_way = [s for s in states if s.phase == "approaching"]
    assert len(on_the_way) > 15 and all(s.scheme_output is None for s in on_the_way)
    opened = next(s for s in states if s.phase == "servoing")
    np.testing.assert_allclose(opened.joints.positions, STARTS["2016"], atol=5e-3)
    first = int((opened.stamp - begin) / TICK) - 2
    limit = 0.3 * rig.servo.differential_ik.limits.velocity
    assert (np.abs(speeds(rig)[:first]) <= limit * 1.01).all()
    # nor is what hangs there pushed any faster
    rig = Rig(the_servo("2016", start=STARTS["2016"], lead=0.5, push=50.0), np.zeros(6))
    rig.commands = [rig.servo.update(t, rig.sample(t)) for t in begin + np.arange(0.0, 4.0, TICK)]
    assert (np.abs(speeds(rig)) <= limit * 1.01).all()


@pytest.mark.parametrize("acceleration", [0.5, np.array([0.2, 1.0, 0.3, 1.0, 1.0, 1.0])])
def test_the_way_to_the_start_keeps_to_the_limit_of_acceleration(acceleration):
    limits = the_limits(acceleration=acceleration)
    rig = Rig(the_servo("2016", start=STARTS["2016"], limits=limits), np.zeros(6))
    rig.run(6.0)
    assert not rig.servo.is_approaching
    sent = np.diff(np.array([c.positions for c in rig.commands if c.phase == "approaching"]), 2, 0)
    reached = np.abs(sent / TICK**2).max(axis=0) / limits.acceleration
    assert 0.8 < reached.max() < 1.05


def test_the_joint_that_does_not_arrive_at_the_start_is_named():
    start, off = np.array(STARTS["2016"]), np.array([0.1, -0.3, 0.006, 0.0027, 0.0023, 0.0])
    rig = Rig(servo := the_servo("2016", start=STARTS["2016"]), start + off)
    for t in np.arange(0.0, 4.0, 0.01):
        command = servo.update(t, rig.sample(t))
    assert command.reason == (
        "waiting at the start pose for gantry (at 0.0000, desired -0.1000), "
        "J1 (at -0.3000, desired 0.0000), J2 (at 0.3551, desired 0.3491)")
    # Pushed by what it may be ahead at most, unless it is within half of what counts as there.
    pushed = command.positions - start
    assert pushed == pytest.approx([-0.05, 0.05, *pushed[2:4], 0.0, 0.0], abs=1e-12)
    assert (pushed[2:4] < -0.01).all() and (pushed[2:4] >= -0.05).all()
    assert servo.is_approaching
    assert servo.update(4.0, rig.sample(4.0, start)).reason == ""
    assert servo.is_approaching  # until it has settled


# -- what it is told and tells ------------------------------------------------------------------
def test_an_image_without_joints_meets_the_latest():
    rig = Rig(the_servo("2016"), STARTS["2016"])
    rig.servo.update(0.5, joints := rig.sample(0.5))
    state = rig.show(0.5, joints, joints=None)
    assert state.phase == "servoing" and state.joints is joints and rig.servo.state is state
    np.testing.assert_array_equal(state.command, rig.q)
    rig.servo.command[:] = 9.0
    np.testing.assert_array_equal(rig.servo.command, rig.q)
    # A start while it servoes forgets the task.
    rig.run(0.3)
    assert rig.servo.executor.task is not None and rig.servo.is_only_executing
    rig.servo.start()
    assert rig.servo.executor.task is None and rig.servo.phase == "servoing"
    before = np.abs(rig.servo.integrator.velocity).max()
    rig.servo.update(rig.now, rig.sample(rig.now))
    assert 0.0 < np.abs(rig.servo.integrator.velocity).max() < before


class Failing(DifferentialIK):
    error = velocities = None

    def solve(self, *given):
        if self.error is not None:
            raise self.error
        solution = super().solve(*given)
        return solution if self.velocities is None else replace(
            solution, velocities=self.velocities)


def test_velocities_that_fail_between_images_hold_the_arm_at_once():
    rig = Rig(the_servo("2016", ik=Failing), STARTS["2016"])
    rig.run(0.3)
    ik = rig.servo.differential_ik
    for error in (ValueError("no"), ZeroDivisionError("by zero"), np.linalg.LinAlgError("none")):
        ik.error = error
        command = rig.servo.update(rig.now + 0.02, rig.sample(rig.now + 0.02))
        assert (command.phase, command.reason) == ("holding", str(error))
        assert rig.servo.integrator.command is not None and rig.servo.executor.task is None
        ik.error = None
        rig.run(0.3)
        assert rig.servo.phase == "servoing"
    ik.velocities = np.array([0.1, 0.0, np.nan, 0.0, 0.0, 0.0])
    rig.run(0.2)
    assert rig.servo.phase == "holding"
    assert rig.servo.reason == "the joint velocities are not finite"
    assert all(np.isfinite(command.positions).all() for command in rig.commands)


@pytest.mark.parametrize(("seconds", "slow"), [(0.25, False), (0.2501, True)])
def test_a_scheme_may_take_a_whole_image_period(seconds, slow):
    clock = iter(np.arange(99.0) * seconds)
    rig = Rig(the_servo("2016", clock=lambda: float(next(clock))), STARTS["2016"])
    rig.answer(1.0)
    state = rig.answer(1.25)
    assert state.computation_time == pytest.approx(seconds)
    text = f"took {seconds:.3f} s, longer than the image period of 0.250 s"
    assert (text in state.reason) is slow
    rig.servo.stop("enough")
    assert rig.show(1.5).computation_time == 0.0


@pytest.mark.parametrize(("stamps", "patience"), [((1.0,), 0.25), ((0.5, 1.0), 1.5)])
def test_the_watchdog_waits_for_its_time_or_three_image_periods(stamps, patience):
    rig = Rig(the_servo("2016", watchdog=0.25, longest_step=9.0), STARTS["2016"])
    for stamp in stamps:
        rig.answer(stamp)
    for passed in (0.0, patience, patience + 1 / 64):
        rig.servo.update(1.0625 + passed, rig.sample(1.0625 + passed))
        assert rig.servo.phase == ("servoing" if passed <= patience else "waiting")


@pytest.mark.parametrize(("output", "moving", "at_once"), [
    ("position", [1.0, -2.0], [0.0, 0.0]), ("acceleration", [1.03125, 2.9375], [1.0, 3.0]),
])  # fmt: skip
def test_what_a_controller_of_joints_answers_is_taken_as_it_is(output, moving, at_once):
    class Controller(JointController):
        def process_image(self, observation, goal, t):
            raise AssertionError("no image is processed")

        def update(self, t, dt, joints):
            return np.array([0.25, -0.5])

    scheme = Controller()
    scheme.output = output
    motion = integrator(WIDE, ("a", "b"))
    motion.start_at(np.array([0.125, -0.25]))
    motion.velocity = np.array([1.0, 3.0])
    pursuit = TaskExecutor("any", scheme, None, motion, ServoSettings())
    pursuit.set_task(None, None, 0.0, 0.0)
    joints = JointSample.from_values(0.5, ("a", "b"), np.zeros(2))
    for dt, expected in ((0.125, moving), (0.0, at_once)):
        found, words = pursuit.compute_velocities(0.5, dt, joints, 0.0)
        assert found.tolist() == expected and words == ""


def test_settings_of_another_arm_are_refused():
    for name, value, words in (
        *((key, (0.5, 0.25), "one number, or a number for")
          for key in ("arrived", "lead", "stiffness", "damping")),
        ("start", (0.5, 0.25), "a number for each of gan"), ("start", 0.5, "a number for each of"),
        ("start", (0.0, 0.0, 0.0, 2.5, 0.0, 0.0), "J3.*limits"),
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match=f"{name}.*{words}"):
            the_servo("2016", **{name: value})


def test_a_state_that_was_read_back_tells_what_its_resolution_does():
    resolution = replace(
        loop_rig.a_solution(np.eye(6)), desired_twist=np.arange(6.0),
        achieved_twist=np.arange(6.0) / 2.0,
        recorded_singular_values=(np.array([3.0, 0.5]), np.array([1.0])))
    state = ServoState(0.5, "servoing", ik_solution=resolution)
    assert state.desired_twist is resolution.desired_twist
    assert state.achieved_twist is resolution.achieved_twist
    assert state.singular_values_L is resolution.singular_values_L and state.rank == 2
    bare = ServoState(0.5, "waiting")
    assert bare.singular_values_L.shape == (0,) and bare.rank == 0
    assert bare.desired_twist.tolist() == [0.0] * 6 and bare.names == () and bare.error is None
    assert (bare.outcome, bare.computation_time) == ("running", 0.0)
    assert not bare.has_processed_image
    sent = JointCommand(0.5, ("a",), np.ones(1))
    assert sent.positions is sent.values and (sent.reason, sent.phase) == ("", "")
