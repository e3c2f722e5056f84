"""Predicted stability of a physics step, compared with its behaviour."""

import numpy as np
import pytest

from aras_sim_bridge.control.stability import (
    STABILITY_BOUND,
    collect_gains,
    compute_step_eigenvalue,
    find_gain_reductions,
    find_longest_step,
    report_stability,
)
from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.simulation import Simulation, SimulationConfig

JOINTS = {"slide": "prismatic", "upper": "revolute", "lower": "revolute"}
AXES = ("1 0 0", "0 1 0", "0.6 0 0.8")
GAINS = {"slide": (900.0, 5.0), "upper": (300.0, 1.5), "lower": (40.0, 0.4)}


def transmission(joint, interface):
    return (f'<transmission name="{joint}_t"><type>transmission_interface/SimpleTransmission</type>'
            f'<joint name="{joint}"><hardwareInterface>hardware_interface/{interface}JointInterface'
            f'</hardwareInterface></joint><actuator name="{joint}_m"/></transmission>')


def arm(make, root, interface):
    """Three coupled joints; `root` 'world' is bolted down, another one is free."""
    names = ["base", *JOINTS]
    links = make.link(root, 2.0) if root != "world" else '<link name="world"/>'
    links += make.joint("stand", root, "base", "fixed") + make.link("base", 3.0)
    for i, (joint, kind) in enumerate(JOINTS.items()):
        links += make.joint(joint, names[i], joint, kind, "0 0.1 0.4", AXES[i])
        links += make.link(joint, 2.0 - 0.5 * i, "0.05 0.1 0.2", (0.05, 0.04, 0.02, 0.0, 0.0, 0.0))
        links += transmission(joint, interface)
    return (f'<robot name="arm">{links}<gazebo><plugin name="c" '
            'filename="libgazebo_ros_control.so"/></gazebo></robot>')


def parameters(way):
    """Parameters of the robot, and the controllers to start."""
    gains = {joint: {"p": p, "d": d} for joint, (p, d) in GAINS.items()}
    if way == "drive":
        return {"gazebo_ros_control": {"pid_gains": gains}}, []
    kind = f"effort_controllers/Joint{way}Controller"
    if way == "Trajectory":
        return {"way": {"type": kind, "joints": list(JOINTS), "gains": gains}}, ["way"]
    if way == "Velocity":
        gains = {joint: {"p": 20.0 * d} for joint, (_, d) in GAINS.items()}
    own = {joint: {"type": kind, "joint": joint, "pid": gains[joint]} for joint in JOINTS}
    return own, list(JOINTS)


def swung(make, way, step, root="world", seconds=3.0):
    """(h / the longest step that is told, largest speed / first speed, what is told)."""
    settings, controllers = parameters(way)
    simulation = Simulation(SimulationConfig(step, (0.0, 0.0, 0.0), ground_plane=False))
    try:
        interface = "Position" if way == "drive" else "Effort"
        simulation.spawn(parse_urdf(arm(make, root, interface)), "arm", parameters=settings)
        robot = simulation.robots["arm"]
        robot.start(controllers)
        simulation.step()
        joints = robot.model.joint_names
        P, D = collect_gains(robot.hardware, robot.manager.running, joints)
        inverse = robot.model.joints.inverse_inertia()
        told = report_stability(robot.hardware, robot.manager.running, joints,
                       robot.model.joints.inverse_inertia, step)
        assert bool(told) == (compute_step_eigenvalue(inverse, P, D, step) > STABILITY_BOUND)
        factors = find_gain_reductions(inverse, P, D, step)
        assert compute_step_eigenvalue(inverse, P / factors, D / factors, step) <= STABILITY_BOUND
        for i in np.flatnonzero(factors > 1.0):
            others = np.where(np.arange(3) == i, 1.0, factors)
            assert f"'{joints[i]}' " in told
            assert compute_step_eigenvalue(inverse, P / others, D / others, step) > STABILITY_BOUND
        longest = find_longest_step(inverse, P, D, 1.0)
        for joint in joints:
            robot.model.apply_effort(joint, 1e-4)
        speeds = []
        try:
            for _ in range(max(int(seconds / step), 20)):
                simulation.step()
                speeds.append(max(map(abs, robot.model.read_joints()[1])))
        except WorldError:
            speeds.append(np.inf)
        return step / longest, max(speeds) / speeds[0], told
    finally:
        simulation.close()


@pytest.mark.parametrize(("way", "root"), [
    ("Position", "world"), ("Trajectory", "world"), ("drive", "world"), ("Velocity", "world"),
    ("Position", "trunk")])
def test_steps_diverge_where_it_is_told_and_not_before(make, way, root, caplog):
    longest = 0.005 / swung(make, way, 0.005, root, 0.01)[0]
    assert 0.002 < longest < 0.1
    for share, diverges in ((0.95, False), (1.05, True)):
        ratio, growth, told = swung(make, way, share * longest, root)
        assert ratio == pytest.approx(share, rel=1e-3) and bool(told) == diverges
        assert growth > 1e4 if diverges else growth < 100.0
    assert f"they need {longest:.2g} s" in told
    said = [record.message for record in caplog.records if "unstable" in record.message]
    # When controllers start, in the run that diverges alone; a drive's gains need none to run.
    assert said == ([] if way == "drive" else [f"model 'arm': {told}"])
