"""LoopRunner with a played robot, exact vision and lagging joints, in simulated time."""

import numpy as np
import pytest
from loop_rig import PACKAGE, URDF

from aras_visual_servo_base.poses import matrix_from_xyz_rpy, pose_difference
from aras_visual_servo_base.stamp_synchronizer import StampSynchronizer
from aras_visual_servo_controller import CameraModel, Goal, JointSample, Moments
from aras_visual_servo_controller.observation.joint_history import MAX_AGE, JointHistory
from aras_visual_servo_controller.records.outcomes import REMEDIES
from aras_visual_servo_controller.records.state import ImageSource
from aras_visual_servo_controller.runner.loop_runner import LoopRunner
from aras_visual_servo_controller.settings import ControllerSettings

CAMERA = CameraModel(320, 240, (100.0, 0.0, 160.0, 0.0, 100.0, 120.0, 0.0, 0.0, 1.0))
DT = 1.0 / 90.0
FEATURES, JOINT_STATES = "/aras_visual_servo/camera/moments", "/aras_visual_servo/joint_states"


class Bench:
    """Steps the played robot and its LoopRunner, of which it is the listener too."""

    def __init__(self, **given):
        given = {"start": "none", **given}
        settings = ControllerSettings.from_mapping(given, PACKAGE).for_robot(
            "aras_visual_servo", given)
        self.arm = settings.make_arm(URDF.read_text())
        self.servo = settings.make_servo(self.arm)
        self.goal = Goal.load(PACKAGE / "config" / "goal_2016.yaml")
        self.t, self.wall, self.n = 1.0, 0.0, 0
        self.sent, self.states, self.words = [], [], []
        self.report, self.log = self.states.append, self.words.append
        rig = settings.make_camera_rig({"camera": self.arm}, self.servo.scheme)
        self.foreign, self.listening = {}, False
        self.driver = LoopRunner(
            self.servo, rig, settings, self, lambda: self.t, lambda: self.wall, self)
        self.q = np.array([-0.1, 0.0, 0.349, -0.262, -0.0873, 0.1745])
        self.command, self.seen = self.q.copy(), []
        self.images = self.joints = self.is_watched = True
        self.mounted = np.eye(4)  # (4, 4) the true camera, in the believed one's frame

    def send(self, command):
        self.sent.append((self.t, command))
        if command.positions is not None:
            self.command = command.positions.copy()

    def listen(self, active):
        self.listening = active

    def read_latest(self):
        return self.foreign if self.listening else {}

    def flood(self, seconds, value, joint=5, heard=True):
        """Another node commands a joint with a value, after each of the loop's own commands."""
        for _ in range(int(seconds / DT)):
            self.command[joint] = value
            if heard:
                self.foreign = {self.arm.names[joint]: ("/flooder", self.wall)}
            self.step()

    def step(self, count=1, stamp=None, image_stamp=None, position=None, phase=None):
        """Step the robot and the loop, which has to be in a phase then."""
        for _ in range(count):
            self.n, self.t, self.wall = self.n + 1, self.t + DT, self.wall + DT
            before = self.q
            self.q = before + (1.0 - np.exp(-DT / 0.03)) * (self.command - before)
            if self.joints:
                q = self.q if position is None else np.full(6, position)
                speed = (self.q - before) / DT
                self.tell(self.arm.names, q, speed, self.t if stamp is None else stamp)
            if self.images and self.n % 3 == 0:
                self.look(self.t if image_stamp is None else image_stamp)
            if self.is_watched:
                self.driver.check_timeouts()
        assert phase in (None, self.servo.phase), self.servo.reason

    def step_until(self, phase):
        for _ in range(2000):
            if self.servo.phase == phase:
                return
            self.step()
        pytest.fail(f"{phase} never came: {self.servo.reason}")

    def tell(self, names, positions, velocities, stamp):
        self.driver.add_joint_state(names, positions, velocities, stamp)

    def look(self, stamp, valid=True):
        pose = self.arm.pose(self.q) @ self.mounted
        moments = Moments.from_polygon(self.goal.target.compute_outline(pose), 3)

        def look(joints, commands):
            self.seen.append((joints, commands))
            return self.driver.camera_rig.control.observe_moments(
                stamp, moments if valid else None, valid, "" if valid else "no target", CAMERA,
                joints, commands)  # fmt: skip

        self.driver.add_image(stamp, look)

    def off(self):
        goal = self.arm.pose(self.servo.goal.get_joints(self.arm.names))
        return pose_difference(goal, self.arm.pose(self.q))

    def goes_on(self):
        before = self.off()[0]
        self.step(60)
        return self.servo.phase == "servoing" and self.off()[0] < 0.8 * before

    def at_rest(self):
        before = self.command.copy()
        self.step(20)
        return np.array_equal(before, self.command)


