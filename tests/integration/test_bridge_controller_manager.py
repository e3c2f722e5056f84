"""Controllers and their manager on the graph: ros_control's tools, commands, a cancelled goal."""

import signal
import subprocess
import sys

import actionlib
import pytest
import rospy
from actionlib_msgs.msg import GoalStatus
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from controller_manager_msgs.srv import ListControllers
from gazebo_calls import ARM, call, spawn, step, time_goes_on
from gazebo_msgs.srv import GetJointProperties
from ros_graph import PATIENCE, wait_for
from std_msgs.msg import Bool, Float64
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

CONTROLLERS = {
    "push": {"type": "effort_controllers/JointEffortController", "joint": "swing"},
    "spin": {"type": "effort_controllers/JointVelocityController", "joint": "swing",
             "pid": {"p": 2.0}},
    "path": {"type": "effort_controllers/JointTrajectoryController", "joints": ["swing"],
             "gains": {"swing": {"p": 400.0, "d": 40.0}}},
    "controller_groups": {"one": ["push"], "two": ["spin"]}}
WRONG_TYPE = """
import sys, time, rospy
from std_msgs.msg import String

rospy.init_node("wrong", anonymous=True)
publisher = rospy.Publisher(sys.argv[1], String, queue_size=1, latch=True)
publisher.publish("5.0")
time.sleep(0.5)
print(publisher.get_num_connections(), "connections")
"""
LISTS = """
import rospy
from controller_manager.controller_manager_interface import *
from controller_manager_msgs import utils

rospy.init_node("asks")
list_controllers()
print(utils.get_controller_managers("/arm"),
      [one.name for one in utils.ControllerLister("/arm/controller_manager")()])
"""


@pytest.fixture(scope="module", autouse=True)
def world(launch, ros_node):
    """An arm in a paused world; no controller is loaded."""
    launched = launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True)
    rospy.set_param("/arm", CONTROLLERS)
    spawn("arm", ARM)
    yield launched
    assert "Traceback" not in launched.output()


@pytest.fixture
def tool(world):
    """Function that runs one of the command-line tools for the arm's manager."""
    return lambda *words, **more: world.master.run(
        ["rosrun", "aras_sim_bridge", *words, "__ns:=/arm"], **more)


def states() -> dict[str, str]:
    infos = call("/arm/controller_manager/list_controllers", ListControllers).controller
    return {info.name: info.state for info in infos}


def speed() -> float:
    return call("get_joint_properties", GetJointProperties, "swing").rate[0]


class Tool:
    """A command-line tool that stays until it is interrupted."""

    def __init__(self, master, *arguments: str) -> None:
        self._process = subprocess.Popen(["rosrun", "aras_sim_bridge", *arguments],
                                         env=master.environment, stdout=subprocess.PIPE,
                                         stderr=subprocess.STDOUT, text=True)

    def interrupt(self) -> None:
        """End it as Ctrl-C does."""
        self._process.send_signal(signal.SIGINT)
        self.end()

    def end(self) -> str:
        """Wait for its end; return what it printed."""
        return self._process.communicate(timeout=20.0 * PATIENCE)[0]


def test_command_line_tools(tool, ros_master):
    listed = "'push' - 'hardware_interface::EffortJointInterface' ( running )"
    assert "Loaded 'push'" in tool("controller_manager", "spawn", "push").stdout
    assert listed in tool("controller_manager", "list").stdout
    said = ros_master.run(["python3", "-c", LISTS, "__ns:=/arm"]).stdout
    assert listed in said and "['/arm/controller_manager'] ['push']" in said
    tool("controller_manager", "kill", "push")
    assert states() == {}
    assert tool("controller_manager", "load", "nobody", check=False).returncode == 1


def test_spawners_files_waits_and_ends(tool, ros_master, tmp_path):
    file = tmp_path / "more.yaml"
    file.write_text("from_file: {type: effort_controllers/JointEffortController, joint: swing}\n")
    gate = rospy.Publisher("/arm/go", Bool, queue_size=1, latch=True)
    gate.publish(False)
    with time_goes_on():
        waiting = Tool(ros_master, "spawner", "--namespace", "/arm", "--wait-for", "/arm/go",
                       "push")
        loading = Tool(ros_master, "spawner", "--stopped", str(file), "path", "__ns:=/arm")
        late = Tool(ros_master, "spawner", "--namespace", "/nowhere", "--timeout", "0.2", "x")
        wait_for(lambda: states().get("path"), 15.0, "the stopped controllers")
        assert states()["from_file"] == "initialized"
        assert "couldn't find the expected controller_manager" in late.end()
        assert "push" not in states()
        wait_for(gate.get_num_connections, 15.0, "the waiting spawner")
        gate.publish(True)
        wait_for(lambda: states().get("push") == "running", 15.0, "push")
        unspawner = Tool(ros_master, "unspawner", "push", "__ns:=/arm")
        wait_for(lambda: states()["push"] == "stopped", 15.0, "the unspawner")
        unspawner.interrupt()
        wait_for(lambda: states()["push"] == "running", 15.0, "the restart")
        loading.interrupt()
        assert set(states()) == {"push"}
        for group, push, spin in (("two", "stopped", "running"), ("one", "running", "stopped")):
            tool("controller_group", "switch", group)
            assert states() == {"push": push, "spin": spin}
        assert tool("controller_group", "switch", "three", check=False).returncode == 1
        waiting.interrupt()
        assert "push" not in states()
    gate.unregister()


def test_a_command_of_a_wrong_type_reaches_nobody(tool, ros_master):
    tool("controller_manager", "spawn", "push")
    # In a process of its own: rospy has one type a topic and process.
    seen = ros_master.run([sys.executable, "-c", WRONG_TYPE, "/arm/push/command"])
    assert seen.stdout.strip() == "0 connections"
    step(5)
    assert speed() == 0.0
    command = rospy.Publisher("/arm/push/command", Float64, queue_size=10)
    wait_for(command.get_num_connections, 5.0, "the controller")
    command.publish(2.0)
    wait_for(lambda: step(1) or speed() > 0.0, 5.0, "the effort")
    tool("controller_manager", "kill", "push")


def test_a_goal_is_cancelled_while_time_stands(tool):
    tool("controller_manager", "spawn", "path")
    client = actionlib.SimpleActionClient("/arm/path/follow_joint_trajectory",
                                          FollowJointTrajectoryAction)
    assert client.wait_for_server(rospy.Duration(10.0))
    point = JointTrajectoryPoint(positions=[0.5], time_from_start=rospy.Duration(2))
    path = JointTrajectory(joint_names=["swing"], points=[point])
    client.send_goal(FollowJointTrajectoryGoal(trajectory=path))
    wait_for(lambda: client.get_state() == GoalStatus.ACTIVE, 5.0, "the goal's acceptance")
    step(100)
    client.cancel_goal()
    wait_for(lambda: client.get_state() == GoalStatus.PREEMPTED, 5.0, "the goal's end")
