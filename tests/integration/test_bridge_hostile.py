"""Deleted cameras and clients that disturb each other: the simulation continues.

Requests that are refused: tests/unit/ros/test_gazebo_refusals.py.
"""

import threading
import xmlrpc.client
from pathlib import Path

import pytest
import rosgraph
import rospy
from controller_manager_msgs.srv import LoadController, SwitchController
from gazebo_calls import ARM, BRICK, EYE, call, delete, spawn, time_goes_on
from gazebo_msgs.srv import GetJointProperties, GetModelState
from ros_graph import wait_for
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image, JointState
from std_srvs.srv import Empty

CONTROLLERS = {
    "hold": {"type": "effort_controllers/JointPositionController", "joint": "swing",
             "pid": {"p": 20.0, "i": 0.0, "d": 5.0}},
    "joint_states": {"type": "joint_state_controller/JointStateController", "publish_rate": 100}}


@pytest.fixture(scope="module", autouse=True)
def bridge(launch, ros_node):
    """Simulation of a brick and an arm with two controllers, paused."""
    launched = launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True,
                      speed_mode="max")
    rospy.set_param("/arm", CONTROLLERS)
    spawn("arm", ARM)
    spawn("brick", BRICK, "sdf")
    for name in CONTROLLERS:
        assert call("/arm/controller_manager/load_controller", LoadController, name).ok
    switch(list(CONTROLLERS), [], 2)
    yield launched
    assert "Traceback" not in launched.output() and "internal error" not in launched.output()


def switch(*given: object) -> None:
    call("/arm/controller_manager/switch_controller", SwitchController, *given, False, 1.0)


def test_deleted_cameras_leave_no_thread(collect):
    """rospy gives each listener of a topic with a queue a thread, which has to end with it."""
    node = xmlrpc.client.ServerProxy(rosgraph.Master("/tests").lookupNode("/gazebo"))
    tasks = Path(f"/proc/{node.getPid('/tests')[2]}/task")

    def visit() -> int:
        before = len(list(tasks.iterdir()))
        spawn("eye", EYE)
        kinds = {"image_raw": Image, "image_raw/compressed": CompressedImage}
        listeners = [collect(f"/eye/{topic}", kind) for topic, kind in kinds.items()]
        for listener in listeners:
            listener.wait()
        delete("eye")
        # One whose lost connection rospy still has takes no new one to the same node.
        for listener in listeners:
            listener.close()
        return before

    with time_goes_on():
        visit()  # the first listener ever brings the thread that serves the slow ones
        threads = visit()
        for _ in range(4):
            visit()
        wait_for(lambda: len(list(tasks.iterdir())) <= threads, 10.0, "threads to end")


def test_delete_while_controllers_run_and_resets_between(collect):
    """Eight clients at once, time running: nobody is left without an answer."""
    clock, states = collect("/clock", Clock), collect("/arm/joint_states", JointState)
    faults: list[str] = []

    def client(index: int) -> None:
        try:
            for i in range(6):
                if index == 0:
                    call("reset_world", Empty)
                elif index == 1:
                    call("reset_simulation", Empty)
                elif index == 2:
                    spawn(f"visitor{i}", BRICK, "sdf")
                    delete(f"visitor{i}")
                elif index == 3:
                    switch(*((["hold"], []) if i % 2 else ([], ["hold"])), 1)
                else:
                    assert call("get_model_state", GetModelState, "brick", "arm").success
        except Exception as error:
            faults.append(f"client {index}: {error!r}")

    with time_goes_on():
        threads = [threading.Thread(target=client, args=(i,)) for i in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30.0)
        assert not faults
        states.clear()
        states.wait(3, timeout=5.0)
        delete("arm")
        assert not call("get_joint_properties", GetJointProperties, "swing").success
        clock.clear()
        clock.wait(5, timeout=5.0)
