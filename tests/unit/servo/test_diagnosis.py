"""Provoked failures get the correct outcome, and normal runs get none."""

from dataclasses import replace

import loop_rig
import numpy as np
import pytest
from loop_rig import CAMERA, STARTS, Rig, an_image, lost, the_arm, the_goal, the_limits, the_servo
from test_target_check import STEADY, watched

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_controller import Goal, MeasurementError, Moments
from aras_visual_servo_controller.diagnosis.base import DIAGNOSES, ORDER, DiagnosisRule
from aras_visual_servo_controller.diagnosis.camera_model_check import CameraModelCheck
from aras_visual_servo_controller.diagnosis.diagnoses.contradictions import is_goal_camera
from aras_visual_servo_controller.diagnosis.diagnoses.target_moves import split_by_camera
from aras_visual_servo_controller.diagnosis.diagnosis import Diagnosis, diagnose
from aras_visual_servo_controller.diagnosis.evidence import Evidence
from aras_visual_servo_controller.diagnosis.feature_rows import FeatureHistory
from aras_visual_servo_controller.diagnosis.target_motion_check import TargetMotionCheck
from aras_visual_servo_controller.features import Feature, FeatureMeasurement, Stack
from aras_visual_servo_controller.laws import Proportional
from aras_visual_servo_controller.records import outcomes
from aras_visual_servo_controller.records.remedy import SettingChange
from aras_visual_servo_controller.records.run_record import ImageRecord, RunContext, RunEvent
from aras_visual_servo_controller.records.state import CONVERGED, ServoSettings, ServoState
from aras_visual_servo_controller.schemes import FeatureScheme


def near(seed, size=0.3):
    """A start some way off the goal, other for each seed, with the target in view."""
    random = np.random.default_rng(seed)
    goal = np.array(the_goal("2016").get_joints(the_arm().names))
    while True:
        off = np.array([0.1, 0.1, 0.25, -0.3, 0.05, 1.0]) * random.uniform(0.3, 1.0, 6)
        signs = np.array([*random.choice([-1, 1], 2), 1, 1, 1, random.choice([-1, 1])])
        start = goal + off * signs * size / 0.3
        if in_view(the_goal("2016").target.compute_outline(the_arm().pose(start))):
            return start


def in_view(outline):
    u, v = CAMERA.project(*np.asarray(outline).T)
    return (u > 1).all() and (u < 318).all() and (v > 1).all() and (v < 238).all()


def with_borders(rig):
    def look(*given):
        seen = rig.exact(*given)
        return seen if in_view(seen.contour) else lost(seen, "it touches a border", ("top",))

    rig.look = look
    return rig


def outcome_after(rig, seconds):
    rig.run(seconds)
    return rig.servo.outcome


def noisy(rig):
    random, plain = np.random.default_rng(1), rig.look

    def look(observer, t, joints):
        seen = plain(observer, t, joints)
        m = seen.moments
        second = np.add.outer(*(np.arange(7),) * 2) == 2
        shaken = m.centred + 2e-3 * random.normal(size=(7, 7)) * m.mu(2, 0) * second
        place = (
            m.m00 * (1.0 + 5e-3 * random.normal()),
            *(g + 1e-3 * random.normal() for g in (m.xg, m.yg)))
        return replace(seen, moments=Moments(m.order, m.kind, *place, shaken))

    rig.look = look


@pytest.mark.parametrize(("depth", "has_noise"), [(1.0, False), (1.0, True), (0.7, False)])
def test_a_healthy_run_is_called_ill_at_no_time(depth, has_noise):
    """Nor is noise at the goal a wrong camera, nor a wrong depth, which does no harm."""
    goal = replace(the_goal("2016"), depth=the_goal("2016").depth * depth)
    late = {} if has_noise else {"latency": 0.02, "lag": 0.04}
    rig = with_borders(Rig(the_servo(goal=goal, hold=1.0), near(1), **late))
    if has_noise:
        noisy(rig)
    states = rig.run(5.0)
    assert all(s.outcome == "running" or s.outcome.startswith("converged") for s in states), (
        rig.servo.outcome)
    assert states[-1].phase == CONVERGED
    assert rig.missed[0] - 1e-5 < rig.servo.outcome.open_distance < 1e-3
    assert has_noise or rig.missed[0] < 0.3e-3


