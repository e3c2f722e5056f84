"""Spawning, moving and resetting a robot leaves no state of earlier motions."""

import pytest
import yaml
from aras_robot import CONTROLLERS, ArasRobot

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.simulation import Simulation

PLUGIN = '<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo>'
TRANSMISSION = """<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="swing"><hardwareInterface>hardware_interface/{}</hardwareInterface></joint>
<actuator name="m"/></transmission>"""
GAINS = yaml.safe_load("{gazebo_ros_control: {pid_gains: {swing: {p: 500.0, i: 900.0, d: 20.0, "
                       "i_clamp: 50.0}}}}")


@pytest.mark.parametrize("reset", ["reset_world", "reset_simulation"])
def test_a_command_that_waited_while_all_was_reset_does_not_count(reset):
    robot = ArasRobot(interpolate=False)
    robot.steps(2)
    robot.command((0.1,) * 6)
    getattr(robot.simulation, reset)()
    robot.steps(1)
    states = [robot.manager.get(name).make_state(0, 0.001) for name in CONTROLLERS.values()]
    assert [state.set_point for state in states] == [0.0] * 6
    robot.close()


@pytest.mark.parametrize(("interface", "parameters"), [
    ("PositionJointInterface", {}), ("PositionJointInterface", GAINS),
])
def test_a_position_joint_stays_where_it_is_spawned_put_and_reset(make, interface, parameters):
    """spawn_model -J and set_model_configuration had no effect: the first step went to 0."""
    pendulum = make.pendulum(kind="revolute").replace(
        "</robot>", TRANSMISSION.format(interface) + PLUGIN + "</robot>")
    simulation = Simulation()
    model = simulation.spawn(parse_urdf(pendulum), "arm", parameters=parameters,
                             joint_positions={"swing": 0.7})

    def rests():
        for _ in range(600):
            simulation.step()
        return model.read_joints()[0][0]

    assert rests() == pytest.approx(0.7, abs=5e-3)
    simulation.set_joint_positions("arm", {"swing": -0.4})
    assert rests() == pytest.approx(-0.4, abs=5e-3)
    simulation.reset_simulation()
    assert rests() == pytest.approx(0.7, abs=5e-3)
    simulation.close()
