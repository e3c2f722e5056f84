"""Controller node on a graph: its action, and commands of another node to its joints.

Its services, gains and starts: test_dashboard.py; what disturbs a run: tests/unit/servo.
"""

import actionlib
import numpy as np
import pytest
import rospy
import yaml
from actionlib_msgs.msg import GoalStatus
from aras_visual_servo_controller.msg import ServoState, ServoToTargetAction, ServoToTargetGoal
from ros_graph import wait_for
from std_msgs.msg import Float64
from test_bridge_lockstep import ROBOT, all_running

J6 = f"{ROBOT}/joint6_position_controller/command"


@pytest.fixture(scope="module", autouse=True)
def loop(launch, ros_node, tmp_path_factory):
    """The robot, and the nodes that servo it, which stand by."""
    launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"])
    wait_for(all_running, 60.0, "seven running controllers")
    parameters = tmp_path_factory.mktemp("parameters") / "parameters.yaml"
    parameters.write_text(yaml.safe_dump({"autostart": False}))
    nodes = launch("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch", start="none",
                   nodes=[f"{ROBOT}_controller"], goal="2016", parameters=str(parameters))
    yield nodes
    assert "Traceback" not in nodes.output()


@pytest.fixture
def states(collect):
    return collect(f"{ROBOT}/controller/state", ServoState)


def test_an_action_is_cancelled_and_another_one_succeeds(states):
    states.wait(timeout=40.0, where=lambda state: state.phase == "stopped")
    client = actionlib.SimpleActionClient(f"{ROBOT}/servo_to_target", ServoToTargetAction)
    assert client.wait_for_server(rospy.Duration(10.0))
    feedback = []
    client.send_goal(ServoToTargetGoal(), feedback_cb=feedback.append)
    wait_for(lambda: [f for f in feedback if f.phase == "servoing"], 20.0, "feedback")
    client.cancel_goal()
    assert wait_for(client.get_result, 10.0, "the preemption").outcome == "stopped"
    assert client.get_state() == GoalStatus.PREEMPTED
    client.send_goal(ServoToTargetGoal(timeout=60.0))
    result = wait_for(client.get_result, 90.0, "success")
    assert client.get_state() == GoalStatus.SUCCEEDED and result.outcome.startswith("converged")
    assert list(result.feature_names) == ["xn", "yn", "an", "alpha"]
    assert (np.abs(result.error) < (0.001, 0.003, 0.005, 0.01)).all()


def test_another_node_s_commands_are_named_and_the_loop_continues_after_them(states, collect):
    """The loop sent nothing any more and blamed the controllers."""
    rospy.wait_for_service(f"{ROBOT}/controller/start", 20.0)
    last = states.wait(timeout=20.0, where=lambda state: len(state.joint_positions) == 6)
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
