"""Invalid input to the bridge: an error names it, nothing changes, the simulation continues."""

from __future__ import annotations

import math
import threading
import xmlrpc.client
from pathlib import Path

import pytest
import rosgraph
import rospy
from aras_sim_bridge.srv import StepWorld
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from gazebo_calls import call
from gazebo_msgs.msg import ModelState, ODEJointProperties
from gazebo_msgs.srv import (
    ApplyBodyWrench,
    ApplyJointEffort,
    DeleteLight,
    DeleteModel,
    GetJointProperties,
    GetLightProperties,
    GetLinkProperties,
    GetLinkState,
    GetModelProperties,
    GetModelState,
    GetPhysicsProperties,
    GetWorldProperties,
    SetJointProperties,
    SetLightProperties,
    SetLinkProperties,
    SetLinkState,
    SetModelConfiguration,
    SetModelState,
    SpawnModel,
)
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3, Wrench
from ros_graph import wait_for
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image, JointState
from std_msgs.msg import ColorRGBA
from std_srvs.srv import Empty

ARM = """<robot name="arm">
  <link name="world"/>
  <joint name="fix" type="fixed"><parent link="world"/><child link="base"/></joint>
  <link name="base"/>
  <joint name="swing" type="revolute">
    <parent link="base"/><child link="rod"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="50" velocity="10"/></joint>
  <link name="rod"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <transmission name="t"><type>transmission_interface/SimpleTransmission</type>
    <joint name="swing"><hardwareInterface>hardware_interface/EffortJointInterface
    </hardwareInterface></joint>
    <actuator name="m"><mechanicalReduction>1</mechanicalReduction></actuator></transmission>
  <gazebo><plugin name="c" filename="libgazebo_ros_control.so">
    <robotNamespace>/arm</robotNamespace></plugin></gazebo>
</robot>"""
BALL = """<robot name="ball"><link name="ball"><inertial><mass value="{mass}"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>{more}</link></robot>"""
CAMERA = """<robot name="c"><link name="world"/><gazebo reference="world">
  <sensor type="camera" name="c">
    <camera><image><width>32</width><height>24</height></image></camera>
    <plugin name="p" filename="libgazebo_ros_camera.so"><cameraName>{}</cameraName></plugin>
</sensor></gazebo></robot>"""
NAN, INF = math.nan, math.inf


def spawn(name: str, xml: str, kind: str = "urdf", **fields: object) -> object:
    request = {"model_name": name, "model_xml": xml, **fields}
    return call(f"spawn_{kind}_model", SpawnModel, **request)


def state() -> tuple:
    """Everything that a refused request must leave as it was."""
    world = call("get_world_properties", GetWorldProperties)
    physics = call("get_physics_properties", GetPhysicsProperties)
    arm = call("get_joint_properties", GetJointProperties, "arm::swing")
    ball = call("get_model_state", GetModelState, "ball", "")
    rod = call("get_link_properties", GetLinkProperties, "arm::rod")
    light = call("get_light_properties", GetLightProperties, "sun")
    controllers = call("/arm/controller_manager/list_controllers", ListControllers).controller
    return (
        world.sim_time, tuple(world.model_names), str(physics), str(arm), str(ball.pose),
        str(ball.twist), str(rod), str(light), [(c.name, c.state) for c in controllers],
    )  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def bridge(launch, ros_node):
    """Simulation of a falling ball and an arm with two controllers, paused."""
    launched = launch(
        "aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True, speed_mode="max"
    )
    for name, kind in (
        ("hold", {"type": "effort_controllers/JointPositionController", "joint": "swing",
                  "pid": {"p": 20.0, "i": 0.0, "d": 5.0}}),
        ("joint_states", {"type": "joint_state_controller/JointStateController",
                          "publish_rate": 100}),
    ):  # fmt: skip
        rospy.set_param(f"/arm/{name}", kind)
    assert spawn("arm", ARM).success
    pose = Pose(position=Point(5.0, 0.0, 100.0))
    assert spawn("ball", BALL.format(mass=2, more=""), initial_pose=pose).success
    for name in ("hold", "joint_states"):
        assert call("/arm/controller_manager/load_controller", LoadController, name).ok
    call("/arm/controller_manager/switch_controller", SwitchController,
         ["hold", "joint_states"], [], 2, False, 0.0)  # fmt: skip
    return launched


@pytest.fixture
def unchanged(bridge):
    """The state after the test is the one before, and the simulation still steps."""
    before = state()
    yield
    assert state() == before
    time = before[0]
    assert call("step_world", StepWorld, 2).success
    after = call("get_world_properties", GetWorldProperties).sim_time
    assert after == pytest.approx(time + 0.002, abs=1e-9)