def test_target_lost_over_a_border():
    rig = with_borders(Rig(the_servo("2016"), near(0)))
    rig.lose(0.6, reason="the target touches the top border", touches=("top",))
    states = rig.run(1.7)
    outcome = rig.servo.outcome
    assert outcome.kind == states[-1].outcome == "target_lost" and outcome.remedy
    assert "lost at 0.60 s over the top border" in outcome.reason


def test_an_image_that_cannot_be_measured_for_long_is_a_target_lost():
    class Counting(Twice):
        def measure(self, observation, goal):
            if observation.stamp > 0.5:
                raise MeasurementError("9 points are visible, but the goal has 8")
            return super().measure(observation, goal)

    rig = Rig(the_servo(scheme=FeatureScheme(Counting(), Proportional(3.0))), near(1))
    last = rig.run(1.5)[-1]
    assert last.phase == "holding" and last.outcome == "running"
    rig.run(1.0)
    outcome = rig.servo.outcome
    assert outcome.kind == "target_lost" and "9 points are visible" in outcome.reason
    assert "since 0.5" in outcome.reason and outcome.remedy


def test_gain_too_high_with_its_frequency():
    servo = the_servo("2016", law=Proportional(30.0), limits=the_limits(velocity=5.0))
    found = outcome_after(with_borders(Rig(servo, near(0, 0.1), latency=0.06)), 3.0)
    assert found.kind == "gain_too_high" and "lower the gain" in found.remedy
    assert 1.0 < float(found.reason.split(" at ")[1].split(" Hz")[0]) < 8.0


def test_a_focal_length_somewhat_wrong_is_told_by_a_camera_that_also_comes_down():
    goal, arm = the_goal("2016"), the_arm()
    pose = goal.world_T_camera.copy()
    pose[:3, 3] += (-0.05, 0.06, 0.1)
    start = arm.inverse_kinematics(pose, np.array(goal.get_joints(arm.names)), tolerance=1e-4)
    rig = Rig(the_servo("2016"), start, lag=0.1)

    def look(*given):
        seen = rig.exact(*given)
        return replace(seen, moments=loop_rig.scaled(seen.moments, 0.85))

    rig.look = look
    found = outcome_after(rig, 3.0)
    assert found.kind == "wrong_camera_model" and "along v" in found.reason


def test_a_joint_at_its_limit_is_the_cause_also_where_the_camera_looks_wrong():
    """The gantry ends 60 mm before the goal, and J1 may not stand in for it."""
    limits = the_limits(upper={"gantry": -0.01, "J1": 0.02}, lower={"J1": -0.02})
    rig = Rig(the_servo("2016", limits=limits), [-0.1, 0.0, *near(0)[2:]])
    rig.servo.diagnosis.evidence.camera_checks["camera"] = checked(True)
    assert outcome_after(rig, 0.5).kind == "wrong_camera_model"
    found = outcome_after(rig, 6.0)
    assert found.kind == "joint_limit" and "gantry" in found.reason
    assert "; in addition, the features do not move as L" in found.reason


def lifted(height):
    goal = the_goal("2016")
    higher = goal.world_T_camera.copy()
    higher[2, 3] += height
    return replace(goal.predict_from_pose(higher), joints={})


def test_a_target_lost_on_the_way_to_a_goal_out_of_reach_is_the_goal_s_fault():
    rig = Rig(the_servo("2016", goal=lifted(2.5)), near(0))
    assert rig.servo.unreachable_reason.startswith(
        "goal_2016.yaml: camera position (0.0500, -0.0297, 3.2834)")
    rig.lose(0.3)
    states = rig.run(0.6)
    assert states[5].outcome == "running"  # not told as long as the arm comes nearer
    outcome = rig.servo.outcome
    assert outcome.kind == "out_of_reach"
    assert "the target was lost at 0.30 s: gone" in outcome.reason
    assert "within the arm's reach" in outcome.remedy
    # one that the arm nearly has, and one by joints, are not; it cannot roll
    near_by, rolled = lifted(0.001), lifted(0.001)
    for goal, roll in ((near_by, 5e-3), (rolled, 5e-2)):
        goal.world_T_camera[:] = goal.world_T_camera @ matrix_from_xyz_rpy((0, 0, 0), (0, roll, 0))
    assert "degrees away" in the_servo("2016", goal=rolled).unreachable_reason
    for goal, kind in ((lifted(2.5), "out_of_reach"), (near_by, "timed_out"), (None, "timed_out")):
        servo = the_servo("2016", goal=goal)
        assert bool(servo.unreachable_reason) is (kind == "out_of_reach")
        servo.time_out(3.0)
        assert servo.outcome.kind == kind


