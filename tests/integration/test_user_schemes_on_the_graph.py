"""A scheme of docs/examples on a graph, by one launch argument, to the goal that the runner taught
for it (`unit/bench/test_user_schemes_run.py` runs all four there, unchanged)."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from aras_visual_servo_controller.msg import ServoState
from ros_graph import wait_for
from sensor_msgs.msg import JointState

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_bench.asked.assembly import assemble
from aras_visual_servo_bench.asked.experiment import Experiment
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.goals.goal import Goal

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs" / "examples"
SPACE = "/aras_visual_servo"
ARM = Arm.from_urdf(
    (ROOT / "src/aras_visual_servo_gazebo/robots/aras_visual_servo.urdf").read_text()
)
GOAL = Goal.load(ROOT / "src/aras_visual_servo_controller/config/goal_2016.yaml")
AWAY = np.array([-0.1, 0.0, 0.349, -0.262, -0.0873, 0.1745])
SCHEME, PART = "joint_mpc:JointMPC", 0.4  # from which part of the way to AWAY


@pytest.fixture(scope="module")
def robot(launch, ros_node, ros_master):
    """The whole machine; nodes find the examples as in a sourced workspace that has them."""
    patch = pytest.MonkeyPatch()
    patch.syspath_prepend(str(EXAMPLES))
    before = ros_master.environment["PYTHONPATH"]
    patch.setitem(ros_master.environment, "PYTHONPATH", f"{EXAMPLES}{os.pathsep}{before}")
    yield launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"])
    patch.undo()


def test_a_users_scheme_servoes_by_one_launch_argument(robot, launch, collect, tmp_path):
    reached = GOAL.joint_values(ARM.names)
    start = tuple((reached + PART * (AWAY - reached)).tolist())
    goal = assemble(Experiment(scheme=SCHEME, start=start, goal="2016")).goal
    (tmp_path / "goal.yaml").write_text(goal.to_yaml("for a test"))
    states = collect(f"{SPACE}/controller/state", ServoState)
    joints = collect(f"{SPACE}/joint_states", JointState)
    nodes = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch", scheme=SCHEME,
        nodes=[f"{SPACE}_controller"], start=str(list(start)), goal=str(tmp_path / "goal.yaml"),
    )  # fmt: skip
    try:
        states.wait(timeout=60.0, where=lambda state: state.phase == "converged")
    finally:
        print([(m.phase, m.reason) for m in states.messages[-1:]], nodes.output()[-1500:])
        nodes.interrupt()
    wait_for(lambda: joints.messages, 5.0, "joint states")
    last = joints.messages[-1]
    distance, angle = pose_difference(
        goal.world_T_camera, ARM.pose(ARM.sample(last.name, last.position).positions)
    )
    assert distance < 1e-3 and angle < np.radians(0.6)
    assert all(state.scheme == SCHEME for state in states.messages)
