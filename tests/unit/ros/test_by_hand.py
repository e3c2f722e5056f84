"""Teleoperation and teaching on a graph: keyboard, gamepad, views of a pose."""

import argparse
import io
import os
import re
import select
import shlex
import sys
import termios
import threading
import tty
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from run_messages import ARM, joint_states, position
from sensor_msgs.msg import JointState, Joy
from std_srvs.srv import Trigger

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.errors import ConfigurationError, ServoError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.ros import teach, teach_goal, teleop
from aras_visual_servo_controller.teleop import gamepad, keyboard

select_ = select.select
RIGHT, UP, DOWN = "\x1b[C", "\x1b[A", "\x1b[B"


class Terminal:
    """Standard input: each look at it brings the next list of keys, and at last a q."""

    def __init__(self, life) -> None:
        self.life, self.keys, (self.read_end, self.write_end) = life, [], os.pipe()

    def isatty(self):
        return True

    def fileno(self):
        return self.read_end

    def select(self, ready, _writable, _failed, seconds):
        assert seconds == 0.02
        self.life.now += seconds
        keys = self.keys.pop(0) if self.keys else ["q"]
        keys = keys() or [] if callable(keys) else keys
        os.write(self.write_end, "".join(keys).encode())
        return ready if keys else [], [], []


@pytest.fixture
def person(graph, life, monkeypatch, capsys):
    """User at the keyboard; `type(...)` returns the status and output for lists of keys."""
    it = SimpleNamespace(life=life, graph=graph, raw=[], early=lambda: None)
    terminal = Terminal(life)
    monkeypatch.setattr(sys, "stdin", terminal)
    monkeypatch.setattr(select, "select", terminal.select)
    monkeypatch.setattr(termios, "tcgetattr", lambda _file: "before")
    monkeypatch.setattr(tty, "setcbreak", lambda _file: it.raw.append("raw"))
    monkeypatch.setattr(termios, "tcsetattr", lambda _file, _when, how: it.raw.append(how))
    graph.parameters["/robot_description"] = ARM
    kind = "position_controllers/JointPositionController"
    for joint in ("slide", "elbow"):
        graph.parameters |= {f"/aras_visual_servo/{joint[0]}/type": kind,
                             f"/aras_visual_servo/{joint[0]}/joint": joint}

    def type_(*keys):
        terminal.keys = list(keys)
        with monkeypatch.context() as patch:
            patch.setattr(threading, "Event", lambda: Heard(it))
            return teleop.main(), capsys.readouterr()

    it.type = type_
    yield it
    os.close(terminal.read_end)
    os.close(terminal.write_end)


EVENT_TYPE = type(threading.Event())


class Heard(EVENT_TYPE):
    """Joint states come while they are waited for the second time."""

    def __init__(self, person):
        super().__init__()
        self.person, self.waits = person, 0

    def wait(self, limit=None):
        if limit != 2.0:
            return super().wait(limit)
        self.waits += 1
        self.person.early()
        if self.waits == 2:
            hear = self.person.graph.subscribers["/aras_visual_servo/joint_states"]
            hear(JointState(name=["finger"], position=[1.0]))
            assert not self.is_set()
            hear(joint_states(1.5))
        return self.is_set()


def sent(person):
    topics = {j: f"/aras_visual_servo/{j[0]}/command" for j in ("slide", "elbow")}
    return {j: [m.data for m in person.graph.publishers[t].sent] for j, t in topics.items()}


def test_keys_step_joints_and_tell(person):
    status, told = person.type([RIGHT, RIGHT], [], [DOWN, "h", " "], ["x", "q", RIGHT])
    assert status == 0 and person.raw == ["raw", "before"] and person.life.finds_publishers
    assert person.life.begun == [("aras_teleop", {"anonymous": True, "disable_signals": True})]
    slide, elbow = position(1.5)
    assert sent(person)["slide"] == pytest.approx([slide + 0.05, slide + 0.1])
    assert sent(person)["elbow"] == pytest.approx([elbow - 0.05])
    help_ = keyboard.__doc__
    assert told.out == (
        f"{help_}\nwaiting for joint states on /aras_visual_servo/joint_states\n"
        f"slide to {slide + 0.05:.3f}\nslide to {slide + 0.1:.3f}\nelbow to {elbow - 0.05:.3f}\n"
        f"{help_}\nslide {slide:.3f}  elbow {elbow:.3f}\n")
    assert person.graph.heard["/joy"] == (Joy, {"queue_size": 1})
    assert person.graph.heard["/aras_visual_servo/joint_states"] == (JointState, {"queue_size": 1})
    status, told = person.type(["\x04", RIGHT])
    assert status == 0 and "slide to" not in told.out
    status, told = person.type(lambda: setattr(person.life, "down", True), [RIGHT])
    assert status == 0 and "slide to" not in told.out


