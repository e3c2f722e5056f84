"""Interface of Simulation for programs without ROS, on which the bench depends."""

import numpy as np
import pytest
from aras_robot import description, parameters

from aras_sim_bridge.errors import ControllerError, WorldError
from aras_sim_bridge.simulation import Simulation

START = {"gantry": 0.1, "J1": 0.0, "J2": 0.17, "J3": -0.09, "J5": -0.09, "J6": 0.3}


@pytest.fixture
def simulation():
    it = Simulation()
    it.spawn(description(), "arm", namespace="/arm", parameters=parameters(), joint_positions=START)
    yield it
    it.close()


def test_cameras_are_found_and_unknown_names_are_refused(make, simulation):
    camera = simulation.camera("/labrob/camera")
    frames = []
    camera.on_frame, camera.enabled = frames.append, True
    make.step(simulation, 101)
    assert [frame.stamp_ns for frame in frames] == [33_333_333, 66_666_667, 100_000_000]
    assert frames[0].image.shape == (240, 320, 3)
    assert camera.parent_T_optical.shape == (4, 4)
    with pytest.raises(WorldError, match="labrob/camera"):
        simulation.camera("labrob/camra")
    robot = simulation.robots["arm"]
    with pytest.raises(ControllerError, match="elbow"):
        robot.start(["elbow"])
    robot.start(["joint1_position_controller"])
    with pytest.raises(ControllerError, match="joint2_position_controller"):
        robot.command("joint2_position_controller", 0.0)
    with pytest.raises(ControllerError, match="not finite"):
        robot.command("joint1_position_controller", np.nan)