def test_starving_again_and_again_is_remembered():
    rig = Rig(the_servo("2016", law=Proportional(0.3)), STARTS["2016"])
    for starving in range(2):
        rig.run(0.2)
        assert rig.servo.outcome.kind == "running"
        rig.next_image = rig.now + 0.4
        rig.run(0.39)
        assert rig.servo.outcome.kind == "too_few_images", starving
    last = rig.run(0.2)[-1]
    assert (last.phase, last.outcome) == ("servoing", "too_few_images")
    rig.servo.start()
    assert rig.run(0.1)[-1].outcome == "running"


@pytest.mark.parametrize(("period", "gap", "remedy"), [
    (1.0 / 30.0, 0.6, "what delays its images: the load of the machine, the network, or the camera "
     "node"),
    (0.15, 0.9, "multiply gain by"),
])  # fmt: skip
def test_a_lower_gain_is_advised_only_if_images_come_rarely(period, gap, remedy):
    rig = Rig(the_servo(law=Proportional(1.0)), STARTS["2016"], image_period=period)
    for _ in range(3):
        rig.run(1.0)
        rig.next_image = rig.now + gap
        rig.run(gap - 0.01)
    found = rig.servo.outcome
    assert found.kind == "too_few_images" and remedy in found.remedy
    assert ("gain" in found.remedy) == ("watchdog" in found.remedy) == ("gain" in remedy)
    assert found.reason.startswith("the watchdog stopped the arm 3 times, the last time at ")


class Twice(Feature):
    """Feature that is the same number twice, for two directions: L has rank 1."""

    names, tolerances = ("xg", "again"), (1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation, goal):
        m = observation.moments
        s = np.array([m.xg, m.xg - 0.3])
        L = np.zeros((2, 6))
        L[:, 0] = -5.0
        return FeatureMeasurement(s, np.zeros(2), s, L)


def test_features_without_rank_and_the_last_image():
    rig = Rig(the_servo(scheme=FeatureScheme(Twice(), Proportional(3.0))), near(1))
    last, found = rig.run(5.0)[-1], rig.servo.outcome
    assert found.kind == "singular" and "rank 1 of 2" in found.reason
    assert last.remedy == found.remedy
    assert found.remedy.changes == (SettingChange("scheme", "set", "moments"),)
    # The image that comes when the time is over is the last.
    rig = Rig(the_servo("2016", law=Proportional(0.2), duration=1.0), STARTS["2016"])
    for stamp in np.arange(40.0, 41.01, 0.125):
        assert rig.servo.phase in ("waiting", "servoing")
        rig.answer(stamp)
    assert (rig.servo.phase, rig.servo.reason) == ("stopped", "the duration of the run is over")
    assert rig.servo.outcome.reason.startswith("not converged after 1.0 s")


# -- outcomes of their own ------------------------------------------------------------------------
def moving(rig, displacement):
    """The rig's target moves by displacement(t) (3,), m, in the world."""

    def look(observer, stamp, joints):
        pose = rig.servo.arm.pose(rig.q).copy()
        pose[:3, 3] -= displacement(stamp)
        contour = rig.servo.goal.target.compute_outline(pose)
        return observer.observe_exact_features(stamp, CAMERA, joints, contour=contour)

    rig.look = look
    return rig


@pytest.mark.parametrize(("scheme", "interaction"), [
    ("moments", "current"), ("ellipse", "desired"),
])  # fmt: skip
def test_a_target_that_moves_steadily_is_no_wrong_camera(scheme, interaction):
    servo = the_servo("2016", scheme, Proportional(2.0), options={"interaction": interaction})
    velocity = np.array([0.008, -0.015, 0.0])
    found = outcome_after(moving(Rig(servo, near(1, 0.1)), lambda t: velocity * t), 6.0)
    assert found.kind == "target_moves", found
    assert "FeatureMeasurement.error_drift" in found.remedy and "calibrate" not in found.remedy
    if interaction == "current":
        said = float(found.reason.split(" at ")[1].split(" mm/s")[0])
        assert said == pytest.approx(17.0, rel=0.1)


