"""Controllers and their manager on the graph: commands, goals, user-defined controllers, tools.

The robots and the world that they stand in: see controller_rig.py.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import threading

import actionlib
import pytest
import rospy
from actionlib_msgs.msg import GoalStatus
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from controller_manager_msgs.srv import (
    ListControllerTypes,
    LoadController,
    ReloadControllerLibraries,
)
from controller_rig import USER_CLASS, call, step
from gazebo_msgs.srv import DeleteModel
from ros_graph import PATIENCE, wait_for
from std_msgs.msg import Bool
from std_srvs.srv import Empty
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytest_plugins = ["controller_rig"]

UNDER_WAY = (GoalStatus.PENDING, GoalStatus.ACTIVE)
WRONG_TYPE = """
import sys, time, rospy
from std_msgs.msg import String

rospy.init_node("wrong", anonymous=True)
publisher = rospy.Publisher(sys.argv[1], String, queue_size=1, latch=True)
publisher.publish("5.0")
time.sleep(0.5)
print(publisher.get_num_connections(), "connections")
"""
RELOAD = "/rig/controller_manager/reload_controller_libraries"


def test_switches_in_the_middle_of_resets(rig):
    rig.load("push")
    call("/gazebo/unpause_physics", Empty)
    resets = [
        threading.Thread(target=lambda: call("/gazebo/reset_simulation", Empty)) for _ in range(5)
    ]
    try:
        for reset in resets:
            reset.start()
            assert rig.switch(["push"])
            assert rig.switch([], ["push"])
            reset.join()
    finally:
        call("/gazebo/pause_physics", Empty)
    assert rig.states()["push"] == "stopped"


@pytest.fixture
def module(rig, rig_world):
    """The file of a user's classes, which is in the end what it was."""
    file = rig_world.modules / "my_controllers.py"
    yield file
    file.write_text(USER_CLASS.format(effort=4.0))
    assert call(RELOAD, ReloadControllerLibraries, True).ok
    rig.start("joint_state_controller")
    rig.hear()


def test_controller_classes_of_a_user(rig, module):
    types = call("/rig/controller_manager/list_controller_types", ListControllerTypes).types
    assert "my_robot/Constant" in types
    rig.start("mine")
    assert rig.see("cart", "effort", 4) == 4.0
    rig.clear()
    rig.start("mine_too")
    assert rig.see("cart", "effort", 4) == 4.0
    assert not call(RELOAD, ReloadControllerLibraries, False).ok
    module.write_text(USER_CLASS.format(effort=7.25))
    assert call(RELOAD, ReloadControllerLibraries, True).ok
    assert rig.states() == {}
    rig.start("joint_state_controller", "mine_too")
    rig.hear()
    assert rig.see("cart", "effort", 4) == 7.25
    module.write_text("def broken(:\n")
    rig.clear()
    assert call(RELOAD, ReloadControllerLibraries, True).ok
    assert not call("/rig/controller_manager/load_controller", LoadController, "mine").ok


def test_two_robots_do_not_touch_each_other(rig, other):
    rig.start("push")
    other.start("push")
    other.send("push", 5.0)
    other.until("cart", "effort", lambda f: f == 5.0)
    assert rig.see("cart", "effort") == 0.0
    rig.send("push", 1.0)
    rig.until("cart", "effort", lambda f: f == 1.0)
    assert other.see("cart", "effort") == 5.0
    assert call("/gazebo/delete_model", DeleteModel, "nobody").success is False


def test_command_line_tools(rig, ros_master, tmp_path):
    tool = ["rosrun", "aras_sim_bridge"]
    done = ros_master.run([*tool, "controller_manager", "spawn", "push", "__ns:=/rig"])
    assert "Loaded 'push'" in done.stdout
    done = ros_master.run([*tool, "controller_manager", "list", "__ns:=/rig"])
    assert "'push' - 'hardware_interface::EffortJointInterface' ( running )" in done.stdout
    code = ("import sys, rospy; from controller_manager.controller_manager_interface import *; "
            "from controller_manager_msgs import utils; rospy.init_node('asks'); "
            "list_controllers(); print(utils.get_controller_managers('/rig'), "
            "[one.name for one in utils.ControllerLister('/rig/controller_manager')()])")
    done = ros_master.run(["python3", "-c", code, "__ns:=/rig"])
    assert "'push' - 'hardware_interface::EffortJointInterface' ( running )" in done.stdout
    assert "['/rig/controller_manager'] ['joint_state_controller', 'push']" in done.stdout
    ros_master.run([*tool, "controller_manager", "kill", "push", "__ns:=/rig"])
    assert "push" not in rig.states()
    failed = ros_master.run(
        [*tool, "controller_manager", "load", "nobody", "__ns:=/rig"], check=False
    )
    assert failed.returncode == 1