def test_it_goes_to_its_start_and_to_the_goal():
    bench = Bench(start="2015")
    bench.step(400)
    phases = list(dict.fromkeys(state.phase for state in bench.states))
    assert phases[0] == "approaching" and phases[-2:] == ["servoing", "converged"]
    assert bench.off()[0] < 1e-5
    joints, commands = bench.seen[-1]
    assert joints.stamp == pytest.approx(bench.states[-1].stamp)
    assert all(command.stamp >= joints.stamp for command in commands)
    # The missing camera is the one that is waited for.
    bench.driver.set_source("right", ImageSource("images", "/right", "somebody"))
    for lacking, what in (("right", "images"), ("", "features"), ("left", "features")):
        bench.driver.camera_rig.missing_camera = lacking
        bench.step(3)
        assert bench.servo.source.content == what


def test_lockstep_sends_once_an_image_and_never_between():
    bench = Bench(start="2015", lockstep=True)
    bench.step(300)
    assert len(bench.sent) - bench.n // 3 in (-1, 0) and bench.states[-1].phase == "servoing"
    assert all(joints is None or joints.stamp <= bench.t for joints, _ in bench.seen)
    # For another camera's picture too, whose stamp lies between two samples.
    before, between = bench.driver.history.newest, bench.t + 0.25 * DT
    bench.step(1)
    joints = bench.driver.camera_rig.find_joints(between)
    np.testing.assert_allclose(
        joints.positions, before.positions + 0.25 * DT * before.velocities, rtol=1e-12)
    # Each image is answered though the arm stands; of bad joints nothing is sent between.
    bench.driver.stop()
    bench.step(60)
    count = len(bench.sent)
    bench.step(30)
    assert len(bench.sent) == count + 10 and bench.at_rest()
    count, bench.t = len(bench.sent), bench.t + DT
    bench.tell(("J1",), (0.0,), (), bench.t)
    assert len(bench.sent) == count


@pytest.mark.parametrize(("silent", "kind"), [
    ("images", "too_few_images"), ("joints", "no_joint_states"),
])  # fmt: skip
def test_silence_stops_the_arm_smoothly_and_is_reported_in_one_way_with_its_remedy(silent, kind):
    bench = servoing(image_timeout=0.5, joint_timeout=0.5)
    assert not bench.at_rest()
    setattr(bench, silent, False)
    began, count = bench.t, len(bench.sent)
    bench.step(60)
    assert bench.at_rest()
    assert bench.sent[-1][0] - began < 0.2 + 0.15 + 0.1
    path = np.array([command.positions for _, command in bench.sent[count - 5 :]])
    times = np.array([t for t, _ in bench.sent[count - 5 :]])
    speed = np.diff(path, axis=0) / np.diff(times)[:, None]
    assert np.abs(np.diff(speed, axis=0)).max() < 0.5 * np.abs(speed).max()  # no sudden stop
    setattr(bench, silent, True)
    assert bench.goes_on()
    setattr(bench, silent, False)
    bench.states.clear()
    bench.step(int(3.0 / DT))
    states = [s for s in bench.states if s.outcome != "running"]
    assert {(s.outcome, s.remedy) for s in states} == {(kind, REMEDIES[kind])}
    assert not any(s.has_processed_image for s in states[-5:])  # reports between images
    assert len({(s.phase, s.reason) for s in states}) == 1
    assert states[-1].stamp - states[0].stamp > 2.5
    bench.images = bench.joints = False
    bench.states.clear()
    bench.step(240)
    both = [s for s in bench.states if " and no features on" in s.reason]
    assert np.diff([s.stamp for s in both]) == pytest.approx(1.0, abs=2 * DT)
    assert len(both) in (2, 3) and {s.phase for s in both} <= {"holding"}


def test_the_watchdog_says_what_it_waits_for_and_whom_to_ask():
    bench = servoing()
    bench.images = False
    bench.step(30, phase="waiting")
    what, since = bench.servo.reason.split(" since ")
    assert what == f"no features on {FEATURES}"
    assert since.endswith(" s (is the camera node running?)")
    silent = bench.t - float(since.split()[0])
    assert 30 * DT - 0.02 < silent < 30 * DT + 0.05  # since when, which stays true
    found, last = bench.servo.outcome, bench.states[-1]
    assert found.reason == f"{bench.servo.reason}; the two images before that were 0.033 s apart"
    assert (last.reason, last.remedy) == (found.reason, found.remedy)
    assert "camera runs" in found.remedy


