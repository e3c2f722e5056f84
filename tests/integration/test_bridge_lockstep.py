"""Lockstep: two runs are bit-identical."""

import hashlib
import xmlrpc.client

import rospy
from controller_manager_msgs.srv import ListControllers
from ros_graph import wait_for
from sensor_msgs.msg import Image, JointState
from std_srvs.srv import Empty

ROBOT = "/aras_visual_servo"
FRAMES = 60
COMMANDS = [f"{ROBOT}/{name}_position_controller/command"
            for name in ("gantry", "joint1", "joint2", "joint3", "joint5", "joint6")]


def call(name: str, service: type, *args: object) -> object:
    """Call a service that is waited for."""
    rospy.wait_for_service(name, 30.0)
    return rospy.ServiceProxy(name, service)(*args)


def all_running() -> bool:
    controllers = call(f"{ROBOT}/controller_manager/list_controllers", ListControllers).controller
    return len(controllers) == 7 and all(c.state == "running" for c in controllers)


def connections(master, node: str) -> set[tuple[str, str]]:
    """(direction, topic) of the node's live connections."""
    api = xmlrpc.client.ServerProxy(master.api.lookupNode(node))
    _, _, links = api.getBusInfo("/tests")
    return {(link[2], link[4]) for link in links if link[5]}


def run_once(launch, collect, master) -> tuple[list[str], list[str]]:
    """Image hashes and joint states of the first frames of a closed loop."""
    robot = launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
                   paused=True, speed_mode="lockstep")
    nodes = launch("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
                   nodes=[f"{ROBOT}_camera", f"{ROBOT}_controller"],
                   start="[0.05, 0.02, 0.1, -0.05, -0.05, 0.1]")
    wait_for(all_running, 40.0, "seven running controllers")
    images = collect("/labrob/camera/image_raw", Image)
    states = collect(f"{ROBOT}/joint_states", JointState)
    wait_for(lambda: ({("i", topic) for topic in COMMANDS} <= connections(master, "/gazebo")
                      and {("i", "/labrob/camera/image_raw"), ("i", "/labrob/camera/camera_info")}
                      <= connections(master, f"{ROBOT}_camera")
                      and {("i", f"{ROBOT}/joint_states"), ("i", f"{ROBOT}/camera/moments")}
                      <= connections(master, f"{ROBOT}_controller")
                      and ("o", "/labrob/camera/image_raw") in connections(master, "/gazebo")),
             20.0, "all nodes to be connected")
    wait_for(states.connected, 5.0, "joint states")
    wait_for(images.connected, 5.0, "images")
    call("/gazebo/unpause_physics", Empty)
    images.wait(FRAMES, timeout=60.0)
    call("/gazebo/pause_physics", Empty)
    stamps = [m.header.stamp.to_nsec() for m in images.messages[:FRAMES]]
    assert stamps == [round(k * 1e9 / 30) for k in range(1, FRAMES + 1)]
    joints = [m for m in states.messages if m.header.stamp.to_nsec() <= stamps[-1]]
    output = robot.output()
    images.close()
    states.close()
    ended = master.nodes() - {rospy.get_name()}
    nodes.stop()
    robot.stop()
    assert {"/gazebo", "/controller_spawner", f"{ROBOT}_controller"} <= ended
    # Or the master would end who has their addresses then, when nodes of these names begin again.
    assert not [name for name in ended if master.knows(name)]
    assert "lockstep: after waiting" not in output, output[-2000:]
    hashes = [hashlib.sha256(m.data).hexdigest() for m in images.messages[:FRAMES]]
    numbers = [repr((m.header.stamp.to_nsec(), m.position, m.velocity, m.effort)) for m in joints]
    return hashes, numbers


def test_two_runs_in_lockstep_are_bit_identical(launch, collect, ros_node, ros_master):
    first = run_once(launch, collect, ros_master)
    second = run_once(launch, collect, ros_master)
    assert len(set(first[0])) > FRAMES / 3, "the loop should have moved the camera"
    assert first[0] == second[0]
    assert first[1] == second[1]
    # 100 Hz, none lost
    assert len(first[1]) >= 100 * FRAMES / 30 - 2
