"""Robots of a public registry as they are shipped, meshes and all: a UR5 in a namespace of its own,
a Panda with its hand, and TIAGo, which drives, in the root namespace."""

import math
import os
import sysconfig
from pathlib import Path

import actionlib
import pytest
import rospy
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from gazebo_calls import at, call, place, spawn
from gazebo_msgs.srv import DeleteModel, GetPhysicsProperties
from ros_graph import wait_for
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Empty
from trajectory_msgs.msg import JointTrajectoryPoint

REGISTRY = "example-robot-data"  # what its descriptions call it; its manifest has another name
ROBOTS = Path(sysconfig.get_paths()["purelib"], "cmeel.prefix/share", REGISTRY, "robots")
UR5 = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
       "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]  # fmt: skip
PANDA = [f"panda_joint{k}" for k in range(1, 8)]
FINGER = "panda_finger_joint1"
# A damping d acts by the velocity of the step before: it rings where d dt is about the inertia.
EFFORT_GAINS = {
    joint: {"p": p, "d": d}
    for joint, p, d in zip(
        PANDA,
        (1000.0, 6000.0, 1000.0, 6000.0, 300.0, 300.0, 300.0),
        (15.0, 150.0, 10.0, 60.0, 3.0, 3.0, 2.0),
        strict=True)}
WHEELS = ["wheel_left_joint", "wheel_right_joint"]
WHEEL_RADIUS = 0.0985  # m, of TIAGo
STATES = {"type": "joint_state_controller/JointStateController", "publish_rate": 100}
CAMERA = """
<link name="eye"/><joint name="eye_mount" type="fixed"><parent link="PARENT"/><child link="eye"/>
  <origin xyz="0 0 0.02" rpy="0 -1.5708 0"/></joint>
<gazebo reference="eye"><sensor type="camera" name="eye"><update_rate>20</update_rate>
  <camera><horizontal_fov>1.2</horizontal_fov><image><width>96</width><height>64</height>
  <format>R8G8B8</format></image><clip><near>0.02</near><far>50</far></clip></camera>
  <plugin name="eye" filename="libgazebo_ros_camera.so"><cameraName>eye</cameraName>
  <imageTopicName>image_raw</imageTopicName><cameraInfoTopicName>camera_info</cameraInfoTopicName>
  <frameName>eye</frameName></plugin></sensor></gazebo>"""
PLUGIN = '<gazebo><plugin name="control" filename="libgazebo_ros_control.so"/></gazebo>'


def shipped(path: str, *added: str) -> str:
    """The registry's description, with elements of ours at its end."""
    file = ROBOTS / path
    if not file.is_file():
        missing = f"{file} is missing: install the packages of requirements/developing.txt"
        (pytest.fail if os.environ.get("ARAS_REQUIRE_GRAPH") else pytest.skip)(missing)
    head, end, _ = file.read_text().rpartition("</robot>")
    return "".join((head, *added, end))


def transmission(joint: str, interface: str) -> str:
    return (
        f'<transmission name="{joint}_t"><type>transmission_interface/SimpleTransmission</type>'
        f'<joint name="{joint}"><hardwareInterface>hardware_interface/{interface}'
        f'</hardwareInterface></joint><actuator name="{joint}_m"/></transmission>')


def trajectory(interface: str, joints: list[str], **more: object) -> dict:
    """Return a controller with the tolerance that UR's own configuration has."""
    return {"type": f"{interface}_controllers/JointTrajectoryController", "joints": joints,
            "constraints": {"goal_time": 3.0, "stopped_velocity_tolerance": 0.05}, **more}