@pytest.mark.parametrize("standing", [True, False])
def test_time_that_stands_still_is_told_from_images_that_do_not_come(standing):
    bench = servoing(wall_watchdog=2.0, image_timeout=9.0, watchdog=9.0)

    def wait(count):
        for _ in range(count):
            bench.wall += 0.1
            bench.t += 0.0 if standing else 0.01
            bench.driver.check_timeouts()

    wait(21)
    why = (f"the clock has stopped at {bench.t:.3f} s (is the simulator paused, or gone?)"
           if standing else f"no features on {FEATURES} (is the camera node running?)")
    assert (bench.servo.phase, bench.servo.reason) == (
        "holding", f"{why}; no image processed for more than 2 s of wall time")
    wait(90)
    assert bench.states[-1].reason.startswith("the clock has stopped") == standing
    assert f"no joint states on {JOINT_STATES}" in bench.states[-1].reason


def test_images_that_come_again_start_it_once_and_not_what_was_stopped_later():
    bench = servoing(wall_watchdog=5.0, image_timeout=99.0, joint_timeout=99.0)
    bench.wall += 5.1
    bench.driver.check_timeouts()
    assert bench.servo.phase == "holding"
    bench.step(1)
    assert bench.servo.phase != "servoing"
    bench.step(5, phase="servoing")
    bench.driver.stop("enough")
    bench.step(30, phase="stopped")
    bench.driver.start()
    bench.step(6)
    bench.wall += 4.9
    bench.driver.start()  # which gives images their time anew
    for wait, phase in ((4.9, "servoing"), (0.2, "holding")):
        bench.wall += wait
        bench.driver.check_timeouts()
        assert bench.servo.phase == phase
    bench.driver.apply_change(lambda servo: setattr(servo, "asked_to_change", True))
    assert bench.servo.asked_to_change


def test_only_the_clock_going_back_begins_anew():
    bench = servoing()
    for stamps in ({"image_stamp": 0.0}, {"image_stamp": bench.t - 0.02}, {"stamp": 0.0},
                   {"stamp": bench.t - 0.05}):  # fmt: skip
        bench.step(3, **stamps)
    assert not bench.words and bench.servo.phase in ("servoing", "waiting")
    assert bench.driver.start_count == 1
    bench.t = 1.0
    bench.step(1)
    assert bench.driver.start_count == 2  # joint states start to come again
    assert bench.words == [f"simulated time went back to {bench.t:.3f} s: restarting the loop"]
    assert bench.goes_on()


def test_images_of_another_clock_are_named():
    bench = Bench()
    for _ in range(200):
        bench.step(1, image_stamp=bench.t + 1.0 + DT)
    assert bench.servo.phase == "waiting" and len(bench.sent) == 1  # where the arm stands
    clocks = "the clock (check that both use the same use_sim_time)"
    assert {state.reason for state in bench.states} == {
        "", f"features on {FEATURES} are stamped 1.00 s ahead of {clocks}"}
    bench.step(30, phase="servoing")
    assert "ahead" not in bench.states[-1].reason
    bench.images = False
    bench.states.clear()
    bench.step(200)
    reasons = " ".join(state.reason for state in bench.states)
    assert "is the camera node running" in reasons and "ahead" not in reasons
    # Joint states that are all stamped by another clock are named once.
    for lead, where in ((7.25, "7.25 s ahead of"), (-0.75, "0.75 s behind")):
        bench = Bench(gain=0.5)
        for _ in range(120):
            bench.step(1, stamp=bench.t + DT + lead)
        assert bench.servo.phase == "servoing" and bench.words == [
            f"joint states on {JOINT_STATES} are stamped {where} {clocks}; used as of their "
            "arrival"]


def test_joint_states_that_were_held_up_do_not_send_it_back_to_its_start():
    bench = Bench(start="2015", gain=1.0)
    bench.step_until("servoing")
    bench.step(60)
    count, missed = len(bench.states), bench.t
    bench.joints = False
    bench.step(10)
    bench.joints = True
    for late in np.arange(missed, bench.t, DT)[1:]:
        bench.tell(bench.arm.names, bench.q, np.zeros(6), late)
    bench.step(30)
    assert "approaching" not in {state.phase for state in bench.states[count:]}
    assert not bench.words and bench.goes_on()


def test_implausible_and_missing_joints_stop_the_arm():
    bench = servoing()
    bench.step(15, position=1e308, phase="holding")
    assert np.abs([c.positions for _, c in bench.sent]).max() < 10.0
    for phase in ("holding", "servoing"):  # once none has come for a second
        bench.step(60)
        assert bench.servo.phase == phase
    for _ in range(5):
        bench.t += DT
        bench.tell(("J1",), (0.0,), (), bench.t)
    assert bench.servo.phase == "holding"
    assert any("joint states lack gantry" in state.reason for state in bench.states)
    assert "s: joint states lack gantry" in bench.servo.reason  # and not that it was NaN
    bench.step(120, phase="servoing")
    bench.images = False  # the arm does not wait for the next one
    bench.step(1, position=1e308, phase="holding")
    assert "the measured position 1e+308 of gantry is impossible" in bench.servo.reason
    for positions in (["far"] * 6, None, [[0.1], [0.2, 0.3], 0, 0, 0, 0]):  # no numbers
        bench = servoing()
        count = len(bench.states)
        bench.t += 0.04
        bench.tell(bench.arm.names, positions, (), bench.t)
        assert (bench.servo.phase, bench.servo.outcome.kind) == ("holding", "unusable_joint_states")
        assert bench.states[count].joints is None and bench.states[count].reason