def test_a_target_that_swings_is_told_with_its_frequency_and_one_pushed_once_does_not_move():
    servo, way = the_servo("2016", law=Proportional(2.0)), np.array([0.012, 0.005, 0.0])
    rig = moving(Rig(servo, near(2)), lambda t: way * np.sin(2.0 * np.pi * 0.5 * t))
    found = outcome_after(rig, 7.0)
    assert found.kind == "target_moves", found
    said = float(found.reason.split(" at ")[1].split(" Hz")[0])
    assert said == pytest.approx(0.5, abs=0.06)
    rig = moving(Rig(the_servo("2016"), near(1)), lambda t: np.array([0.015, 0.0, 0.0]) * (t > 0.5))
    states = rig.run(6.0)
    assert not {"target_moves", "wrong_camera_model"} & {s.outcome for s in states}
    assert states[-1].outcome == "converged" and not rig.servo.outcome.remedy


@pytest.mark.parametrize("is_lost", [False, True])
def test_a_joint_that_stands_still_is_named(is_lost):
    rig = Rig(the_servo("2016"), near(1))
    rig.friction = np.array([0.0, 0.0, 9.0, 0.0, 0.0, 0.0])  # J2 is blocked
    while not rig.servo.is_waiting_for_joints and rig.now < 10.0:
        rig.run(0.1)
    if is_lost:
        rig.lose(rig.now, reason="covered")
        assert outcome_after(rig, 3.0).kind == "target_lost"
        return
    found = outcome_after(rig, 3.0)
    assert found.kind == "joints_do_not_follow", found
    assert found.reason.startswith("the motion of J2 does not follow")
    assert "controllers of J2:" in found.remedy


def checked(is_faulty):
    """Return a CameraModelCheck after 30 images, whose translations may go the wrong way."""
    check, history = CameraModelCheck(), FeatureHistory()
    way = 1e-2 * np.array([1.0, 1.0, 0.5, 0.0, 0.0, 0.0])
    for k in range(30 * is_faulty):
        image = an_image(k / 30.0, 1 / 30, way)
        history.add(image, -k * way[:3], np.eye(6)[:3], 0.0, 1e-3, True)
        check.add(history, image)
    assert bool(check.find_fault()) is is_faulty
    return check


SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])


def seen_at(distance):
    """Return a state without output, with a target at a multiple of the goal's distance."""
    observation = an_image(0.0, 0.03, moments=Moments.from_polygon(SQUARE / distance + 0.02))
    return ImageRecord(ServoState(0.0, "holding", reason="no answer"), observation)


def to_a_square():
    return RunContext(ServoSettings(), Goal(moments=Moments.from_polygon(SQUARE)))


@pytest.mark.parametrize(("first", "then", "kind"), [
    (1.0, 2.9, "running"), (1.0, 3.1, "camera_retreat"), (0.4, 2.9, "running"),
    (0.4, 3.1, "camera_retreat"), (2.0, 5.9, "running"), (2.0, 6.1, "camera_retreat"),
])  # fmt: skip
def test_a_camera_far_behind_start_and_goal_has_retreated(first, then, kind):
    diagnosis = Diagnosis(to_a_square())
    for distance in (first, then, then, first, then, then, then):
        assert diagnosis.outcome.kind == "running"  # two images in a row show a part of the target
        diagnosis.add(seen_at(distance))
    found = diagnosis.outcome
    assert found.kind == kind
    assert (f"{then:.1f} times the goal's distance" in found.reason) == (kind != "running")
    for back, told in ((1.6, kind), (1.4, "running")):  # it came back
        assert diagnosis.add(seen_at(back * max(first, 1.0))).kind == told
    # Without the outline of goal or view none is told.
    record, run = seen_at(9.0), to_a_square()
    far, empty = record.observation.moments, Moments(6, "dense", 0.0, 0.0, 0.0, np.zeros((7, 7)))
    for seen, wanted in ((far, None), (None, run.goal.moments), (empty, run.goal.moments)):
        one = replace(record, observation=replace(record.observation, moments=seen))
        assert diagnose(replace(run, goal=Goal(moments=wanted)), [one] * 4).kind == "running"


