"""A solid on the graph: a mesh on the launch line, and servoing to it by its pose."""

import sys
from pathlib import Path

import numpy as np
from aras_visual_servo_controller.msg import ServoState
from ros_graph import wait_for
from sensor_msgs.msg import JointState

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "camera"))

from tracking_scenes import corners_of, write_obj

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_bench.asked.assembly import assemble
from aras_visual_servo_bench.asked.experiment import Experiment

SPACE = "/aras_visual_servo"
PLACE = [0.0, 0.0, 0.5905, 0.0, 0.0, 0.3]


def test_a_mesh_on_the_launch_line_is_servoed_to_by_its_pose(launch, collect, tmp_path):
    mesh = write_obj(tmp_path / "bracket.obj", [(corners_of("bracket"), 0.6)])
    made = assemble(Experiment(target={"shape": str(mesh), "pose": PLACE}, scheme="model"))
    made.plant.close()
    (tmp_path / "goal.yaml").write_text(made.goal.to_yaml("for a test"))
    states = collect(f"{SPACE}/controller/state", ServoState)
    joints = collect(f"{SPACE}/joint_states", JointState)
    robot = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
        target=str(mesh), target_place="-x 0 -y 0 -z 0.5905 -Y 0.3",
    )  # fmt: skip
    wait_for(lambda: joints.messages, 60.0, "joint states")
    arm, goal = made.servo.arm, made.goal
    at = goal.joint_values(arm.names)
    start = at + np.array([0.02, 0.06, -0.05, 0.04, -0.05, 0.1])
    nodes = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
        nodes=["/aras_visual_servo_controller"], scheme="model", goal=tmp_path / "goal.yaml",
        start=str(start.round(5).tolist()), model=str(mesh), model_start=f"{{pose: {PLACE}}}",
    )  # fmt: skip
    try:
        states.wait(timeout=60.0, where=lambda state: state.phase == "converged")
        q = arm.sample(joints.messages[-1].name, joints.messages[-1].position).positions
        distance, angle = pose_difference(arm.pose(at), arm.pose(q))
        assert distance < 5e-4
        assert angle < np.radians(0.3)
    finally:
        print([(m.phase, m.reason) for m in states.messages[-1:]], nodes.output()[-1500:])
        nodes.stop()
        robot.stop()