def with_second_publisher(bench, seconds, position=np.nan, lead=0.0, names=None):
    """Return what is reported, from the second joint states of another node on the topic on."""
    names = names or bench.arm.names
    for k in range(int(seconds / DT)):
        bench.step()
        if k % 2:
            bench.tell(names, np.full(len(names), position), (), bench.t + lead)
        if k == 1:
            count = len(bench.states)
    return bench.states[count:]


@pytest.mark.parametrize(("position", "lead", "what"), [
    (np.nan, 0.0, "the measured position nan of gantry is impossible"),
    (9.0, 0.4, "the measured position 9 of gantry is impossible"),  # 9 m; stamps later than others
    (0.0, 1.7e9, "some are stamped 1700000000.00 s ahead of the clock, others are not"),
])  # fmt: skip
def test_unusable_joint_states_of_a_second_publisher_hold_the_arm_steadily(position, lead, what):
    bench = Bench(gain=0.5)
    bench.step(60)
    events = []
    bench.servo.on_record = events.append
    states = with_second_publisher(bench, 4.0, position, lead)
    assert len(states) > 50
    ((phase, outcome, reason, remedy),) = {(s.phase, s.outcome, s.reason, s.remedy) for s in states}
    assert (phase, outcome) == ("holding", "unusable_joint_states")
    begun = f"unusable joint states on {JOINT_STATES} since 1.69 s, between usable"
    assert reason.startswith(begun) and what in reason
    assert f"'rostopic info {JOINT_STATES}'" in remedy and "end the second publisher" in remedy
    assert len(events) == 2 and not bench.words and bench.at_rest()
    bench.step(int(0.9 / DT) - 20, phase="holding")
    bench.step(int(0.2 / DT))
    assert bench.servo.phase == "servoing" and bench.states[-1].outcome == "running"
    assert bench.goes_on()


def test_joint_states_of_other_joints_on_the_topic_are_no_fault_unless_they_are_the_only_ones():
    bench = Bench(gain=0.5)
    bench.step(60)
    states = with_second_publisher(bench, 2.0, names=("finger",))  # as a gripper's driver
    assert {(s.phase, s.outcome) for s in states} == {("servoing", "running")}
    bench.joints = False
    states = with_second_publisher(bench, 2.0, names=("finger",))
    assert states[-1].outcome == "unusable_joint_states"
    assert "joint states lack gantry" in states[-1].reason
    bench = Bench()
    bench.step(200, position=np.nan, phase="holding")
    ((outcome, remedy),) = {(s.outcome, s.remedy) for s in bench.states}
    assert outcome == "unusable_joint_states" and remedy == (
        f"check which node publishes them ('rostopic info {JOINT_STATES}'), and "
        "the limits in the robot description")
    assert bench.driver.start_count == 1


@pytest.mark.parametrize(("silent", "seconds", "kind"), [
    ("images", 0.9, "too_few_images"), ("joints", 0.5, None), ("joints", 0.9, "no_joint_states"),
])  # fmt: skip
def test_a_short_gap_at_the_goal_does_not_take_back_the_arrival(silent, seconds, kind):
    """Of less than a second, 0.22 s of which at_rest takes."""
    bench = Bench()
    bench.step_until("converged")
    bench.step(30)
    count = len(bench.states)
    setattr(bench, silent, False)
    bench.step(int(seconds / DT))
    assert bench.at_rest()
    setattr(bench, silent, True)
    bench.step(30)
    told = {(s.phase, s.outcome.partition(" ")[0]) for s in bench.states[count:]}
    if kind is None:
        assert told == {("converged", "converged")} and bench.servo.phase == "converged"
    else:
        assert {kind, "running"} <= {outcome for _, outcome in told}


def test_an_arm_that_follows_a_target_at_its_goal_stops_when_no_images_come():
    bench = Bench(watchdog=0.2)
    bench.step_until("converged")
    bench.step(30)
    bench.mounted = matrix_from_xyz_rpy((0.0, 0.0, 0.0002), (0.0, 0.0, 0.0))
    bench.step(3, phase="converged")  # a new task, which is not finished
    assert not bench.at_rest()
    bench.images = False
    bench.step(int(0.5 / DT), phase="converged")
    assert bench.at_rest()


