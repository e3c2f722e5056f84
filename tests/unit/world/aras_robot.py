"""The shipped ARAS robot with its shipped controllers, without ROS."""

from pathlib import Path

import yaml

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.simulation import Simulation

SOURCES = Path(__file__).parents[3] / "src"
ROBOT = SOURCES / "aras_visual_servo_gazebo"
CONTROLLERS = {  # joint -> controller, in the order of the poses below
    "gantry": "gantry_position_controller",
    "J1": "joint1_position_controller",
    "J2": "joint2_position_controller",
    "J3": "joint3_position_controller",
    "J5": "joint5_position_controller",
    "J6": "joint6_position_controller",
}


URDF = (ROBOT / "robots/aras_visual_servo.urdf").read_text()


def description(text=URDF):
    return parse_urdf(text, lambda package: str(SOURCES / package))


def parameters():
    tree = yaml.safe_load((ROBOT / "config/aras_visual_servo_control.yaml").read_text())
    return tree.get("aras_visual_servo", tree)


class ArasRobot:
    """Simulation with the robot and its running controllers; cameras are disabled."""

    def __init__(self, simulation=None, urdf=URDF, cameras=None, interpolate=True):
        """`cameras`: as Simulation.spawn takes them; without `interpolate`, commands are steps."""
        self.simulation = simulation or Simulation()
        self.settings = parameters()
        for controller in CONTROLLERS.values():
            self.settings[controller]["interpolate"] = interpolate
        self.model = self.simulation.spawn(
            description(urdf), "aras_visual_servo", namespace="/aras_visual_servo",
            parameters=self.settings, cameras=cameras)
        robot = self.simulation.robots["aras_visual_servo"]
        self.manager, self.hardware = robot.manager, robot.hardware
        robot.start(["joint_state_controller", *CONTROLLERS.values()])

    def command(self, pose):
        for controller, position in zip(CONTROLLERS.values(), pose, strict=True):
            self.manager.get(controller).set_command(position)

    def steps(self, count):
        for _ in range(count):
            self.simulation.step()

    def positions(self):
        return dict(zip(self.model.joint_names, self.model.read_joints()[0], strict=True))

    def velocities(self):
        return dict(zip(self.model.joint_names, self.model.read_joints()[1], strict=True))

    def close(self):
        self.simulation.close()
