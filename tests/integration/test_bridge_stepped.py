"""Stepped by a service while paused, two runs with the same inputs are the same to the bit."""

import hashlib

import rospy
from aras_sim_bridge.srv import StepWorld
from ros_graph import wait_for
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float64

COMMAND = "/aras_visual_servo/joint2_position_controller/command"


def run_once(launch, collect) -> tuple[list[str], list[str]]:
    """Image hashes and joint states of 0.6 s in steps of 0.1 s, J2 told to move after each."""
    robot = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"], paused=True
    )
    wait_for(lambda: "Started controllers" in robot.output(), 40.0, "the controllers")
    images = collect("/labrob/camera/image_raw", Image)
    states = collect("/aras_visual_servo/joint_states", JointState)
    publisher = rospy.Publisher(COMMAND, Float64, queue_size=1)
    for what, connected in (
        ("images", images.connected),
        ("joint states", states.connected),
        ("the command", publisher.get_num_connections),
    ):
        wait_for(connected, 10.0, what)
    step = rospy.ServiceProxy("/gazebo/step_world", StepWorld)
    for k in range(1, 7):
        answer = step(100)
        assert answer.success, answer.status_message
        assert answer.sim_time.to_nsec() == k * 100_000_000
        images.wait(count=3 * k, timeout=10.0)
        states.wait(count=10 * k, timeout=10.0)
        publisher.publish(Float64(0.02 * k))
        rospy.sleep(0.25)  # the command's way; time stands still meanwhile
    hashes = [hashlib.sha256(m.data).hexdigest() for m in images.messages]
    numbers = [
        repr((m.header.stamp.to_nsec(), m.position, m.velocity, m.effort)) for m in states.messages
    ]
    images.close()
    states.close()
    robot.stop()
    return hashes, numbers


def test_two_stepped_runs_are_bit_identical(launch, collect, ros_node):
    first = run_once(launch, collect)
    second = run_once(launch, collect)
    assert len(set(first[0])) > 10, "the camera should have moved"
    assert first == second