def test_standing_by_sends_nothing():
    bench = Bench(autostart=False)
    bench.step(60)
    assert not bench.sent and bench.states[-1].phase == "stopped"
    bench.t = 1.0  # nor where the clock goes back
    bench.step(30)
    assert not bench.sent
    assert (bench.servo.phase, bench.servo.reason) == ("stopped", "waiting for start")
    bench.images, count = False, len(bench.states)
    bench.step(200)  # and of images that do not come nothing is said
    assert {state.reason for state in bench.states[count:]} == {"waiting for start"}
    bench.images = True
    bench.driver.start()
    bench.step(60)
    assert bench.sent and bench.servo.phase == "servoing"
    for order, phase in ((bench.driver.hold, "holding"), (bench.driver.stop, "stopped")):
        order()
        bench.step(30)
        assert bench.servo.phase == phase and bench.at_rest()
    dry = Bench(dry=True)
    dry.step(60)
    assert not dry.sent and dry.states[-1].phase == "servoing"
    assert np.abs(dry.states[-1].desired_twist).max() > 0.0


def servoing(**given):
    """A bench that servoes slowly, far from its goal."""
    bench = Bench(gain=1.0, **given)
    bench.step(60, phase="servoing")
    return bench


@pytest.mark.parametrize(("silence", "off", "start"), [
    (0, 0.053, "none"), (60, -0.4, "none"), (60, 0.04, "none"), (0, 0.2, "2015"),
])  # fmt: skip
def test_a_robot_that_was_made_anew_is_taken_up_where_it_stands(silence, off, start):
    bench = Bench(gain=1.0, start=start)
    bench.step(60)
    assert bench.servo.phase == ("servoing" if start == "none" else "approaching")
    bench.joints = bench.images = False
    bench.step(silence)
    bench.joints = bench.images = True
    bench.q = bench.q + off * np.array([1.0, 0.5, 0.3, 0.2, -0.3, 0.4])
    bench.command = bench.q.copy()  # nobody told them anything yet
    count, stood = len(bench.sent), bench.q.copy()
    bench.tell(bench.arm.names, bench.q, np.zeros(6), bench.t + 0.5 * DT)
    bench.step(30)
    path = np.array([stood, *(command.positions for _, command in bench.sent[count:])])
    assert np.abs(path[1] - path[0]).max() < 0.02, "the arm would jump"
    assert np.abs(np.diff(path, axis=0)).max() < 0.05, "the arm would jump"
    bench.step_until("servoing")
    assert bench.goes_on()


def stuck(bench, seconds, drift=0.0):
    """Return the times at which a bench receives its command again while its joints do not move."""
    count, before = len(bench.sent), bench.command.copy()
    away = -drift * np.sign(bench.command - bench.q)
    for k in range(int(seconds / DT)):
        bench.t, bench.wall, bench.n = bench.t + DT, bench.wall + DT, bench.n + 1
        bench.tell(bench.arm.names, bench.q + away * k * DT, away, bench.t)
        if bench.n % 3 == 0:
            bench.look(bench.t)
        bench.driver.check_timeouts()
    times = [t for t, _ in bench.sent[count:] if t > bench.t - 0.5 * seconds]
    assert all(np.abs(c.positions - before).max() < 0.2 for _, c in bench.sent[count:])
    return times


def test_a_command_that_a_joint_does_not_follow_is_sent_again_ten_times_a_second_at_most():
    bench = servoing(lead=0.05)
    bench.step(1)
    times = stuck(bench, 4.0)
    assert "waiting for" in bench.states[-1].reason
    assert 19 <= len(times) <= 21 and np.diff(times).min() > 0.1 - 1e-9


@pytest.mark.parametrize(("order", "drift"), [
    (LoopRunner.hold, 0.0), (LoopRunner.stop, 0.0),
    (lambda driver: driver.emergency_stop(True), 0.0),
    (lambda driver: [driver.emergency_stop(pressed) for pressed in (True, False)], 0.0),
    # a foreign controller takes the joints, or one of them, away from their commands
    (lambda driver: None, 0.1), (lambda driver: None, 0.1 * np.eye(6)[2]),
])  # fmt: skip
def test_a_command_is_not_sent_again_where_the_arm_is_not_to_move(order, drift):
    bench = servoing()
    order(bench.driver)
    assert not stuck(bench, 2.0, drift)
    if np.any(drift) or bench.servo.phase == "holding":
        return
    bench.driver.emergency_stop(False)
    bench.driver.start()
    assert stuck(bench, 2.0)