class Robot:
    """A spawned robot and the controller manager in its namespace."""

    def __init__(self, name: str, namespace: str, collect, output) -> None:
        self.name, self.namespace, self._output = name, namespace, output
        self._states = collect(f"{namespace}/joint_states", JointState)

    def spawn(self, description: str, parameters: dict, place=(0.0, 0.0, 0.0)) -> None:
        for key, value in parameters.items():
            rospy.set_param(f"{self.namespace}/{key}", value)
        spawn(self.name, description, robot_namespace=self.namespace and f"{self.namespace}/",
              initial_pose=at(*place))
        manager = f"{self.namespace}/controller_manager"
        for name in parameters:
            loaded = call(f"{manager}/load_controller", LoadController, name).ok
            assert loaded, f"{name}: {self._output()[-1500:]}"
        switch = (list(parameters), [], 2, False, 0.0)
        switched = call(f"{manager}/switch_controller", SwitchController, *switch).ok
        assert switched, self._output()[-1500:]
        running = call(f"{manager}/list_controllers", ListControllers).controller
        assert {c.name for c in running if c.state == "running"} == set(parameters)

    def joint(self, name: str, field: str = "position") -> float:
        last = self._states.messages[-1]
        return getattr(last, field)[last.name.index(name)]

    def follows(self, controller: str, joints: list[str], goal: list[float]) -> None:
        """The trajectory action takes them there, and says so."""
        client = actionlib.SimpleActionClient(
            f"{self.namespace}/{controller}/follow_joint_trajectory", FollowJointTrajectoryAction)
        # the action's own wait_for_server sleeps in simulated time, which this process has not
        wait_for(lambda: client.wait_for_server(rospy.Duration(0.1)), 20.0, f"{controller} to act")
        wanted = FollowJointTrajectoryGoal()
        wanted.trajectory.joint_names = joints
        point = JointTrajectoryPoint(positions=goal, time_from_start=rospy.Duration(0.8))
        wanted.trajectory.points = [point]
        client.send_goal(wanted)
        wait_for(lambda: client.get_state() > actionlib.GoalStatus.ACTIVE, 20.0,
                 f"{self.namespace}/{controller} to end")  # fmt: skip
        assert client.get_state() == actionlib.GoalStatus.SUCCEEDED, (
            client.get_result(), self._states.messages[-1])
        # The result and the joints' states come over connections of their own: either may be first.
        there = pytest.approx(goal, abs=0.05)
        wait_for(lambda: [self.joint(joint) for joint in joints] == there, 20.0,
                 f"{joints} to be at {goal}")  # fmt: skip

    def sends(self, controller: str, message) -> None:
        publisher = rospy.Publisher(f"{self.namespace}/{controller}/command", type(message),
                                    queue_size=1)
        wait_for(publisher.get_num_connections, 10.0, f"{controller} listens")
        publisher.publish(message)


@pytest.fixture(scope="module", autouse=True)
def world(launch, ros_master, ros_node, tmp_path_factory):
    """An empty world; the registry is a package on ROS's path."""
    package = tmp_path_factory.mktemp("packages") / REGISTRY
    package.mkdir()
    (package / "package.xml").write_text(f"<package><name>{REGISTRY}</name></package>")
    (package / "robots").symlink_to(ROBOTS)
    before = ros_master.environment["ROS_PACKAGE_PATH"]
    ros_master.environment["ROS_PACKAGE_PATH"] = f"{before}{os.pathsep}{package.parent}"
    launched = launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"])
    ros_master.environment["ROS_PACKAGE_PATH"] = before
    return launched


@pytest.fixture
def robot(world, collect):
    """Factory: `robot(name, namespace)` → Robot; its model is deleted at the end of the test."""
    made: list[Robot] = []

    def make(name: str, namespace: str) -> Robot:
        made.append(Robot(name, namespace, collect, world.output))
        return made[-1]

    yield make
    for one in made:
        call("/gazebo/delete_model", DeleteModel, one.name)
    if call("/gazebo/get_physics_properties", GetPhysicsProperties).pause:
        # Something diverged, and simulated time stands still: the next robot finds it going on.
        call("/gazebo/reset_simulation", Empty)
        call("/gazebo/unpause_physics", Empty)