class Tool:
    """A command-line tool that stays until it is interrupted."""

    def __init__(self, master, *arguments: str) -> None:
        self._process = subprocess.Popen(
            ["rosrun", "aras_sim_bridge", *arguments],
            env=master.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def interrupt(self) -> str:
        """End it as Ctrl-C does; returns what it printed."""
        self._process.send_signal(signal.SIGINT)
        return self.end()

    def end(self) -> str:
        """Wait for its end; returns what it printed."""
        return self._process.communicate(timeout=20.0 * PATIENCE)[0]


def test_spawners_files_waits_and_ends(rig, ros_master, tmp_path):
    file = tmp_path / "more.yaml"
    file.write_text("from_file: {type: effort_controllers/JointEffortController, joint: table}\n")
    rospy.set_param("/rig/controller_groups", {"one": ["push"], "two": ["roll"]})
    gate = rospy.Publisher("/rig/go", Bool, queue_size=1, latch=True)
    gate.publish(False)
    call("/gazebo/unpause_physics", Empty)
    try:
        flags = ["--namespace", "/rig", "--wait-for", "/rig/go"]
        waiting = Tool(ros_master, "spawner", *flags, "push")
        loading = Tool(ros_master, "spawner", "--stopped", str(file), "slide_to", "__ns:=/rig")
        late = Tool(ros_master, "spawner", "--namespace", "/nowhere", "--timeout", "0.2", "x")
        wait_for(lambda: rig.states().get("slide_to"), 15.0, "the stopped controllers")
        assert rig.states()["from_file"] == "initialized"
        assert "couldn't find the expected controller_manager" in late.end()
        assert "push" not in rig.states()
        wait_for(gate.get_num_connections, 15.0, "the waiting spawner")
        gate.publish(True)
        wait_for(lambda: rig.states().get("push") == "running", 15.0, "push")
        unspawner = Tool(ros_master, "unspawner", "push", "__ns:=/rig")
        wait_for(lambda: rig.states()["push"] == "stopped", 15.0, "the unspawner")
        unspawner.interrupt()
        wait_for(lambda: rig.states()["push"] == "running", 5.0, "the restart")
        loading.interrupt()
        assert set(rig.states()) == {"joint_state_controller", "push"}
        group = ["rosrun", "aras_sim_bridge", "controller_group", "__ns:=/rig"]
        ros_master.run([*group, "switch", "two"])
        assert (rig.states()["push"], rig.states()["roll"]) == ("stopped", "running")
        ros_master.run([*group, "switch", "one"])
        assert (rig.states()["push"], rig.states()["roll"]) == ("running", "stopped")
        assert ros_master.run([*group, "switch", "three"], check=False).returncode == 1
        waiting.interrupt()
        assert "push" not in rig.states()
    finally:
        call("/gazebo/pause_physics", Empty)
        gate.unregister()


def test_joint_states_are_alphabetical_with_extra_joints(rig):
    message = rig.at(step(1))
    assert message.name == ["cart", "servo", "slide", "table", "wheel", "dummy"]
    assert message.position[-1] == 0.5
    assert message.header.frame_id == ""


def test_wrong_type_and_nan_on_a_command_topic(rig, rig_world, ros_master):
    rig.start("push")
    # In a process of its own: rospy has one type a topic and process.
    seen = ros_master.run([sys.executable, "-c", WRONG_TYPE, "/rig/push/command"])
    assert seen.stdout.strip() == "0 connections"
    assert rig.see("cart", "effort", 5) == 0.0
    rig.send("push", 2.0)
    rig.until("cart", "effort", lambda f: f == 2.0)
    for value in (math.nan, math.inf):
        rig.send("push", value)
    wait_for(lambda: "is not finite" in rig_world.output(), 5.0, "the complaint")
    assert rig.see("cart", "effort", 3) == 2.0


def goal_for(names, points, **fields) -> FollowJointTrajectoryGoal:
    """A goal of (time [s], positions) pairs."""
    trajectory = JointTrajectory(joint_names=names)
    for time, positions in points:
        point = JointTrajectoryPoint(positions=positions)
        point.time_from_start = rospy.Duration.from_sec(time)
        trajectory.points.append(point)
    return FollowJointTrajectoryGoal(trajectory=trajectory, **fields)


def client_of(controller: str) -> actionlib.SimpleActionClient:
    client = actionlib.SimpleActionClient(
        f"{controller}/follow_joint_trajectory", FollowJointTrajectoryAction
    )
    assert client.wait_for_server(rospy.Duration(10.0))
    return client


def test_a_goal_is_cancelled(rig):
    rig.start("path")
    client = client_of("/rig/path")
    client.send_goal(goal_for(["slide", "servo"], [(2.0, [0.5, 0.5])]))
    wait_for(lambda: client.get_state() == GoalStatus.ACTIVE, 5.0, "the goal's acceptance")
    held = rig.see("slide", steps=100)
    client.cancel_goal()
    wait_for(lambda: client.get_state() not in UNDER_WAY, 5.0, "the goal's end, while time stands")
    assert client.get_state() == GoalStatus.PREEMPTED
    # It holds where it was read last, and has gone on from there for one step, as in ros_control.
    assert rig.see("slide") > held + 1e-4
    for steps in (1, 100):
        assert rig.see("slide", steps=steps) == pytest.approx(held, abs=1e-6)


def test_log_holds_no_traceback(rig_world):
    assert "Traceback" not in rig_world.output()
