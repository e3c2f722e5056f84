"""Two robots for the tests of controllers, and their fixtures.

Robots of rails and turntables without gravity's influence stand in one paused world that the
tests step: a force F on the 2 kg cart gives it F/2 per second, and so on. Each robot has its own
namespace and controller manager. A test module that wants them writes
`pytest_plugins = ["controller_rig"]`; each such module has a world of its own.
"""

from __future__ import annotations

import os

import pytest
import rospy
from aras_sim_bridge.srv import StepWorld
from controller_manager_msgs.srv import (
    ListControllers,
    LoadController,
    SwitchController,
    UnloadController,
)
from gazebo_msgs.srv import SpawnModel
from geometry_msgs.msg import Pose
from ros_graph import wait_for
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Empty

STRICT, BEST_EFFORT = 2, 1
DT = 0.001
MASS, INERTIA = 2.0, 0.5
USER_CLASS = '''
from aras_sim_bridge.control.controllers import Controller


class Constant(Controller):
    """Pushes with a constant effort."""

    interface = "EffortJointInterface"
    EFFORT = {effort}

    def init(self, hardware, parameters, context):
        super().init(hardware, parameters, context)
        self.joints = (parameters["joint"],)
        self._handle = self.take_handle(hardware, parameters["joint"])

    def update(self, time_ns, period):
        self._handle.effort_command = self.EFFORT
'''


def joint(name: str, kind: str, interface: str, limit: str = "") -> str:
    """Return a rail or a turntable on the base; gravity does not act along its motion."""
    axis = "1 0 0" if kind == "prismatic" else "0 0 1"
    return f"""
  <joint name="{name}" type="{kind}"><parent link="base"/><child link="{name}_link"/>
    <origin xyz="0 0 1"/><axis xyz="{axis}"/>
    <limit {limit} effort="100" velocity="20"/></joint>
  <link name="{name}_link"><inertial><mass value="{MASS}"/>
    <inertia ixx="1" iyy="1" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <transmission name="{name}_transmission"><type>transmission_interface/SimpleTransmission</type>
    <joint name="{name}"><hardwareInterface>hardware_interface/{interface}</hardwareInterface>
    </joint><actuator name="{name}_motor"/></transmission>"""


def robot_xml(namespace: str) -> str:
    """Return the test robot, with its control plugin in `namespace`."""
    rail = 'lower="-1" upper="1"'
    return (
        '<robot name="rig"><link name="world"/><link name="base"/><joint name="stand" type="fixed">'
        '<parent link="world"/><child link="base"/></joint>'
        + joint("cart", "prismatic", "EffortJointInterface", rail)
        + joint("table", "continuous", "EffortJointInterface")
        + joint("slide", "prismatic", "PositionJointInterface", rail)
        + joint("wheel", "continuous", "VelocityJointInterface")
        + joint("servo", "revolute", "PositionJointInterface", 'lower="-2" upper="2"')
        + '<gazebo><plugin name="control" filename="libgazebo_ros_control.so">'
        f"<robotNamespace>{namespace}</robotNamespace><eStopTopic>e_stop</eStopTopic>"
        "</plugin></gazebo></robot>"
    )


PARAMETERS = {
    "joint_limits": {"slide": {"has_velocity_limits": True, "max_velocity": 2.0}},
    "gazebo_ros_control": {
        "pid_gains": {"servo": {"p": 40.0, "d": 8.0}},
    },
    "joint_state_controller": {
        "type": "joint_state_controller/JointStateController",
        "publish_rate": 1000.0,
        "extra_joints": [{"name": "dummy", "position": 0.5, "velocity": 0.0, "effort": 0.0}],
    },
    "push": {"type": "effort_controllers/JointEffortController", "joint": "cart"},
    "spin": {
        "type": "effort_controllers/JointVelocityController",
        "joint": "table",
        "pid": {"p": 2.0},
    },
    "turn": {
        "type": "effort_controllers/JointPositionController",
        "joint": "table",
        "pid": {"p": 20.0, "d": 4.0, "publish_state": True},
    },
    "slide_to": {"type": "position_controllers/JointPositionController", "joint": "slide"},
    "roll": {"type": "velocity_controllers/JointVelocityController", "joint": "wheel"},
    "efforts": {
        "type": "effort_controllers/JointGroupEffortController",
        "joints": ["table", "cart"],
    },
    "path": {
        "type": "position_controllers/JointTrajectoryController",
        "joints": ["slide", "servo"],
        "constraints": {"goal_time": 0.5, "servo": {"goal": 0.05}},
    },
    "mine": {"type": "my_robot/Constant", "joint": "cart"},
    "mine_too": {"type": "my_controllers:Constant", "joint": "cart"},
    "controller_classes": {"my_robot/Constant": "my_controllers:Constant"},
}


def call(name: str, service: type, *args: object, **fields: object) -> object:
    """Wait for a service, and call it."""
    rospy.wait_for_service(name, 20.0)
    return rospy.ServiceProxy(name, service)(*args, **fields)


