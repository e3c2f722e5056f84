"""After reset_simulation, a used world continues bit-identically to an unused one."""

import pytest
from aras_robot import CONTROLLERS, ArasRobot
from recorded_values import values

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.simulation import Simulation
from aras_visual_servo_base.poses import Pose, Twist

BLOCK = """<robot name="block"><link name="link"><inertial><origin xyz="0.01 0 0.02"/>
  <mass value="0.7"/>
  <inertia ixx=".002" iyy=".003" izz=".001" ixy="0" ixz="0.0002" iyz="0"/></inertial>
  <collision name="c"><geometry><box size="0.1 0.07 0.05"/></geometry></collision>
  <visual><geometry><box size="0.1 0.07 0.05"/></geometry></visual></link>
  <link name="lid"><inertial><mass value="0.2"/>
    <inertia ixx=".001" iyy=".001" izz=".001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="link"/><child link="lid"/>
    <origin xyz="0.05 0 0.03"/><axis xyz="0 1 0"/><dynamics damping="0.02" friction="0.01"/>
    <limit lower="-1" upper="1.2" effort="3" velocity="5"/></joint>
  <gazebo reference="link"><sensor name="imu" type="imu"><update_rate>90</update_rate>
    <plugin name="i" filename="libgazebo_ros_imu_sensor.so"><topicName>imu</topicName>
    <bodyName>link</bodyName></plugin></sensor>
    <sensor name="bump" type="contact"><update_rate>70</update_rate><contact>
    <collision>c</collision></contact><plugin name="b" filename="libgazebo_ros_bumper.so">
    <bumperTopicName>bump</bumperTopicName></plugin></sensor></gazebo>
  <gazebo><plugin name="p" filename="libgazebo_ros_p3d.so"><bodyName>lid</bodyName>
    <topicName>p3d</topicName><updateRate>80</updateRate><gaussianNoise>0.01</gaussianNoise></plugin>
  </gazebo>
  <gazebo><plugin name="f" filename="libgazebo_ros_ft_sensor.so"><jointName>hinge</jointName>
    <topicName>ft</topicName><updateRate>60</updateRate></plugin></gazebo></robot>"""
LAID = Pose.from_rpy((0.35, -0.2, 0.64), (0.1, -0.2, 0.6))
GOAL = (0.05, -0.1, 0.2, -0.15, 0.1, 0.4)


def made():
    robot = ArasRobot()
    robot.block, robot.told = robot.simulation.spawn(parse_urdf(BLOCK), "block", LAID), []
    for sensor in robot.simulation.sensors:
        sensor.on_state = robot.told.append
    for camera in robot.simulation.cameras:
        camera.on_frame, camera.enabled = robot.told.append, True
    return robot


def follow(robot, count=250):
    robot.told.clear()
    robot.command(GOAL)
    way = []
    for _ in range(count):
        robot.steps(1)
        way.append((robot.model.read_joints(), robot.block.read_joints(),
                    robot.block.link_pose("lid"), robot.simulation.time_ns))  # fmt: skip
    return way, list(robot.told)


def busy(robot):
    """Driven, pushed, stopped in an emergency, put elsewhere, thrown, switched."""
    simulation = robot.simulation
    robot.command([-2.0 * q for q in GOAL])
    robot.steps(150)
    for _ in range(90):
        robot.block.apply_force("link", (3.0, -2.0, 6.0), (0.01, 0.02, 0.0), (0.1, 0.2, -0.3))
        robot.steps(1)
    robot.hardware.e_stop = True
    robot.steps(20)
    robot.hardware.e_stop = False
    simulation.set_joint_positions("aras_visual_servo", {"J1": 0.3, "gantry": -0.2})
    robot.block.set_pose(Pose.from_rpy((0.4, 0.1, 0.8), (1.0, 0.2, 0.3)))
    robot.block.set_twist(Twist((1.0, 0.0, 0.0), (0.0, 2.0, 3.0)))
    robot.steps(55)
    robot.manager.switch([], ["joint6_position_controller"])
    robot.steps(5)
    robot.manager.switch(["joint6_position_controller"], [])
    robot.command([1.5 * q for q in GOAL])
    robot.steps(123)


def test_what_comes_after_reset_simulation_knows_nothing_of_what_was_before():
    old, new = made(), made()
    for robot in (old, new):
        robot.steps(30)  # controllers run, and a picture is drawn
    busy(old)
    for robot in (old, new):
        robot.simulation.reset_simulation()
        robot.told.clear()
        robot.command(GOAL)  # set points outlive a reset
    mine, other = follow(old), follow(new)
    assert len(other[1]) > 40
    assert values(mine) == values(other)
    old.close(), new.close()
@pytest.mark.parametrize("reset", ["reset_world", "reset_simulation"])
def test_a_command_that_waited_while_all_was_reset_does_not_count(reset):
    robot = ArasRobot(interpolate=False)
    robot.steps(2)
    robot.command((0.1,) * 6)
    getattr(robot.simulation, reset)()
    robot.steps(1)
    loops = [robot.manager.get(name).loops[0] for name in CONTROLLERS.values()]
    assert [loop.make_state(0, 0.001).set_point for loop in loops] == [0.0] * 6
    robot.close()


TRANSMISSION = """<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="swing"><hardwareInterface>hardware_interface/PositionJointInterface</hardwareInterface>
</joint><actuator name="m"/></transmission>
<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo>"""
GAINS = {"gazebo_ros_control": {
    "pid_gains": {"swing": {"p": 500.0, "i": 900.0, "d": 20.0, "i_clamp": 50.0}}}}


@pytest.mark.parametrize("parameters", [{}, GAINS])
def test_a_position_joint_stays_where_it_is_spawned_put_and_reset(make, parameters):
    """spawn_model -J and set_model_configuration had no effect: the first step went to 0."""
    pendulum = make.pendulum(kind="revolute").replace("</robot>", TRANSMISSION + "</robot>")
    simulation = Simulation()
    model = simulation.spawn(parse_urdf(pendulum), "arm", parameters=parameters,
                             joint_positions={"swing": 0.7})
    for change, place in (
        (lambda: None, 0.7), (lambda: simulation.set_joint_positions("arm", {"swing": -0.4}), -0.4),
        (simulation.reset_simulation, 0.7)):
        change()
        make.step(simulation, 600)
        assert model.read_joints()[0][0] == pytest.approx(place, abs=5e-3)
    simulation.close()