def test_a_held_key_stops_the_controller_and_drives(person):
    stopped = []
    rospy.Service("/aras_visual_servo/controller/stop", Trigger, lambda _: stopped.append(1) or (
        Trigger._response_class(True, "")))
    rospy.set_param("~across", "elbow")
    person.type(["2", "x"], [])
    assert not stopped  # nothing moves by these
    status, told = person.type(["2"], *[["-"]] * 10, [], *[[]] * 40, [RIGHT])
    assert status == 0 and stopped == [1]
    assert told.out.count("the controller is stopped; its service start resumes it") == 1
    assert "+ and - move elbow" in told.out
    slide, elbow = position(1.5)
    ways = sent(person)
    assert min(ways["elbow"]) < elbow - 0.01 and len(ways["slide"]) > 10
    assert ways["slide"] == pytest.approx([slide] * len(ways["slide"]))
    # The arrows step from where the arm is now.
    assert ways["elbow"][-1] == pytest.approx(elbow + 0.05)
    assert f"elbow to {elbow + 0.05:.3f}" in told.out


def test_why_the_arm_does_not_follow_is_said_once_each_time(person):
    where = [position(1.5)[0], 1.99]

    def near():
        person.graph.subscribers["/aras_visual_servo/joint_states"](
            JointState(name=["slide", "elbow"], position=where))

    said = "elbow is at its limit"
    rospy.set_param("~across", "elbow")
    drive, rest = [["+"]] * 12, [[]] * 30
    _, told = person.type(near, ["2"], *drive, [" "], *rest, *drive, *rest, [" "])
    lines = told.out.splitlines()
    assert lines.count(said) == 3  # for each drive, and when it was asked
    told_at = [i for i, line in enumerate(lines) if line == said]
    assert "" not in lines[told_at[0]:] and max(sent(person)["elbow"]) == 2.0


def test_a_pad_drives_while_its_button_is_held(person, tmp_path):
    def plug_in(name):
        os.mkfifo(tmp_path / name)
        rospy.set_param("~joystick", str(tmp_path / name))
        return os.open(tmp_path / name, os.O_RDWR)

    rospy.set_param("~joy", "/my/joy")
    idle = plug_in("js0")
    status, told = person.type(["h"], [], [])
    assert status == 0  # although a twist of none is refused
    assert not sent(person)["slide"] and told.out.count(gamepad.HELP) == 2

    device = plug_in("js1")

    def press():
        os.write(device, gamepad.EVENT.pack(0, -int(gamepad.AXIS_RANGE), gamepad.AXIS, 1)
                 + gamepad.EVENT.pack(0, 1, gamepad.BUTTON, gamepad.FAST))
        while select_([device], [], [], 0)[0]:
            pass

    status, told = person.type(press, *[[]] * 400, [" "])
    assert status == 0 and len(sent(person)["slide"]) > 15
    for one in (idle, device):
        os.close(one)
    rospy.set_param("~joystick", str(tmp_path / "none"))
    axes, buttons = [0.0] * 8, [0] * 16
    axes[1], buttons[gamepad.FAST] = 1.0, 1
    person.early = lambda: person.graph.subscribers["/my/joy"](Joy(axes=axes, buttons=buttons))
    assert not person.type()[1].out.count(gamepad.HELP)
    assert not sent(person)["slide"]  # nothing is known of the joints yet
    person.early = lambda: None
    person.type(lambda: person.graph.subscribers["/my/joy"](Joy(axes=axes, buttons=buttons)),
                *[[]] * 10)
    assert len(sent(person)["slide"]) > 8


@pytest.mark.parametrize(("parameters", "why"), [
    ({"~across": "finger"}, "unknown joint 'finger'"), ({"/robot_description": ""},
                                                       "no robot description on parameter")])
def test_what_cannot_be_driven_is_said(person, parameters, why):
    for name, value in parameters.items():
        rospy.set_param(name, value)
    status, told = person.type()
    assert status == 1 and told.err.startswith("aras_teleop: ") and why in told.err


def test_a_terminal_is_needed_and_a_ctrl_c_ends(person, monkeypatch):
    def end():
        raise KeyboardInterrupt

    assert person.type(end)[0] == 0 and person.raw == ["raw", "before"]
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    status, told = person.type()
    assert status == 1 and "reads keys from a terminal: start it with rosrun" in told.err


@pytest.fixture
def lesson(graph, life, shipped_arm, tmp_path):
    """Robot at its goal, its camera node, and the arguments of teaching."""
    from aras_visual_servo_bench.experiment.robot_spec import RobotSpec
    from aras_visual_servo_bench.experiment.robots import Robot

    graph.parameters["/robot_description"] = Robot(RobotSpec()).urdf
    it = SimpleNamespace(life=life, graph=graph, arm=shipped_arm, stamp=0.0)
    it.arguments = argparse.Namespace(scheme="moments", go="", timeout=30.0, images=3, depth=None,
                                      file=tmp_path / "mine.yaml")
    config = Path(__file__).parents[3] / "src/aras_visual_servo_controller/config"
    goal = Goal.load(config / "goal_2016.yaml").for_arm(shipped_arm)
    it.goal, it.q = goal, goal.get_joints(shipped_arm.names)
    seen = Moments.from_polygon(goal.target.compute_outline(goal.world_T_camera), 6)

    def look(valid=True):
        it.stamp += 0.1
        message = JointState(name=list(shipped_arm.names), position=it.q.tolist())
        message.header.stamp = rospy.Time.from_sec(it.stamp)
        if "/aras_visual_servo/joint_states" in graph.subscribers:
            graph.subscribers["/aras_visual_servo/joint_states"](message)
            found = ImageMoments(
                valid=valid, reason="" if valid else "dark", order=6, m=seen.m_array,
                mu=seen.mu_array, width=320, height=240, D=[0.0] * 5, header=message.header,
                K=[103.0, 0.0, 159.5, 0.0, 101.0, 119.5, 0.0, 0.0, 1.0],
                distortion_model="plumb_bob")
            graph.subscribers["/aras_visual_servo/camera/moments"](found)

    it.look = look
    return it