def test_features_are_judged_by_the_camera_whose_name_they_have():
    names, right = ("left.x", "right.x", "left.y", "size"), an_image(0.0, 0.1, name="right")
    seen = an_image(0.0, 0.1, name="left", other_cameras={"right": right})
    L, tolerances = np.arange(24.0).reshape(4, 6), np.arange(9.0, 5.0, -1.0)
    whole = np.column_stack([1.0 + np.arange(4.0), L, np.full(4, 0.5), tolerances, np.ones(4)])
    parts = split_by_camera(FeatureHistory(whole, 2.0 * whole), names, seen.cameras)
    assert {camera: part.now.tolist() for camera, part in parts.items()} == {
        "left": whole[[0, 2]].tolist(), "right": whole[[1]].tolist(), "": whole[[3]].tolist()}
    assert all((part.before == 2.0 * part.now).all() for part in parts.values())
    assert split_by_camera(FeatureHistory(whole), names, seen.cameras)["left"].before is None
    assert split_by_camera(FeatureHistory(), names, seen.cameras) == {}
    # A goal that one of the cameras has not shown is not shown.
    taught = Goal(camera=replace(CAMERA, width=320))
    both = replace(taught, camera_name="left", other_cameras={"right": taught})
    for width, whole in ((320, True), (300, False)):
        own = replace(right, camera=replace(CAMERA, width=width))
        now = replace(seen, other_cameras={"right": own})
        assert is_goal_camera(now, both) is whole
        assert not is_goal_camera(now, replace(taught, camera_name="left"))


def test_a_target_that_a_swing_has_lost_stays_lost_by_it():
    rig = Rig(the_servo("2016", law=Proportional(4.0), delay=0.4), near(1, 0.1))
    while rig.servo.outcome.kind != "gain_too_high" and rig.now < 10.0:
        rig.run(0.1)
    rig.lose(rig.now)
    for seconds in (0.1, 3.0):
        rig.run(seconds)
        assert rig.servo.outcome.kind == "gain_too_high"


@pytest.mark.parametrize(("law", "settings", "size", "period", "kind", "words"), [
    (3.5, {"delay": 0.4, "duration": 8.0}, 0.1, 1 / 30, "gain_too_high", "lower the gain"),
    (0.3, {"duration": 4.0}, 0.3, 0.5, "too_few_images", "every 0.50 s"),
])  # fmt: skip
def test_slow_swings_and_images_are_no_matter_of_time_or_a_higher_gain(
    law, settings, size, period, kind, words
):
    servo = the_servo("2016", law=Proportional(law), **settings)
    rig = Rig(servo, near(1, size), image_period=period)
    rig.run(settings["duration"] + 2.0)
    found = rig.servo.outcome
    assert found.kind == kind and words in f"{found.reason} {found.remedy}", found


# -- the evidence by itself ----------------------------------------------------------------------
def test_what_a_network_tells_says_nothing_of_the_camera():
    class Told(Twice):
        is_geometric = False

    for feature, interaction, known in (
        (Twice(), "current", True), (Told(), "current", False), (Twice(), "mean", False),
        (Stack([Twice(), Told()]), "current", False),
    ):  # fmt: skip
        scheme = FeatureScheme(feature, Proportional(3.0), interaction=interaction)
        assert scheme.can_check_camera is known


