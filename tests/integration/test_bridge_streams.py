"""Command streams in lockstep: each command acts in exactly one step, and none is lost."""

from __future__ import annotations

import rospy
from controller_manager_msgs.srv import LoadController, SwitchController
from controller_rig import PARAMETERS, STRICT, call, robot_xml
from gazebo_msgs.srv import SpawnModel
from geometry_msgs.msg import Pose
from ros_graph import wait_for
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Empty

ROBOT = "/rig"
COMMAND = f"{ROBOT}/push/command"
COUNT = 300
AHEAD = 4  # commands that are under way at once


def test_each_command_acts_in_its_step(launch, collect, ros_node):
    rospy.set_param("/gazebo/lockstep_topics", [COMMAND])
    rospy.set_param("/gazebo/lockstep_period", 0.001)
    launched = launch(
        "aras_sim_bridge",
        "empty_world.launch",
        nodes=["/gazebo"],
        paused=True,
        speed_mode="lockstep",
    )
    rospy.set_param(ROBOT, PARAMETERS)
    answer = call(
        "/gazebo/spawn_urdf_model", SpawnModel, "rig", robot_xml(ROBOT), "/", Pose(), ""
    )
    assert answer.success, answer.status_message
    names = ["joint_state_controller", "push"]
    for name in names:
        assert call(f"{ROBOT}/controller_manager/load_controller", LoadController, name).ok
    switch = f"{ROBOT}/controller_manager/switch_controller"
    assert call(switch, SwitchController, names, [], STRICT, False, 0.0).ok
    states = collect(f"{ROBOT}/joint_states", JointState)
    publisher = rospy.Publisher(COMMAND, Float64, queue_size=COUNT)
    wait_for(publisher.get_num_connections, 10.0, "the command's subscriber")
    wait_for(states.connected, 10.0, "joint states")
    call("/gazebo/unpause_physics", Empty)

    def efforts() -> list[float]:
        """Return the efforts that acted, one per step, from the first command on."""
        seen = [m.effort[m.name.index("cart")] for m in list(states.messages)]
        begun = [k for k, effort in enumerate(seen) if effort]
        return seen[begun[0] :] if begun else []

    for number in range(1, COUNT + 1):
        # An effort of some thousandths of a newton: the cart stays where it is.
        publisher.publish(Float64(number / 1000.0))
        if number > AHEAD:
            wanted = number - AHEAD - 1
            wait_for(lambda n=wanted: len(efforts()) >= n, 10.0, f"step {wanted}", interval=0.001)
    wait_for(lambda: len(efforts()) >= COUNT - 1, 10.0, "the last steps")
    expected = [number / 1000.0 for number in range(1, COUNT)]
    assert efforts()[: COUNT - 1] == expected
    # The emergency stop comes through the same door, also while time waits.
    stop = rospy.Publisher(f"{ROBOT}/e_stop", Bool, queue_size=1)
    wait_for(stop.get_num_connections, 10.0, "the emergency stop's subscriber")
    stop.publish(True)
    rospy.sleep(0.2)
    for _ in range(3):
        steps = len(efforts())
        publisher.publish(Float64(5.0))
        wait_for(lambda n=steps: len(efforts()) > n, 10.0, "a step", interval=0.001)
    assert efforts()[-1] == 0.0
    launched.stop()
