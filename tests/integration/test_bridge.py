"""The simulator on a graph, without a robot of the project: ros_control's tools, resets, clients
that disturb each other, and sensor topics.

Requests that are refused: tests/unit/ros/test_gazebo_refusals.py.
"""

import math
import signal
import subprocess
import sys
import threading
import xmlrpc.client
from pathlib import Path

import actionlib
import pytest
import rosgraph
import rospy
import yaml
from actionlib_msgs.msg import GoalStatus
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from gazebo_calls import (
    ARM,
    BRICK,
    EYE,
    INERTIA,
    at,
    call,
    delete,
    place,
    spawn,
    step,
    time_goes_on,
)
from gazebo_msgs.msg import ContactsState, LinkStates, ModelState
from gazebo_msgs.srv import (
    DeleteModel,
    GetJointProperties,
    GetModelState,
    GetWorldProperties,
    SetModelState,
)
from geometry_msgs.msg import Twist, WrenchStamped
from nav_msgs.msg import Odometry
from ros_graph import PATIENCE, wait_for
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Empty
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

CONTROLLERS = {
    "push": {"type": "effort_controllers/JointEffortController", "joint": "swing"},
    "spin": {"type": "effort_controllers/JointVelocityController", "joint": "swing",
             "pid": {"p": 2.0}},
    "hold": {"type": "effort_controllers/JointPositionController", "joint": "swing",
             "pid": {"p": 400.0, "i": 0.0, "d": 40.0}},
    "path": {"type": "effort_controllers/JointTrajectoryController", "joints": ["swing"],
             "gains": {"swing": {"p": 400.0, "d": 40.0}}},
    "joint_states": {"type": "joint_state_controller/JointStateController", "publish_rate": 100},
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

rospy.init_node("lists")
list_controllers()
print(utils.get_controller_managers("/arm"),
      [one.name for one in utils.ControllerLister("/arm/controller_manager")()])
"""


@pytest.fixture(scope="module", autouse=True)
def bridge(launch, ros_node):
    """The simulator, paused, with ground and sun."""
    rospy.set_param("/arm", CONTROLLERS)
    rospy.set_param("/truth/tf_prefix", "one")
    launched = launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True)
    yield launched
    assert "Traceback" not in launched.output() and "internal error" not in launched.output()


@pytest.fixture
def arm(bridge):
    """Robot in the namespace /arm, whose controllers are not loaded; it is deleted at the end."""
    spawn("arm", ARM, initial_pose=at(3, 0, 0))
    yield
    call("delete_model", DeleteModel, "arm")


@pytest.fixture
def eye(bridge):
    """A camera on a model; it is deleted at the end."""
    spawn("eye", EYE)
    yield
    call("delete_model", DeleteModel, "eye")


class Tool:
    """A command-line tool that stays until it is interrupted."""

    def __init__(self, master, *arguments: str) -> None:
        self._process = subprocess.Popen(["rosrun", "aras_sim_bridge", *arguments],
                                         env=master.environment)

    def interrupt(self) -> None:
        """End it as Ctrl-C does."""
        self._process.send_signal(signal.SIGINT)
        self._process.wait(timeout=20.0 * PATIENCE)


def states() -> dict[str, str]:
    infos = call("/arm/controller_manager/list_controllers", ListControllers).controller
    return {info.name: info.state for info in infos}


def switch(*given: object) -> None:
    call("/arm/controller_manager/switch_controller", SwitchController, *given, False, 1.0)


def start(*names: str) -> None:
    """Load controllers of the arm and start them."""
    for name in names:
        assert call("/arm/controller_manager/load_controller", LoadController, name).ok
    switch(names, [], 2)


def angle() -> float:
    return call("get_joint_properties", GetJointProperties, "swing").position[0]


def speed() -> float:
    return call("get_joint_properties", GetJointProperties, "swing").rate[0]


def world_properties() -> GetWorldProperties:
    return call("get_world_properties", GetWorldProperties)


def test_command_line_tools(arm, ros_master, tmp_path):
    """Their options and messages: tests/unit/ros/test_programs.py."""

    def tool(*words: str) -> str:
        return ros_master.run(["rosrun", "aras_sim_bridge", *words, "__ns:=/arm"]).stdout

    file = tmp_path / "more.yaml"
    file.write_text(yaml.safe_dump({"from_file": CONTROLLERS["joint_states"]}))
    gate = rospy.Publisher("/arm/go", Bool, queue_size=1, latch=True)
    gate.publish(False)
    waiting = Tool(ros_master, "spawner", "--namespace", "/arm", "--wait-for", "/arm/go", "push",
                   str(file))
    wait_for(gate.get_num_connections, 40.0, "the waiting spawner")
    assert states() == {}
    with time_goes_on():
        gate.publish(True)
        wait_for(lambda: states() == dict.fromkeys(("push", "from_file"), "running"), 40.0,
                 "the controllers of the spawner")  # fmt: skip
        unspawner = Tool(ros_master, "unspawner", "push", "__ns:=/arm")
        wait_for(lambda: states()["push"] == "stopped", 40.0, "the unspawner")
        unspawner.interrupt()
        wait_for(lambda: states()["push"] == "running", 40.0, "the restart")
        waiting.interrupt()
        assert states() == {}
        assert "Loaded 'push'" in tool("controller_manager", "spawn", "push")
        tool("controller_group", "switch", "two")
        assert states() == {"push": "stopped", "spin": "running"}
    listed = ros_master.run(["python3", "-c", LISTS, "__ns:=/arm"]).stdout
    assert "'spin' - 'hardware_interface::EffortJointInterface' ( running )" in listed
    assert "['/arm/controller_manager'] ['push', 'spin']" in listed
    gate.unregister()


def test_a_command_of_a_wrong_type_reaches_no_controller(arm, ros_master):
    start("push")
    # In a process of its own: rospy has one type a topic and process.
    seen = ros_master.run([sys.executable, "-c", WRONG_TYPE, "/arm/push/command"])
    assert seen.stdout.strip() == "0 connections"
    step(5)
    assert speed() == 0.0
    command = rospy.Publisher("/arm/push/command", Float64, queue_size=10)
    wait_for(command.get_num_connections, 5.0, "the controller")
    command.publish(2.0)
    wait_for(lambda: step(1) or speed() > 0.0, 5.0, "the effort")
    command.unregister()


def test_a_goal_is_cancelled_while_time_is_stopped(arm):
    start("path")
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


def test_resets_with_controllers_and_images(arm, eye, collect):
    start("hold", "joint_states")
    topics = (collect("/arm/joint_states", JointState), collect("/eye/image_raw", Image),
              collect("/eye/camera_info", CameraInfo))
    clock = collect("/clock", Clock)
    command = rospy.Publisher("/arm/hold/command", Float64, queue_size=1)
    wait_for(command.get_num_connections, timeout=5.0, what="the controller")
    for topic in (*topics, clock):
        wait_for(topic.connected, timeout=5.0, what=topic.topic)
    command.publish(0.75)
    wait_for(lambda: step(500) or abs(angle() - 0.75) < 1e-3, timeout=10.0, what="the command")
    elsewhere = ModelState("arm", at(4, 1, 1), Twist(), "")
    assert call("set_model_state", SetModelState, elsewhere).success
    time = world_properties().sim_time

    call("reset_world", Empty)  # the pose goes back; time, angles and set points stay
    assert place("arm") == pytest.approx((3, 0, 0))
    assert angle() == pytest.approx(0.75, abs=1e-3) and world_properties().sim_time == time
    step(20)  # upstream's first period would be the whole time: a kick
    assert angle() == pytest.approx(0.75, abs=1e-3)

    call("reset_simulation", Empty)  # all of it goes back; controllers go on with their set points
    assert angle() == 0.0 and world_properties().sim_time == 0.0
    for topic in (*topics, clock):
        topic.clear()
    step(30)
    for topic in topics:
        stamps = [topic.wait(i + 1).header.stamp.to_nsec() for i in range(3)]
        first = 1_000_000 if topic is topics[0] else 10_000_000  # joint_states: at the first step
        assert stamps == [first, first + 10_000_000, first + 20_000_000], topic.topic
    clock.wait(3)
    assert [m.clock.to_nsec() // 1_000_000 for m in clock.messages[:3]] == [1, 4, 8]
    assert states() == dict.fromkeys(("hold", "joint_states"), "running")
    step(1500)
    assert angle() == pytest.approx(0.75, abs=1e-3)
    command.unregister()


def test_spawn_model_script_with_its_options(ros_master, tmp_path):
    """-reference_frame, -J, -wait, -b."""
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    spawn("stand", BRICK, "sdf", initial_pose=at(0, 6, 5, math.pi / 2))
    bound = Tool(ros_master, "spawn_model", "-urdf", "-file", str(file), "-model", "arm", "-wait",
                 "late", "-reference_frame", "stand", "-x", "1", "-z", "2", "-Y", "0.5",
                 "-J", "swing", "0.25", "-b")  # fmt: skip
    try:
        step(1)
        assert "arm" not in world_properties().model_names
        spawn("late", BRICK, "sdf", initial_pose=at(9, 9, 5))

        def there() -> bool:
            step(1)  # model_states come with steps
            return call("get_joint_properties", GetJointProperties, "swing").position == (0.25,)

        wait_for(there, timeout=20.0, what="the arm", interval=0.1)
        assert place("arm")[:2] == pytest.approx((0, 7))
    finally:
        bound.interrupt()
    assert "arm" not in world_properties().model_names
    delete("stand", "late")


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


def test_clients_that_disturb_each_other(arm, collect):
    """Eight clients at once, time running: each request is answered."""
    spawn("brick", BRICK, "sdf")
    start("hold", "joint_states")
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
        delete("brick")


PLUGIN = '<plugin name="p" filename="libgazebo_ros_{}.so">{}</plugin>'
PROBE = f"""<robot name="probe"><link name="world"/>
<joint name="stand" type="fixed"><parent link="world"/><child link="base"/>
<origin xyz="0 0 2" rpy="0.5 0 0"/></joint>
<link name="base"><inertial><mass value="3"/>{INERTIA}</inertial></link>
<joint name="swing" type="continuous"><parent link="base"/><child link="tool"/>
<axis xyz="0 1 0"/></joint>
<link name="tool"><inertial><origin xyz="0.1 0 -0.3"/><mass value="2"/>{INERTIA}</inertial></link>
<gazebo reference="base"><sensor name="i" type="imu"><update_rate>200</update_rate>{PLUGIN.format(
    "imu_sensor", "<frameName>base_imu</frameName><updateRateHZ>50</updateRateHZ>"
    "<gaussianNoise>0</gaussianNoise>")}</sensor></gazebo>
<gazebo>{PLUGIN.format("p3d", "<robotNamespace>/truth</robotNamespace><bodyName>tool</bodyName>"
                       "<topicName>odom</topicName><gaussianNoise>0</gaussianNoise>")}</gazebo>
<gazebo>{PLUGIN.format("ft_sensor", "<jointName>stand</jointName><topicName>/wrist/ft</topicName>"
                       "<updateRate>25</updateRate>")}</gazebo>
<gazebo>{PLUGIN.format("gpu_laser", "")}</gazebo></robot>"""


@pytest.fixture
def probe(bridge):
    """A pendulum with a sensor of each kind; it is deleted at the end."""
    spawn("probe", PROBE)
    yield
    call("delete_model", DeleteModel, "probe")


def test_p3d_is_link_states_to_the_bit(probe, collect):
    odometry, states = collect("/truth/odom", Odometry), collect("/gazebo/link_states", LinkStates)
    wait_for(lambda: odometry.connected() and states.connected(), 10.0, "connections")
    step(20)
    last = odometry.wait(19)
    wait_for(lambda: states.messages, 10.0, "link states")
    told = states.messages[-1]
    index = told.name.index("probe::tool")
    assert odometry.messages[-1] is last
    assert (last.pose.pose, last.twist.twist) == (told.pose[index], told.twist[index])
    assert (last.header.frame_id, last.child_frame_id) == ("one/world", "tool")
    stamps = [m.header.stamp.to_nsec() for m in odometry.messages]
    assert [b - a for a, b in zip(stamps, stamps[1:], strict=False)] == [1_000_000] * 18


def test_imu_and_wrench_come_at_their_rates(bridge, probe, collect):
    assert "libgazebo_ros_gpu_laser.so' is ignored" in bridge.output()
    imus, wrenches = collect("/probe/imu_data", Imu), collect("/wrist/ft", WrenchStamped)
    wait_for(lambda: imus.connected() and wrenches.connected(), 10.0, "connections")
    call("reset_simulation", Empty)
    step(200)
    imus.wait(10)
    wrenches.wait(5)
    assert [m.header.stamp.to_nsec() // 1_000_000 for m in imus.messages] == list(
        range(20, 201, 20))
    assert [m.header.stamp.to_nsec() // 1_000_000 for m in wrenches.messages] == list(
        range(40, 201, 40))
    imu = imus.messages[-1]
    assert imu.header.frame_id == "base_imu"
    felt = imu.linear_acceleration
    assert (felt.x, felt.y, felt.z) == pytest.approx((0, 9.8 * 0.479426, 9.8 * 0.877583), abs=1e-4)
    assert wrenches.messages[-1].header.frame_id == "base"
    assert wrenches.messages[0].wrench.force.z < -9.8 * 3.0
    delete("probe")
    topics = [name for name, _ in rospy.get_published_topics()]
    assert not {"/truth/odom", "/probe/imu_data", "/wrist/ft"} & set(topics)


CRATE = f"""<robot name="crate"><link name="body"><inertial><mass value="10"/>{INERTIA}</inertial>
<collision><origin xyz="0 0 0.1"/><geometry><box size="0.4 0.3 0.2"/></geometry></collision></link>
<gazebo reference="body"><sensor name="c" type="contact"><update_rate>100</update_rate>
<contact><collision>body_collision</collision></contact>{PLUGIN.format(
    "bumper", "<robotNamespace>/feet</robotNamespace><bumperTopicName>ground</bumperTopicName>"
    "<frameName>body</frameName>")}</sensor></gazebo></robot>"""


def test_a_bumper_tells_what_the_ground_bears(collect):
    spawn("crate", CRATE)
    step(200)
    told = collect("/feet/ground", ContactsState)
    wait_for(told.connected, 10.0, "a connection")
    step(100)
    message = told.wait(10)
    (state,) = message.states
    assert (state.collision1_name, state.collision2_name) == (
        "crate::body::body_collision", "ground_plane::link::collision")
    total = state.total_wrench.force
    assert (total.x, total.y, total.z) == pytest.approx((0.0, 0.0, 98.0), abs=0.02)
    count = len(state.contact_positions)
    assert count >= 2 and count == len(state.contact_normals) == len(state.depths)
    assert sum(one.force.z for one in state.wrenches) == pytest.approx(total.z)
    assert state.info.startswith("Debug:  i:(0/1)     my geom:crate::body::body_collision   other")
    assert message.header.frame_id == "body"
    stamps = [m.header.stamp.to_nsec() for m in told.messages]
    assert [b - a for a, b in zip(stamps, stamps[1:], strict=False)] == [10_000_000] * 9