@pytest.mark.parametrize(("noise", "kind"), [(2.0, "too_noisy"), (0.0, "gain_too_high")])
def test_noise_is_no_swing_when_the_time_is_over(noise, kind):
    random, records = np.random.default_rng(4), []
    for k in range(46):
        t = k / 30.0
        error = np.array([5.0 * np.cos(2.0 * np.pi * 1.4 * t) * (noise == 0.0)])
        error += noise * random.normal(size=1) + 3.0 * noise * np.cos(0.5 * np.pi * (k // 12))
        records.append(answered(t, error))
    assert diagnose(one_error(), [*records, RunEvent("timed_out", time=1.5)]).kind == kind


def one_error(**settings):
    return RunContext(ServoSettings(**settings), the_goal("2016"), loop_rig.TolerantScheme((1.0,)))


def answered(stamp, error, phase="servoing", arrived=None, observation=None):
    """An image whose scheme gave this error, of features without an L."""
    output, solution = loop_rig.an_output(error, names=("x",)), loop_rig.a_solution(np.eye(6))
    state = ServoState(stamp, phase, scheme_output=output, ik_solution=solution,
                       arrival_status=arrived)  # fmt: skip
    return ImageRecord(state, observation or an_image(stamp, 0.03))


@pytest.mark.parametrize(("kind", "before", "told"), [
    ("running", "", "not converged after 2.5 s"),
    ("running", "the arm creeps", "not converged after 2.5 s: the arm creeps"),
    ("target_lost", "it went aside", "it went aside"),
])  # fmt: skip
def test_a_run_whose_time_is_over_says_what_it_was_about(kind, before, told):
    diagnosis = Diagnosis(RunContext(ServoSettings()))
    diagnosis.evidence.current_outcome = replace(diagnosis.outcome, kind=kind, reason=before)
    diagnosis.add(RunEvent("timed_out", time=2.5))
    assert diagnosis.outcome.kind == (kind if kind != "running" else "timed_out")
    assert diagnosis.outcome.reason == told
    diagnosis.add(RunEvent("joints_unmeasured", "no more"))  # it has ended
    assert diagnosis.outcome.reason == told


@pytest.mark.parametrize(("arrival", "interruption", "since"), [
    (1.4, None, 1.4), (1.4, 2.0, 2.1), (0.3, None, None), (9.0, None, None),
])  # fmt: skip
def test_a_run_that_ends_at_its_goal_before_the_hold_time_is_over_says_so(
    arrival, interruption, since
):
    records = []
    for t in 0.1 * np.arange(26):
        record = answered(t, np.array([0.5 if t > arrival - 0.01 else 30.0 * np.exp(-t)]))
        if interruption is not None and abs(t - interruption) < 0.01:
            state = replace(record.state, scheme_output=None, phase="holding")
            record = replace(record, state=state)
        records.append(record)
    found = diagnose(one_error(duration=2.5), [*records, RunEvent("timed_out", time=2.5)])
    text = "not converged after 2.5 s"
    if since is not None:
        text += (f"; each error was within its tolerance only for the last {2.5 - since:.2f} s, "
                 "and 2 s are needed")  # fmt: skip
    assert (found.kind, found.reason) == ("timed_out", text)


def test_a_retreat_of_a_camera_that_swings_is_the_gain_s():
    run = RunContext(ServoSettings(), the_goal("2016"))
    evidence, retreat = Evidence(run), DIAGNOSES["camera_retreat"]()
    for t in np.arange(28) / 30.0:  # until 0.9 s
        evidence.gain_check.add(t, np.array([20.0 * np.cos(6.0 * np.pi * t)]), None, 0.0)
    for stamp, distance in ((0.0, 1.0), (1.0, 9.0), (1.1, 9.0), (1.2, 9.0)):
        seen = an_image(stamp, 0.03, moments=loop_rig.scaled(run.goal.moments, 1.0 / distance))
        found = retreat.judge(answered(stamp, np.zeros(1), observation=seen), evidence)
    assert found.kind == "gain_too_high" and "retreated" in found.reason


def test_the_order_has_every_diagnosis_once_and_each_says_what_it_finds():
    shipped = [n for n, c in DIAGNOSES.items() if c.__module__.startswith("aras_visual_servo_")]
    assert sorted(ORDER) == sorted(shipped)
    for name in ORDER:
        found = DIAGNOSES[name]
        assert found.help and found.reads and found.kinds, name
    assert {kind for name in ORDER for kind in DIAGNOSES[name].kinds} | {
        "held", "no_joint_states", "unusable_joint_states", "too_few_images", "too_noisy",
        "no_progress", "timed_out"
    } == set(outcomes.KINDS)  # those are of events


def test_a_diagnosis_of_ones_own_is_asked_at_its_place_and_lasts_a_second():
    asked = []

    class Bored(DiagnosisRule):
        def judge(self, record, evidence):
            asked.append(record.state.stamp)
            return outcomes.make_outcome("target_moves", "bored") if asked[-1] > 0.1 else None

    class Close(DiagnosisRule):
        def judge(self, record, evidence):
            return outcomes.Outcome("too_close" if record.state.stamp >= 2.0 else "target_moves")

    DIAGNOSES.register("bored")(Bored)
    DIAGNOSES.register("close")(Close)
    records = [answered(t, np.ones(1)) for t in (0.0, 0.05, 0.2)]
    assert diagnose(one_error(), records, (*ORDER[:-1], "bored", ORDER[-1])).reason == "bored"
    assert asked == [0.0, 0.05, 0.2]
    asked.clear()
    assert diagnose(one_error(), records, (*ORDER, "bored")).kind == "running"  # the last answers
    assert not asked
    for end, kind in ((2.0, "target_moves"), (2.9, "target_moves"), (3.1, "too_close")):
        records = [answered(0.1 * k, np.ones(1)) for k in range(round(10 * end) + 1)]
        assert diagnose(one_error(), records, ("close",)).kind == kind


def test_a_camera_that_moves_otherwise_than_L_says_may_be_farther_from_its_goal():
    def arrived(is_faulty, phase=CONVERGED, moves=False, other_cameras=()):
        diagnosis = Diagnosis(replace(one_error(), goal=replace(the_goal("2016"), camera=CAMERA)))
        evidence = diagnosis.evidence
        evidence.camera_checks["camera"] = checked(is_faulty)
        seen = an_image(1.0, 0.03, other_cameras={
            name: an_image(1.0, 0.03, name=name) for name in other_cameras})
        left = outcomes.ArrivalStatus(True, pose_uncertainty=outcomes.PoseUncertainty(1e-4, 2e-3))
        record = answered(1.0, np.zeros(1), phase, left, seen)
        if moves:
            still = evidence.target_check
            evidence.target_check = TargetMotionCheck()
            assert watched(60, STEADY, check=evidence.target_check)[-1]
            assert diagnosis.add(record).kind == "target_moves"
            evidence.target_check = still
        return diagnosis.add(record)

    plain, other = arrived(False), arrived(True)
    assert (plain.open_distance, plain.open_angle) == (1e-4, 2e-3) and not plain.remedy
    assert (other.open_distance, other.open_angle) == (2e-4, 4e-3) and "calibrate" in other.remedy
    assert "taught with this camera, but the features do not move as L" in other.reason
    # not where one of the cameras has no goal that it has shown
    assert arrived(True, other_cameras=["right"]).kind == "wrong_camera_model"
    # and what was seen while the target moved is not held against the camera
    assert arrived(True, "servoing").kind == "wrong_camera_model"
    assert arrived(True, "servoing", moves=True).kind == "running"


def test_limits_that_parameters_narrow_are_to_be_widened():
    run = RunContext(
        ServoSettings(), the_goal("2016"), joints_beyond_limits=("J2",),
        narrowed_limits={"upper": ("J2", "J3"), "lower": ("J1",)})  # fmt: skip
    found = Evidence(run).add_advice(outcomes.make_outcome("saturation", "slow"))
    assert SettingChange("upper", "remove") in found.remedy.changes
    assert "with joints beyond the limits of J2" in found.reason
    with pytest.raises(ValueError, match="'timed out' is not a kind of event"):
        diagnose(run, [RunEvent("timed out")])


def test_images_that_an_earlier_diagnosis_has_reported_do_not_look_like_a_jump():
    class Busy(DiagnosisRule):
        """Reports an outcome for every second group of five images, before other diagnoses."""

        def judge(self, record, evidence):
            is_busy = round(30.0 * record.state.stamp) // 5 % 2
            return outcomes.make_outcome("target_lost", "busy") if is_busy else None

    DIAGNOSES.register("busy")(Busy)
    rig, records = Rig(the_servo("2016"), STARTS["2016"]), []
    rig.servo.on_record = records.append
    rig.run(2.0)
    diagnosis = Diagnosis(rig.servo.diagnosis.run_context, ("busy", *ORDER))
    for record in records:
        evidence = diagnosis.evidence
        diagnosis.add(record)
        steps = evidence.motion_check.step_check
        assert steps.first_jump is None and not evidence.find_contradiction()
        assert not (evidence.target_motion or evidence.camera_fault)
    assert steps.has_enough_motion and steps.correlation > 0.99
