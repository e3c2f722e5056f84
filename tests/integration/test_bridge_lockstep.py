"""Lockstep: two runs are bit-identical, and a missing answer is reported."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import threading
import time
import xmlrpc.client

import rosbag
import rospy
from aras_sim_bridge.srv import StepWorld
from controller_manager_msgs.srv import ListControllers
from ros_graph import wait_for
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float64
from std_srvs.srv import Empty

ROBOT = "/aras_visual_servo"
FRAMES = 60
COMMANDS = [
    f"{ROBOT}/{name}_position_controller/command"
    for name in ("gantry", "joint1", "joint2", "joint3", "joint5", "joint6")
]


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


def paused_in_lockstep(launch):
    """The ARAS robot in a paused simulation."""
    return launch(
        "aras_visual_servo_gazebo",
        "aras_visual_servo.launch",
        nodes=["/gazebo"],
        paused=True,
        speed_mode="lockstep",
    )


def run_once(launch, collect, master) -> tuple[list[str], list[str]]:
    """Image hashes and joint states of the first frames of a closed loop."""
    robot = paused_in_lockstep(launch)
    nodes = launch(
        "aras_visual_servo_gazebo",
        "aras_visual_servo_nodes.launch",
        nodes=[f"{ROBOT}_camera", f"{ROBOT}_controller"],
        start="[0.05, 0.02, 0.1, -0.05, -0.05, 0.1]",
    )
    wait_for(all_running, 40.0, "seven running controllers")
    images = collect("/labrob/camera/image_raw", Image)
    states = collect(f"{ROBOT}/joint_states", JointState)
    wait_for(
        lambda: (
            {("i", topic) for topic in COMMANDS} <= connections(master, "/gazebo")
            and {("i", "/labrob/camera/image_raw"), ("i", "/labrob/camera/camera_info")}
            <= connections(master, f"{ROBOT}_camera")
            and {("i", f"{ROBOT}/joint_states"), ("i", f"{ROBOT}/camera/moments")}
            <= connections(master, f"{ROBOT}_controller")
            and ("o", "/labrob/camera/image_raw") in connections(master, "/gazebo")
        ),
        20.0,
        "all nodes to be connected",
    )
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


def test_silence_is_named_once_and_time_goes_on(launch, collect, ros_node):
    rospy.set_param("/gazebo/lockstep_topics", ["/answers", "/nobody/answers"])
    rospy.set_param("/gazebo/lockstep_period", 0.05)
    rospy.set_param("/gazebo/lockstep_timeout", 0.3)
    answers = rospy.Publisher("/answers", Float64, queue_size=1)
    world = launch(
        "aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], speed_mode="lockstep"
    )
    wait_for(lambda: "lockstep: after waiting" in world.output(), 10.0, "the line about who is "
                                                                        "silent")
    line = next(line for line in world.output().splitlines() if "lockstep: after waiting" in line)
    assert f"/answers (published by {rospy.get_name()})" in line
    assert "/nobody/answers (no publisher)" in line
    clock = collect("/clock", Clock)
    clock.wait(100, 10.0)  # it goes on without them
    answers.publish(0.0)  # heard again: time waits for the next message, and a pause gets through
    wait_for(lambda: world.output().count("lockstep: after waiting") == 2, 10.0, "the next silence")
    assert "/nobody" not in world.output().split("lockstep: after waiting")[2]
    call("/gazebo/pause_physics", Empty)
    answers.unregister()
    # Who waits for an answer when the node is interrupted gets one.
    said: list[object] = []
    asking = threading.Thread(target=lambda: said.append(
        call("/gazebo/step_world", StepWorld, 1_000_000)))
    asking.start()
    clock.clear()
    clock.wait(10, 10.0)  # it is at it
    world.stop()  # its parameters go with it
    asking.join(5.0)
    assert not said[0].success and "shutting down" in said[0].status_message


def test_a_recorder_that_stands_still_for_a_while_loses_no_image(
    launch, collect, ros_node, ros_master, tmp_path
):
    """Time goes as fast as the machine allows, 60 images of 0.2 MB and more a second."""
    rospy.set_param("/gazebo/lockstep_timeout", 3.0)
    rospy.set_param("/gazebo/lockstep_topics", ["/nobody"])
    robot = paused_in_lockstep(launch)
    bag = tmp_path / "run.bag"
    recorder = subprocess.Popen(
        ["rosbag", "record", "--buffsize=0", f"--output-name={bag}", "/labrob/camera/image_raw",
         "__name:=recorder"],
        env=ros_master.environment,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    try:
        wait_for(
            lambda: ("o", "/labrob/camera/image_raw") in connections(ros_master, "/gazebo"),
            20.0,
            "the recorder",
        )
        clock = collect("/clock", Clock)
        wait_for(clock.connected, 5.0, "the clock")
        call("/gazebo/unpause_physics", Empty)

        def goes_on(seconds: float) -> None:
            end = (clock.messages[-1].clock.to_sec() if clock.messages else 0.0) + seconds
            clock.wait(timeout=60.0, where=lambda m: m.clock.to_sec() >= end)

        goes_on(0.5)
        os.killpg(recorder.pid, signal.SIGSTOP)
        time.sleep(1.5)  # below lockstep_timeout: time waits
        os.killpg(recorder.pid, signal.SIGCONT)
        goes_on(0.5)
        call("/gazebo/pause_physics", Empty)
        # When it is told to end, it reads no more of what has been sent to it.
        sizes = []

        def written() -> bool:
            sizes.append(bag.with_suffix(".bag.active").stat().st_size)
            return len(sizes) > 25 and len(set(sizes[-25:])) == 1

        wait_for(written, 20.0, "the recorder to have written")
        last = clock.messages[-1].clock.to_nsec()  # which may come after the pause's answer
    finally:
        os.killpg(recorder.pid, signal.SIGINT)
        recorder.wait(30.0)
    wait_for(bag.exists, 20.0, "the bag to be closed")
    with rosbag.Bag(str(bag)) as recorded:
        stamps = [m.header.stamp.to_nsec() for _, m, _ in recorded.read_messages()]
    assert last > 1.6e9, "its buffers were not filled"
    assert stamps == [round(k * 1e9 / 30) for k in range(1, round(last * 30e-9) + 1)][: len(stamps)]
    assert len(stamps) >= last * 30e-9 - 2
    assert "to read /labrob" not in robot.output()
    robot.stop()