def pose_of(x: float, quat: tuple = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    return Pose(Point(x, 0.0, 0.0), Quaternion(*quat))


def wrench(x: float) -> Wrench:
    return Wrench(force=Vector3(x, 0.0, 0.0))


def link_properties(**values: float) -> dict:
    return {"link_name": "arm::rod", "mass": 1.0, "ixx": 1.0, "iyy": 1.0, "izz": 1.0, **values}


BAD_CALLS = [
    # (service, type, fields, a word that the reason holds)
    ("get_model_state", GetModelState, {"model_name": "ghost"}, "ghost"),
    ("get_model_state", GetModelState, {"model_name": ""}, "''"),
    ("get_model_state", GetModelState,
     {"model_name": "ball", "relative_entity_name": "ghost"}, "ghost"),
    ("get_model_properties", GetModelProperties, {"model_name": "ghost"}, "ghost"),
    ("get_link_state", GetLinkState, {"link_name": "ball::ghost"}, "ghost"),
    ("get_link_state", GetLinkState, {"link_name": "ball", "reference_frame": "ghost"}, "ghost"),
    ("get_link_state", GetLinkState, {"link_name": "::"}, "::"),
    ("get_link_properties", GetLinkProperties, {"link_name": ""}, "''"),
    ("get_joint_properties", GetJointProperties, {"joint_name": "arm::ghost"}, "ghost"),
    ("get_light_properties", GetLightProperties, {"light_name": "ghost"}, "ghost"),
    ("set_model_state", SetModelState, {"model_state": ModelState(model_name="ghost")}, "ghost"),
    ("set_model_state", SetModelState,
     {"model_state": ModelState(model_name="ball", reference_frame="ghost")}, "ghost"),
    ("set_model_state", SetModelState,
     {"model_state": ModelState(model_name="ball", pose=pose_of(NAN))}, "ball"),
    ("set_model_state", SetModelState,
     {"model_state": ModelState(model_name="ball", pose=pose_of(1e300))}, "ball"),
    ("set_model_state", SetModelState,
     {"model_state": ModelState(model_name="ball", pose=pose_of(0.0, (NAN, 0, 0, 1)))}, "ball"),
    ("set_model_state", SetModelState,
     {"model_state": ModelState(model_name="ball", twist=Twist(linear=Vector3(INF, 0, 0)))},
     "linear"),
    ("set_link_state", SetLinkState, {}, "''"),
    ("set_model_configuration", SetModelConfiguration, {"model_name": "ghost"}, "ghost"),
    ("set_model_configuration", SetModelConfiguration,
     {"model_name": "arm", "joint_names": ["swing"], "joint_positions": []}, "joint_positions"),
    ("set_model_configuration", SetModelConfiguration,
     {"model_name": "arm", "joint_names": ["swing"], "joint_positions": [INF]}, "inf"),
    ("set_link_properties", SetLinkProperties, link_properties(link_name="ghost"), "ghost"),
    ("set_link_properties", SetLinkProperties, link_properties(mass=-1.0), "mass"),
    ("set_link_properties", SetLinkProperties, link_properties(mass=NAN), "mass"),
    ("set_link_properties", SetLinkProperties, link_properties(mass=0.0), "mass"),
    ("set_link_properties", SetLinkProperties, link_properties(ixx=-1.0), "inertia"),
    ("set_joint_properties", SetJointProperties, {"joint_name": "ghost"}, "ghost"),
    ("set_joint_properties", SetJointProperties,
     {"joint_name": "swing", "ode_joint_config": ODEJointProperties(damping=[-1.0])}, "damping"),
    ("set_joint_properties", SetJointProperties,
     {"joint_name": "swing", "ode_joint_config": ODEJointProperties(damping=[1.0, 2.0])},
     "2 numbers"),
    ("set_joint_properties", SetJointProperties,
     {"joint_name": "swing", "ode_joint_config": ODEJointProperties(hiStop=[-2.0])}, "stop"),
    ("set_light_properties", SetLightProperties, {"light_name": "ghost"}, "ghost"),
    ("set_light_properties", SetLightProperties,
     {"light_name": "sun", "diffuse": ColorRGBA(-1, 0, 0, 1)}, "diffuse"),
    ("set_light_properties", SetLightProperties,
     {"light_name": "sun", "attenuation_constant": NAN}, "attenuation_constant"),
    ("delete_light", DeleteLight, {"light_name": "ghost"}, "ghost"),
    ("delete_model", DeleteModel, {"model_name": "ghost"}, "ghost"),
    ("apply_body_wrench", ApplyBodyWrench, {"body_name": "ghost"}, "ghost"),
    ("apply_body_wrench", ApplyBodyWrench, {"body_name": "ball", "wrench": wrench(NAN)}, "force"),
    ("apply_body_wrench", ApplyBodyWrench,
     {"body_name": "ball", "reference_frame": "ghost"}, "ghost"),
    ("apply_joint_effort", ApplyJointEffort, {"joint_name": "fix"}, "fix"),
    ("apply_joint_effort", ApplyJointEffort, {"joint_name": "swing", "effort": 1e300}, "effort"),
    ("step_world", StepWorld, {"steps": 0}, "steps"),
    ("step_world", StepWorld, {"steps": 4_000_000_000}, "steps"),
]  # fmt: skip


def test_bad_requests_are_refused_by_name(unchanged):
    for name, service, fields, word in BAD_CALLS:
        answer = call(name, service, **fields)
        assert not answer.success, (name, fields)
        assert word in answer.status_message, (name, fields, answer.status_message)


def test_names_that_are_taken_in_the_graph_cost_nobody_else_anything(bridge, collect):
    """A camera 'gazebo' has its settings where those of the physics are served."""
    assert spawn("greedy", CAMERA.format("gazebo")).success
    assert "camera 'c' is simulated, but has no topics and services: " in bridge.output()
    assert "[/gazebo/set_parameters] already registered" in bridge.output()
    for _ in range(2):
        assert spawn("modest", CAMERA.format("modest")).success
        call("unpause_physics", Empty)
        collect("/modest/image_raw", Image).wait()
        call("pause_physics", Empty)
        assert call("delete_model", DeleteModel, "modest").success
    assert call("delete_model", DeleteModel, "greedy").success
    taken = {topic for topic, _ in rospy.get_published_topics("/gazebo")}
    assert "/gazebo/image_raw" not in taken
    assert "/gazebo/parameter_updates" in taken


def test_deleted_cameras_leave_no_thread(bridge, collect):
    """rospy gives each listener of a topic with a queue a thread, which has to end with it."""
    node = xmlrpc.client.ServerProxy(rosgraph.Master("/tests").lookupNode("/gazebo"))
    tasks = Path(f"/proc/{node.getPid('/tests')[2]}/task")
    call("unpause_physics", Empty)

    def visit() -> int:
        before = len(list(tasks.iterdir()))
        assert spawn("eye", CAMERA.format("eye")).success
        kinds = {"image_raw": Image, "image_raw/compressed": CompressedImage}
        listeners = [collect(f"/eye/{topic}", kind) for topic, kind in kinds.items()]
        try:
            for listener in listeners:
                listener.wait()
        finally:
            deleted = call("delete_model", DeleteModel, "eye")
            # One whose lost connection rospy still has takes no new one to the same node.
            for listener in listeners:
                listener.close()
        assert deleted.success
        return before

    visit()  # the first listener ever brings the thread that serves the slow ones
    threads = visit()
    for _ in range(4):
        visit()
    wait_for(lambda: len(list(tasks.iterdir())) <= threads, timeout=10.0, what="threads to end")
    call("pause_physics", Empty)


def test_delete_while_controllers_run_and_resets_between(collect):
    """Eight clients at once, time running: nobody is left without an answer."""
    clock = collect("/clock", Clock)
    states = collect("/arm/joint_states", JointState)
    call("unpause_physics", Empty)
    faults: list[str] = []

    def client(index: int) -> None:
        try:
            for i in range(6):
                if index == 0:
                    call("reset_world", Empty)
                elif index == 1:
                    call("reset_simulation", Empty)
                elif index == 2:
                    name = f"visitor{i}"
                    assert spawn(name, BALL.format(mass=1, more="")).success
                    assert call("delete_model", DeleteModel, name).success
                elif index == 3:
                    switch = (["hold"], []) if i % 2 else ([], ["hold"])
                    call("/arm/controller_manager/switch_controller", SwitchController,
                         *switch, 1, False, 1.0)  # fmt: skip
                else:
                    assert call("get_model_state", GetModelState, "ball", "arm").success
        except Exception as error:
            faults.append(f"client {index}: {error!r}")

    threads = [threading.Thread(target=client, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert not faults
    states.clear()
    states.wait(3, timeout=5.0)
    assert call("delete_model", DeleteModel, "arm").success
    answer = call("get_joint_properties", GetJointProperties, "swing")
    assert not answer.success
    clock.clear()
    clock.wait(5, timeout=5.0)
    call("pause_physics", Empty)


def test_absurd_efforts_do_not_end_the_simulator():
    """1e9 N m on 1 kg m² for thousands of steps."""
    assert spawn("arm", ARM).success
    call("unpause_physics", Empty)
    huge = {"joint_name": "swing", "effort": 1e9, "duration": rospy.Duration(-1)}
    assert call("apply_joint_effort", ApplyJointEffort, **huge).success
    call("get_world_properties", GetWorldProperties)
    call("reset_simulation", Empty)
    assert call("delete_model", DeleteModel, "arm").success  # drops the effort, too
    call("pause_physics", Empty)
    call("reset_simulation", Empty)
    assert call("step_world", StepWorld, 3).success
    assert call("get_world_properties", GetWorldProperties).sim_time == pytest.approx(0.003)


def test_log_holds_no_traceback(bridge):
    assert "Traceback" not in bridge.output()
    assert "internal error" not in bridge.output()