@pytest.mark.parametrize(("when", "heard"), [
    ("approaching", True), ("servoing", True), ("servoing", False), ("blind", True),
    ("converged", True),
])  # fmt: skip
def test_the_loop_continues_by_itself_once_foreign_commands_end(when, heard):
    bench = Bench(gain=4.0, start="2015" if when == "approaching" else "none")
    bench.step({"approaching": 30, "converged": 300}.get(when, 40))
    assert bench.servo.phase == ("servoing" if when == "blind" else when)
    parked = bench.q[5] + (0.4 if when == "blind" else 0.15)
    if when == "blind":
        look = bench.look
        bench.look = lambda stamp, valid=True: look(stamp, bench.q[5] < parked - 0.2)
    bench.flood(2.0, parked, heard=heard)
    assert not (heard and [t for t, _ in bench.sent if t > bench.t - 0.8])
    last = bench.states[-1]
    assert ("/flooder commands J6" in last.reason) is heard, last.reason
    if heard and when in ("servoing", "converged"):
        assert last.outcome == "joints_do_not_follow" and "/flooder" in last.remedy
    count, q, end = len(bench.sent), bench.q.copy(), bench.t + 10.0
    while bench.t < end and (bench.servo.phase != "converged" or bench.listening):
        bench.step(30)
    path = np.array([q, *(command.positions for _, command in bench.sent[count:])])
    assert not heard or np.abs(np.diff(path, axis=0)).max() < 0.03, "the arm would jump"
    last = bench.states[-1]
    assert last.phase == "converged" and not bench.listening and "/flooder" not in last.reason


def test_joints_are_not_commanded_again_between_foreign_commands():
    bench = servoing()
    bench.flood(3.0, bench.q[5] + 0.2)
    count = len(bench.sent)
    for _ in range(5):
        bench.step(60)
        bench.flood(DT, bench.command[5])
    assert len(bench.sent) == count
    bench.driver.stop()
    bench.step(200)
    assert len(bench.sent) == count and bench.servo.phase == "stopped"


@pytest.mark.parametrize("order", ["stop", "hold"])
def test_a_loop_without_images_that_is_stopped_stays_so_when_they_come_again(order):
    bench = servoing()
    bench.images = False
    for _ in range(700):
        bench.wall += DT  # the simulator is paused
        bench.driver.check_timeouts()
    assert "no image processed for" in bench.servo.reason
    getattr(bench.driver, order)()
    bench.images = True
    bench.step(60)
    assert bench.servo.phase == {"stop": "stopped", "hold": "holding"}[order] and bench.at_rest()


@pytest.mark.parametrize(("joint", "jumps"), [(0, True), (1, False)])
def test_joints_jump_by_parts_of_their_own_leads(joint, jumps):
    bench = servoing(lead=(0.1, 0.4, 0.05, 0.05, 0.05, 0.05))
    bench.step(1)
    told(bench, bench.t, bench.q + 0.3)
    assert bench.servo.is_only_executing  # a second state of one stamp changes nothing
    q = bench.q.copy()
    told(bench, bench.t + 0.01, q.copy())
    q[joint] += 0.1  # two parts of three between half of the one's and half of the other's
    told(bench, bench.t + 0.01, q)
    assert (np.abs(bench.servo.command - q)[joint] < 0.05) == jumps  # it goes on from there


def sample(stamp, position, speed=0.0):
    return JointSample.from_values(stamp, ("a",), [position], [speed])


def test_joints_between_and_after_their_samples():
    history = JointHistory(3)
    assert history.interpolate(1.0) is None and history.newest is None
    assert not history.is_complete_to(1.0)
    assert history.add(sample(1.0, 0.0, 10.0)) and history.add(sample(1.1, 1.0, 10.0))
    assert history.is_complete_to(1.19) and not history.is_complete_to(1.21)  # by their period
    assert history.add(sample(1.2, 3.0, 10.0))
    assert not history.add(sample(1.2, 9.0)) and not history.add(sample(1.15, 9.0))
    # before the first and after the last they move at its speed, for a tenth of a second
    for stamp, position in ((1.05, 0.5), (1.1, 1.0), (1.175, 2.5), (1.25, 3.5), (1.5, None),
                            (0.95, -0.5), (1.31, None), (0.89, None)):  # fmt: skip
        found = history.interpolate(stamp)
        assert (found and found.positions[0]) == (position and pytest.approx(position))
        assert found is None or found.velocities[0] == 10.0
    assert history.interpolate(1.29) is not None and history.interpolate(0.91) is not None
    for stamp, position in ((1.05, 0.5), (1.175, 1.75), (1.2, 3.0)):  # 0 + 10 x 0.05
        found = history.interpolate(stamp, earlier_only=True)
        assert found.positions[0] == pytest.approx(position)
    assert [history.is_complete_to(stamp) for stamp in (1.2, 1.29, 1.31)] == [True, True, False]
    history.add(sample(1.3, 4.0))
    assert history.interpolate(1.05, earlier_only=True) is None  # the oldest gave way
    history.clear()
    assert history.newest is None