def test_ur5(robot, collect):
    """Position interface; the plugin names no namespace, so it is the one of the spawn."""
    namespace = "/left"
    arm = robot("ur5", namespace)
    images = collect(f"{namespace}/eye/image_raw", Image)
    infos = collect(f"{namespace}/eye/camera_info", CameraInfo)
    text = shipped("ur_description/urdf/ur5_robot.urdf", CAMERA.replace("PARENT", "tool0"))
    arm.spawn(text, {
        "joint_state_controller": STATES, "arm_controller": trajectory("position", UR5)})
    arm.follows("arm_controller", UR5, [0.3, -1.2, 1.2, -1.6, -1.57, 0.5])
    # looking down by then: not only at the sky
    image = images.wait(1, 10.0, where=lambda m: len(set(m.data)) > 1)
    assert (image.width, image.height, infos.wait(1, 10.0).width) == (96, 64, 96)


def test_panda_and_its_gripper(robot):
    """The fingers by an effort PID; the second mimics the first."""
    panda = robot("panda", "/panda")
    text = shipped(
        "panda_description/urdf/panda.urdf",
        *(transmission(joint, "EffortJointInterface") for joint in (*PANDA, FINGER)), PLUGIN,
        '<link name="world"/><joint name="foot" type="fixed"><parent link="world"/>'
        '<child link="panda_link0"/></joint>')
    panda.spawn(text, {
        "joint_state_controller": STATES,
        "arm": trajectory("effort", PANDA, gains=EFFORT_GAINS),
        "hand": {"type": "effort_controllers/JointPositionController", "joint": FINGER,
                 "pid": {"p": 300.0, "d": 30.0, "i": 20.0, "i_clamp": 5.0}}})
    panda.follows("arm", PANDA, [0.2, -0.3, 0.1, -1.8, 0.1, 1.6, 0.6])
    panda.sends("hand", Float64(0.03))
    wait_for(lambda: abs(panda.joint(FINGER) - 0.03) < 1.5e-3, 10.0, "the finger opens")


def test_tiago_drives_and_moves_its_arm(robot):
    """Shipped for PAL's own Gazebo plugins, several interfaces a joint, in the root namespace."""
    tiago = robot("tiago", "")
    arm = [f"arm_{k}_joint" for k in range(1, 5)]
    tiago.spawn(shipped("tiago_description/robots/tiago.urdf"), {
        "joint_state_controller": STATES,
        "base": {"type": "velocity_controllers/JointGroupVelocityController", "joints": WHEELS},
        "arm": trajectory("position", arm),
        "thumb": {"type": "position_controllers/JointPositionController",
                  "joint": "hand_thumb_joint"},
    }, (0.0, 0.0, 0.005))  # fmt: skip

    tiago.follows("arm", arm, [0.4, -0.4, -1.0, 1.0])
    tiago.sends("thumb", Float64(1.0))
    wait_for(lambda: abs(tiago.joint("hand_thumb_joint") - 1.0) < 0.02, 10.0, "the thumb bends")
    before, turned = place("tiago"), [tiago.joint(wheel) for wheel in WHEELS]
    tiago.sends("base", Float64MultiArray(data=[4.0, 4.0]))
    wait_for(lambda: place("tiago")[0] - before[0] > 0.4, 20.0, "it drives")
    tiago.sends("base", Float64MultiArray(data=[0.0, 0.0]))
    wait_for(lambda: abs(tiago.joint(WHEELS[0], "velocity")) < 0.01, 10.0, "it stops")
    after = place("tiago")
    rolled = [tiago.joint(w) - t for w, t in zip(WHEELS, turned, strict=True)]
    way = math.dist(after[:2], before[:2])
    assert way == pytest.approx(WHEEL_RADIUS * sum(rolled) / 2, rel=0.05), "it does not slip"
    assert abs(after[2] - before[2]) < 0.01
