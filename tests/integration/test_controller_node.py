"""Controller node on a graph with the scheme of docs/my_scheme.md: commands as the pages print
them, its action, and commands of another node to its joints.

Its services, gains and starts: test_dashboard.py; what disturbs a run: tests/unit/servo.
"""

import os
import shlex
import sys
from pathlib import Path

import actionlib
import numpy as np
import pytest
import rospy
from actionlib_msgs.msg import GoalStatus
from aras_visual_servo_controller.msg import ServoState, ServoToTargetAction, ServoToTargetGoal
from gazebo_calls import call, time_goes_on
from ros_graph import SLOW_CAMERA, wait_for
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "docs"))
from blocks import ROOT, Block, blocks  # noqa: E402

ROBOT = "/aras_visual_servo"
J6 = f"{ROBOT}/joint6_position_controller/command"


def page(name: str) -> list[Block]:
    return blocks(ROOT / "docs" / f"{name}.md")


def commands(*names: str) -> list[list[str]]:
    return [words for name in names for block in page(name) if block.language == "bash"
            for words in block.commands()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A user's folder with the files that the pages show."""
    folder = tmp_path_factory.mktemp("docs")
    for block in (*page("my_scheme"), *page("my_target")):
        if block.file:
            (folder / block.file).write_text(block.text)
    return folder


@pytest.fixture(scope="module", autouse=True)
def loop(launch, ros_node, ros_master, folder):
    """The robot, and the nodes that servo it, which find what a user has written."""
    with pytest.MonkeyPatch.context() as patch:
        path = f"{folder}{os.pathsep}{ros_master.environment['PYTHONPATH']}"
        patch.setitem(ros_master.environment, "PYTHONPATH", path)
        launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
               paused=True, camera=SLOW_CAMERA, clock_rate=100)
        file = "aras_visual_servo_nodes.launch"
        words = next(words for words in commands("my_scheme") if file in words)
        nodes = launch("aras_visual_servo_gazebo", file, nodes=[f"{ROBOT}_controller"],
                       **dict(word.split(":=", 1) for word in words if ":=" in word))
        with time_goes_on():
            yield nodes
    assert "Traceback" not in nodes.output()


@pytest.fixture
def states(collect):
    """States of the loop, which runs and has converged."""
    states = collect(f"{ROBOT}/controller/state", ServoState)
    call(f"{ROBOT}/controller/start", Trigger)
    states.wait(timeout=90.0, where=lambda state: state.phase == "converged")
    return states


def test_commands_of_the_first_hour(states, ros_master, folder, monkeypatch):
    monkeypatch.chdir(folder)
    printed = [words for words in commands("first_run", "my_target")
               if words[0] in ("rosservice", "rostopic") or "spawn_model" in words]
    assert len(printed) >= 5
    for words in printed:
        output = ros_master.run(words).stdout
        assert "success: False" not in output, f"{shlex.join(words)}: {output}"


def test_an_action_is_cancelled_and_another_one_succeeds(states):
    client = actionlib.SimpleActionClient(f"{ROBOT}/servo_to_target", ServoToTargetAction)
    assert client.wait_for_server(rospy.Duration(10.0))
    # Drive the camera away from its goal.
    assert rospy.ServiceProxy(f"{ROBOT}/controller/stop", Trigger)().success
    away = rospy.Publisher(f"{ROBOT}/gantry_position_controller/command", Float64, queue_size=1)

    def gantry() -> float:
        last = states.messages[-1]
        return last.joint_positions[list(last.joint_names).index("gantry")]

    at = gantry()
    wait_for(lambda: away.publish(at - 0.1) or gantry() < at - 0.09, 20.0, "the gantry")
    away.unregister()
    feedback = []
    client.send_goal(ServoToTargetGoal(), feedback_cb=feedback.append)
    wait_for(lambda: [f for f in feedback if f.phase == "servoing"], 20.0, "feedback")
    client.cancel_goal()
    assert wait_for(client.get_result, 10.0, "the preemption").outcome == "stopped"
    assert client.get_state() == GoalStatus.PREEMPTED
    client.send_goal(ServoToTargetGoal(timeout=60.0))
    result = wait_for(client.get_result, 90.0, "success")
    assert client.get_state() == GoalStatus.SUCCEEDED and result.outcome.startswith("converged")
    assert list(result.feature_names) == ["x", "y", "size"]
    assert (np.abs(result.error) < 0.002).all()


def test_another_node_s_commands_are_named_and_the_loop_continues_after_them(states, collect):
    """The loop sent nothing any more and blamed the controllers."""
    last = states.messages[-1]
    commands = collect(J6, Float64)
    other = rospy.Publisher(J6, Float64, queue_size=1, tcp_nodelay=True)
    parked = Float64(last.joint_positions[list(last.joint_names).index("J6")] + 0.2)

    def named():
        other.publish(parked)
        return f"{rospy.get_name()} commands J6" in states.messages[-1].reason

    wait_for(named, 60, "the reason that names the other node")
    commands.clear()
    for _ in range(50):
        other.publish(parked)
        rospy.rostime.wallsleep(0.01)
    ours = [m for m in commands.messages if m._connection_header["callerid"] != rospy.get_name()]
    assert len(ours) < 20  # on their way before
    states.clear()
    states.wait(timeout=60.0, where=lambda state: state.phase == "converged")
    assert rospy.get_name() not in states.messages[-1].reason
    other.unregister()