def test_far_from_a_sample_joints_are_guessed():
    """By one and a half of the samples' periods: one of 10 ms, and one gap."""
    history = JointHistory()

    def guessed(*stamps):
        return {history.interpolate(stamp).is_uncertain for stamp in stamps}

    history.add(sample(0.0, 0.0))
    assert guessed(0.09) == {False}  # one sample tells no period
    for stamp in (0.01, 0.02, 0.06):
        history.add(sample(stamp, 0.0))
    assert guessed(0.08) == {True}  # whatever the last period was
    for stamp in 0.01 * np.arange(7, 12):
        history.add(sample(stamp, 0.0))
    assert guessed(0.0, 0.01, 0.034, 0.046, 0.115, 0.125, -0.015) == {False}
    assert guessed(0.036, 0.04, 0.044, 0.126, 0.2, -0.016) == {True}
    assert history.interpolate(0.05, earlier_only=True).is_uncertain
    for stamp in 0.11 + 0.03 * np.arange(1, 6):  # five of eight come more slowly
        history.add(sample(stamp, 0.0))
    assert guessed(0.304) == {False} and guessed(0.306) == {True}


def test_joints_that_tell_no_speed_have_that_of_their_way():
    history, first = JointHistory(), sample(1.0, 0.5)
    assert history.estimate_velocities(first) is first  # nothing to compare with
    history.add(first)
    second = history.estimate_velocities(sample(1.1, 0.7))
    assert (second.stamp, second.positions[0], *second.velocities) == pytest.approx((1.1, 0.7, 2.0))
    for stamp in (1.0, 1.01 + MAX_AGE):  # of the same instant, and long ago
        assert not history.estimate_velocities(sample(stamp, 0.9)).velocities.any()
    told, untold = Bench(start="none"), Bench(start="none")
    untold.tell = lambda names, q, speed, stamp: Bench.tell(untold, names, q, (), stamp)
    for bench in (told, untold):
        bench.step(40)
    speeds = [bench.driver.history.newest.velocities for bench in (told, untold)]
    assert np.abs(speeds[0]).max() > 0.01
    np.testing.assert_allclose(speeds[1], speeds[0], rtol=1e-6, atol=1e-9)


def test_an_image_waits_for_the_sample_of_its_own_stamp_however_that_is_rounded():
    for stamps, incomplete, complete in (
        *[(((k - 2) / 100, (k - 1) / 100), k / 100, (k - 1) / 100) for k in range(2, 300)],
        ((0.5, 1.0), 1.5 - 1e-6, 1.5 - 2e-6),
        ((0.01, 0.02, 0.03, 0.05), 0.061, 0.059),  # one was lost: the next may come after 10 ms
    ):
        history = JointHistory()
        for stamp in stamps:
            history.add(sample(stamp, 0.0))
        assert history.is_complete_to(complete) and not history.is_complete_to(incomplete), stamps
        history.add(sample(incomplete, 0.0))
        assert history.is_complete_to(incomplete)


def test_messages_of_one_stamp_meet_in_any_order():
    pairs = StampSynchronizer(("image", "depth"))
    for name, stamp, both in (
        ("image", 1, False), ("depth", 2, False), ("image", 2, True),
        ("depth", 1, False),  # older than what was answered
        ("depth", 3, False), ("image", 3, True), *(("image", k, False) for k in range(10, 30)),
        ("depth", 10, False), ("depth", 29, True), ("image", 31, False),  # 10 is forgotten
    ):  # fmt: skip
        expected = {"image": f"image{stamp}", "depth": f"depth{stamp}"} if both else None
        assert pairs.add(name, stamp, f"{name}{stamp}") == expected
    pairs.clear()
    assert pairs.add("depth", 31, "d") is None


# -- its numbers -------------------------------------------------------------------------------
def told(bench, t, q=None):
    bench.t = t
    bench.tell(bench.arm.names, bench.q if q is None else q, np.zeros(6), t)


def test_without_images_it_reports_at_a_camera_s_pace():
    bench = Bench(start="2015")
    for k in range(400):
        told(bench, 4.0 + 0.001 * k)
    assert bench.states[-1].phase == "approaching"
    assert np.diff([state.stamp for state in bench.states]) == pytest.approx(0.034)
    np.testing.assert_array_equal(bench.states[-1].joints.positions, bench.q)
    np.testing.assert_array_equal(bench.states[0].command, bench.q)
    assert (np.abs(bench.states[-1].command - bench.q) > 1e-3).any()
    # In lockstep too joint states without a stamp are of now.
    for stamp in (0.0, -3.0, np.nan):
        bench = Bench(lockstep=True)
        bench.step(60, stamp=stamp, phase="servoing")
        assert bench.driver.history.newest.stamp == bench.t and bench.driver.start_count == 1