def test_views_of_where_the_arm_stands_become_a_goal(lesson):
    lesson.life.steps = [lesson.look] * 3 + [lambda: None] * 9
    made = teach.collect_views(lesson.arguments)
    assert lesson.life.begun == [("teach", {"disable_signals": True, "anonymous": True})]
    assert made.name == "mine.yaml" and lesson.life.slept == [0.02] * 3
    np.testing.assert_allclose(made.get_joints(lesson.arm.names), lesson.q)
    assert made.depth == pytest.approx(lesson.goal.depth, rel=1e-6)  # by the shipped geometry
    assert not lesson.graph.subscribers and not lesson.graph.publishers
    lesson.arguments.depth, lesson.life.steps = 0.3, [lesson.look] * 4
    assert teach.collect_views(lesson.arguments).depth == pytest.approx(0.3)


def test_a_goal_is_written_as_the_command_line_says(lesson, monkeypatch, capsys):
    file = lesson.arguments.file
    lesson.life.steps = [lesson.look] * 31
    assert teach_goal.main([str(file)]) == 0
    assert file.read_text().startswith(f"# Taught from 30 images.\n# Made by: teach {file}\n")
    made = Goal.load(file)
    assert capsys.readouterr().out == (
        f"wrote {file}: depth {made.depth:.4f} m, area {made.moments.m00:.6f}\n")
    words = [str(file), "--scheme", "gravity_centre", "--images", "2", "--depth", "0.3"]
    monkeypatch.setattr(sys, "argv", ["teach", "_gain:=3", *words, "_posture_gain:=0.5"])
    lesson.life.steps = [lesson.look] * 3
    assert teach_goal.main() == 0  # the node's parameters are no arguments of its own
    assert file.read_text().startswith(
        f"# Taught from 2 images.\n# Made by: teach {shlex.join(words)}\n")
    assert Goal.load(file).depth == pytest.approx(0.3)


def test_the_arm_is_driven_to_a_pose_first(lesson):
    goal, lesson.q = lesson.q, lesson.q + 0.02
    names = lesson.arm.names
    kind = "position_controllers/JointPositionController"
    for joint in names:
        lesson.graph.parameters |= {f"/aras_visual_servo/{joint}_c/type": kind,
                                    f"/aras_visual_servo/{joint}_c/joint": joint}

    def follow():
        lesson.look()
        sent = [lesson.graph.publishers[f"/aras_visual_servo/{n}_c/command"].sent for n in names]
        lesson.q = np.array([one[-1].data for one in sent])

    lesson.arguments.go = "2016"
    lesson.life.steps = [follow] * 400
    made = teach.collect_views(lesson.arguments)
    np.testing.assert_allclose(made.get_joints(names), goal, atol=4e-3)
    lesson.arguments.go = " ".join(f"{v:.6f}" for v in goal + 0.01)
    lesson.life.steps = [follow] * 400
    np.testing.assert_allclose(teach.collect_views(lesson.arguments).get_joints(names), goal + 0.01,
                               atol=4e-3)


def test_what_keeps_from_teaching_is_said(lesson):
    lesson.life.steps = [lambda: lesson.look(False)] * 5
    with pytest.raises(ServoError, match=re.escape(
            "the last 3 images show nothing that can be taught (dark): bring the target")):
        teach.collect_views(lesson.arguments)
    lesson.life.steps = [lesson.look] + [lambda: None] * 5000
    with pytest.raises(ServoError, match="only 1 of 3 usable images arrived within 30 s .no"):
        teach.collect_views(lesson.arguments)
    lesson.life.steps = [lesson.look]
    with pytest.raises(ServoError, match="only 1 of 3 usable images"):
        teach.collect_views(lesson.arguments)  # the node ends
    for name in ("left", "right"):
        rospy.set_param(f"~cameras/{name}", {"frame": "camera_optical_frame"})
    lesson.arguments.scheme, lesson.life.steps = "points@left+area@right", []
    with pytest.raises(ServoError, match="only 0 of 3 usable images"):
        teach.collect_views(lesson.arguments)
    assert any("right" in topic for topic in lesson.graph.subscribers)
    lesson.arguments.go = "nowhere"
    with pytest.raises(ConfigurationError, match="nowhere"):
        teach.collect_views(lesson.arguments)
