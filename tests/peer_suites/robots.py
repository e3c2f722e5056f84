"""Robots that replace the hardware programs of upstream's tests."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from xml.etree import ElementTree

import rospy
from gazebo_msgs.msg import ODEJointProperties
from gazebo_msgs.srv import SetJointProperties, SetModelConfiguration, SpawnModel
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray

PLUGIN = '<gazebo><plugin name="control" filename="libgazebo_ros_control.so">' \
         "<robotNamespace>/</robotNamespace></plugin></gazebo>"
TRANSMISSION = '<transmission name="{0}_drive"><type>transmission_interface/SimpleTransmission' \
               '</type><joint name="{0}">{1}</joint><actuator name="{0}_motor"/></transmission>'
INTERFACE = "<hardwareInterface>hardware_interface/{}JointInterface</hardwareInterface>"


def driven(urdf: str, joints: Mapping[str, str]) -> str:
    """The URDF with a transmission for each joint (its interface: Position, Velocity, Effort) and
    gazebo_ros_control's plug-in."""
    root = ElementTree.fromstring(urdf)
    for limit in root.iter("limit"):  # their hardware has no inertia that could need an effort
        limit.set("effort", "1e5")
    for joint, kind in joints.items():
        root.append(ElementTree.fromstring(TRANSMISSION.format(joint, INTERFACE.format(kind))))
    root.append(ElementTree.fromstring(PLUGIN))
    return ElementTree.tostring(root, encoding="unicode")


def spawn(model: str, urdf: str, positions: Mapping[str, float] = {}) -> None:  # noqa: B006
    rospy.wait_for_service("/gazebo/spawn_urdf_model", 60.0)
    answer = rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)(model_name=model,
                                                                       model_xml=urdf)
    if not answer.success:
        raise RuntimeError(answer.status_message)
    if positions:
        rospy.ServiceProxy("/gazebo/set_model_configuration", SetModelConfiguration)(
            model, "", list(positions), list(positions.values()))


def run_rrbot(positions: Mapping[str, float] = {}) -> int:  # noqa: B006
    """Run rrbot, whose joints joint1 and joint2 follow their commands at once."""
    rospy.init_node("rrbot", disable_rostime=True)
    kind = next(name for name in ("position", "velocity") for robot in ("rrbot", "rrbot_wrapping")
                if rospy.get_param(f"/{robot}_controller/type", "").startswith(name))
    simulation = subprocess.Popen(["rosrun", "aras_sim_bridge", "gazebo", "__name:=gazebo"])
    rospy.on_shutdown(simulation.terminate)
    spawn("rrbot", driven(rospy.get_param("/robot_description"),
                          dict.fromkeys(("joint1", "joint2"), kind.title())), positions)
    ready = rospy.Publisher("parameter_updated", Empty, queue_size=1)
    stop = rospy.ServiceProxy("/gazebo/set_joint_properties", SetJointProperties)

    def wall(bound: Float64) -> None:
        for joint in ("joint1", "joint2"):
            stop(joint, ODEJointProperties(hiStop=[min(bound.data, 1e3)], loStop=[-1e3]))
        ready.publish()

    rospy.Subscriber("upper_bound", Float64, wall)
    asked = {"smoothing": Float64, "smoothings": Float64MultiArray, "delay": Bool}
    for topic, kind in asked.items():
        rospy.Subscriber(topic, kind, lambda _asked: ready.publish())
    return simulation.wait()


def run_simple_bot() -> int:
    """Run simple_bot_hw, with one joint that efforts rotate, and an inertia of 1 kg m²."""
    rospy.init_node("simple_bot_hw", disable_rostime=True)
    simulation = subprocess.Popen(["rosrun", "aras_sim_bridge", "gazebo", "__name:=gazebo"])
    rospy.on_shutdown(simulation.terminate)
    root = ElementTree.fromstring(rospy.get_param("/robot_description"))
    body = next(link for link in root.iter("link") if link.get("name") == "simple_bot")
    body.append(ElementTree.fromstring(
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>"))
    spawn("simple_bot", driven(ElementTree.tostring(root, encoding="unicode"), {"joint": "Effort"}))
    return simulation.wait()


def run_dummy() -> int:
    """Run dummy_app: three resting joints, each with an effort and a velocity interface."""
    from aras_sim_bridge.control import hardware, joints
    from aras_sim_bridge.ros.runtime import node

    class TwoInterfaces(hardware.RobotHardware):
        """Joints of the effort interface that also have the velocity interface."""

        def __init__(self, *arguments: object, **named: object) -> None:
            super().__init__(*arguments, **named)
            self.interfaces[joints.VELOCITY] |= self.interfaces[joints.EFFORT]

    import aras_sim_bridge.simulation as simulation

    simulation.RobotHardware = TwoInterfaces
    names = [f"hiDOF_joint{k}" for k in (1, 2, 3)]
    links = "".join(
        f'<link name="{name}_link"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" '
        'ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="{name}" type="continuous"><parent link="world"/>'
        f'<child link="{name}_link"/><axis xyz="0 0 1"/></joint>' for name in names)
    urdf = driven(f'<robot name="dummy"><link name="world"/>{links}</robot>',
                  dict.fromkeys(names, "Effort"))
    for name in ("EffortTestController", "MyDummyController", "VelEffController",
                 "PosEffController", "PosEffOptController", "ExtensibleController",
                 "DerivedController"):
        rospy.set_param(f"/controller_classes/controller_manager_tests/{name}",
                        f"peer_controllers:{name}")
    with tempfile.NamedTemporaryFile("w", suffix=".urdf", delete=False) as file:
        file.write(urdf)
    subprocess.Popen(["rosrun", "aras_sim_bridge", "spawn_model", "-urdf", "-file", file.name,
                      "-model", "dummy"])
    return node.main()


def main(run: Callable[[], int]) -> None:
    started = time.monotonic()
    status = run()
    print(f"ended with {status} after {time.monotonic() - started:.0f} s")
    sys.exit(status)