@pytest.mark.parametrize(("watchdog", "blind"), [(0.01, 0.05), (0.25, 0.25)])
def test_time_goes_on_by_the_clock_for_a_moment_without_joint_states(watchdog, blind):
    """From a twentieth of a second on, up to the watchdog; no less than that."""
    bench = servoing(watchdog=watchdog, delay=0.0)
    told(bench, 8.0)
    bench.look(8.0)
    count = len(bench.sent)
    bench.t = 8.0499
    bench.driver.check_timeouts()
    assert len(bench.sent) == count and bench.servo.phase == "servoing"
    if watchdog > 0.05:
        bench.t = 8.25
        bench.driver.check_timeouts()
        assert bench.servo.phase == "servoing"
        assert [t for t, _ in bench.sent[count:]] == [bench.t]
        (_, before), (_, last) = bench.sent[-2:]
        assert last.stamp == bench.t == bench.driver.update_time
        assert np.abs(last.positions - before.positions).max() > 1e-4
    bench.t = 8.0011 + blind
    count = len(bench.states)
    for _ in range(3):
        bench.driver.check_timeouts()
    assert (bench.servo.phase, bench.servo.reason) == (
        "holding", f"no joint states on {JOINT_STATES} since 8.00 s (is the simulator running?)")
    assert len(bench.states) == count + 1  # said once of one instant


@pytest.mark.parametrize(("age", "phase"), [(0.25, "servoing"), (0.26, "holding")])
def test_an_image_finds_that_joint_states_do_not_come(age, phase):
    bench = servoing(watchdog=0.25, image_timeout=9.0)
    told(bench, 8.0)
    bench.look(8.0)
    count = len(bench.seen)
    bench.t = 8.0 + age
    bench.look(bench.t)
    assert bench.servo.phase == phase and len(bench.seen) == count  # its joints are not known
    told(bench, 8.5)
    bench.t = 8.5 + MAX_AGE + 1e-9
    for further in (-1e-9, 1e-9):
        bench.look(8.5 + MAX_AGE + further)
        assert len(bench.seen) == count + 1
    new = Bench()
    new.look(1.0)
    assert (new.servo.phase, new.servo.reason) == ("waiting", "no joint states yet")
    assert new.states[-1].has_processed_image and new.driver.update_time == 1.0


@pytest.mark.parametrize("lockstep", [False, True])
def test_an_answer_moves_time_on_in_lockstep_alone(lockstep):
    bench = servoing(lockstep=lockstep)
    bench.step(3)
    joints = bench.driver.history.newest
    bench.t += 0.4 * DT
    bench.look(bench.t)
    assert bench.driver.update_time == (bench.t if lockstep else joints.stamp)
    # In lockstep alone a joint state that came meanwhile does not count.
    then = joints.stamp + 0.5 * DT
    bench.t = joints.stamp + DT
    bench.tell(bench.arm.names, bench.q + 0.01, np.zeros(6), bench.t)
    bench.look(then)
    way = 0.5 * DT * joints.velocities if lockstep else 0.5 * (bench.q + 0.01 - joints.positions)
    np.testing.assert_allclose(bench.seen[-1][0].positions - joints.positions, way, atol=1e-12)


def test_velocities_are_sent_with_each_joint_state_also_of_an_arm_that_stands():
    bench = Bench(output="velocity", gain=1.0)
    bench.step(30)
    bench.driver.stop()
    bench.step(60)
    bench.sent.clear()
    bench.images = False
    bench.step(10)
    assert [command.values.any() for _, command in bench.sent] == [False] * 10


@pytest.mark.parametrize(("output", "dry"), [
    ("velocity", False), ("effort", False), ("velocity", True), ("position", False),
])  # fmt: skip
def test_zeros_are_the_last_that_is_sent_whatever_still_comes(output, dry):
    """After the end, the watch goes on for a while, and a callback may be under way."""
    effort = {"stiffness": 50.0, "damping": 5.0} if output == "effort" else {}
    bench = Bench(output=output, gain=1.0, dry=dry, **effort)
    bench.step(20)
    assert dry or np.any(bench.sent[-1][1].values)
    bench.sent.clear()
    bench.driver.shut_down("enough")
    assert (bench.servo.phase, bench.servo.reason) == ("stopped", "enough")
    bench.step(6)
    bench.joints = False  # time goes on by the clock, and braking with it
    bench.step(20)
    expected = [] if dry or output == "position" else [(output, [0.0] * 6)]
    assert [(c.kind, c.values.tolist()) for _, c in bench.sent] == expected