def step(count: int) -> int:
    """Make steps; return the simulated time after them, ns."""
    answer = call("/gazebo/step_world", StepWorld, count)
    assert answer.success, answer.status_message
    return answer.sim_time.to_nsec()


class Rig:
    """One of the robots, with methods for the tests."""

    def __init__(self, namespace: str, collect) -> None:
        self.namespace = namespace
        self.manager = f"{namespace}/controller_manager"
        self.states_heard = collect(f"{namespace}/joint_states", JointState)
        self._publishers: dict[str, rospy.Publisher] = {}

    def load(self, *names: str) -> None:
        for name in names:
            assert call(f"{self.manager}/load_controller", LoadController, name).ok, name

    def switch(self, start=(), stop=(), strictness: int = STRICT) -> bool:
        request = [list(start), list(stop), strictness, False, 0.0]
        return call(f"{self.manager}/switch_controller", SwitchController, *request).ok

    def start(self, *names: str) -> None:
        self.load(*names)
        assert self.switch(names)

    def states(self) -> dict[str, str]:
        infos = call(f"{self.manager}/list_controllers", ListControllers).controller
        return {info.name: info.state for info in infos}

    def clear(self) -> None:
        """Stop and unload all controllers except the joint state controller."""
        names = [n for n in self.states() if n != "joint_state_controller"]
        self.switch([], names, BEST_EFFORT)
        for name in names:
            assert call(f"{self.manager}/unload_controller", UnloadController, name).ok
        for publisher in self._publishers.values():
            publisher.unregister()
        self._publishers.clear()

    def publisher(self, topic: str, message: type) -> rospy.Publisher:
        name = f"{self.namespace}/{topic}"
        if name not in self._publishers:
            self._publishers[name] = rospy.Publisher(name, message, queue_size=10)
            wait_for(self._publishers[name].get_num_connections, 5.0, f"subscriber of {name}")
        return self._publishers[name]

    def send(self, controller: str, value: float) -> None:
        self.publisher(f"{controller}/command", Float64).publish(Float64(value))

    def at(self, time_ns: int) -> JointState:
        """Return the joint states of that time."""
        return self.states_heard.wait(1, 5.0, where=lambda m: m.header.stamp.to_nsec() == time_ns)

    def hear(self) -> None:
        """Wait until joint states arrive from a new publisher."""

        def heard() -> bool:
            time_ns = step(1)
            return any(m.header.stamp.to_nsec() == time_ns for m in self.states_heard.messages)

        wait_for(heard, 5.0, "joint states", interval=0.1)

    def see(self, name: str, field: str = "position", steps: int = 1) -> float:
        """Return a joint's state after this number of steps, as read before the last of them."""
        message = self.at(step(steps))
        return getattr(message, field)[message.name.index(name)]

    def until(self, name: str, field: str, fits) -> float:
        """Step until a joint's state satisfies the condition; return the state."""
        return wait_for(lambda: [v for v in [self.see(name, field)] if fits(v)], 5.0, name)[0]


@pytest.fixture(scope="module")
def rig_world(launch, ros_master, ros_node, tmp_path_factory):
    """Start an empty paused world with the two robots; a user's module is on Python's path."""
    modules = tmp_path_factory.mktemp("modules")
    (modules / "my_controllers.py").write_text(USER_CLASS.format(effort=4.0))
    before = ros_master.environment.get("PYTHONPATH", "")
    ros_master.environment["PYTHONPATH"] = f"{modules}{os.pathsep}{before}"
    launched = launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True)
    ros_master.environment["PYTHONPATH"] = before
    rospy.set_param("/robot_description", robot_xml("/rig"))
    for name, x in (("rig", 0.0), ("other", 10.0)):
        rospy.set_param(f"/{name}", PARAMETERS)
        pose = Pose()
        pose.position.x = x
        answer = call(
            "/gazebo/spawn_urdf_model", SpawnModel, name, robot_xml(f"/{name}"), "/", pose, ""
        )
        assert answer.success, answer.status_message
        manager = f"/{name}/controller_manager"
        assert call(f"{manager}/load_controller", LoadController, "joint_state_controller").ok
        request = [["joint_state_controller"], [], STRICT, False, 0.0]
        assert call(f"{manager}/switch_controller", SwitchController, *request).ok
    launched.modules = modules
    return launched


@pytest.fixture
def rig(rig_world, collect):
    """The first robot, at rest at zero, with only its joint state controller."""
    call("/gazebo/reset_simulation", Empty)
    robot = Rig("/rig", collect)
    wait_for(robot.states_heard.connected, 5.0, "joint states")
    yield robot
    robot.clear()


@pytest.fixture
def other(rig_world, collect):
    """The second robot."""
    robot = Rig("/other", collect)
    wait_for(robot.states_heard.connected, 5.0, "joint states")
    yield robot
    robot.clear()
