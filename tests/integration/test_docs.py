"""Documentation pages on a graph: user-defined schemes, a model, and commands as printed."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from aras_visual_servo_controller.msg import ServoReport, ServoState
from gazebo_calls import time_goes_on
from ros_graph import wait_for
from sensor_msgs.msg import JointState

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "docs"))
from blocks import ROOT, Block, blocks  # noqa: E402

ASKS = {"rosservice", "rostopic"}
EXAMPLES = ROOT / "docs" / "examples"
SPACE = "/aras_visual_servo"
ARM = Arm.from_urdf(
    (ROOT / "src/aras_visual_servo_gazebo/robots/aras_visual_servo.urdf").read_text()
)
GOAL = Goal.load(ROOT / "src/aras_visual_servo_controller/config/goal_2016.yaml")
AWAY = np.array([-0.1, 0.0, 0.349, -0.262, -0.0873, 0.1745])


def page(name: str) -> list[Block]:
    return blocks(ROOT / "docs" / f"{name}.md")


def commands(name: str) -> list[list[str]]:
    return [words for block in page(name) if block.language == "bash" for words in block.commands()]


def arguments(name: str, file: str, folder: Path) -> dict[str, str]:
    """Return the arguments that a page passes to roslaunch for a file."""
    words = next(words for words in commands(name) if file in words)
    given = (word.replace("$PWD", str(folder)).split(":=", 1) for word in words if ":=" in word)
    return dict(given)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("first_hour")


@pytest.fixture(scope="module")
def robot(launch, ros_node, ros_master, folder):
    """The whole machine; nodes find what a user has written, and the examples."""
    patch = pytest.MonkeyPatch()
    patch.syspath_prepend(str(EXAMPLES))
    paths = (str(folder), str(EXAMPLES), ros_master.environment["PYTHONPATH"])
    patch.setitem(ros_master.environment, "PYTHONPATH", os.pathsep.join(paths))
    patch.chdir(folder)
    yield launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
                 paused=True)  # fmt: skip
    patch.undo()


def test_a_users_scheme_servoes_by_one_launch_argument(robot, launch, collect, tmp_path):
    """One of docs/examples, to the goal that the runner taught for it
    (`unit/bench/test_user_schemes_run.py` runs all four there, unchanged)."""
    scheme, reached = "joint_mpc:JointMPC", GOAL.get_joints(ARM.names)
    start = tuple((reached + 0.4 * (AWAY - reached)).tolist())
    goal = assemble(Experiment(scheme=scheme, start=start, goal="2016")).goal
    (tmp_path / "goal.yaml").write_text(goal.to_yaml("for a test"))
    states = collect(f"{SPACE}/controller/state", ServoState)
    joints = collect(f"{SPACE}/joint_states", JointState)
    nodes = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch", scheme=scheme,
        nodes=[f"{SPACE}_controller"], start=str(list(start)), goal=str(tmp_path / "goal.yaml"),
    )  # fmt: skip
    try:
        with time_goes_on():
            states.wait(timeout=60.0, where=lambda state: state.phase == "converged")
    finally:
        print([(m.phase, m.reason) for m in states.messages[-1:]], nodes.output()[-1500:])
        nodes.interrupt()  # the robot's parameters stay
    wait_for(lambda: joints.messages, 5.0, "joint states")
    last = joints.messages[-1]
    distance, angle = pose_difference(
        goal.world_T_camera, ARM.pose(ARM.read_joints(last.name, last.position).positions)
    )
    assert distance < 1e-3 and angle < np.radians(0.6)
    assert all(state.scheme == scheme for state in states.messages)


def test_the_first_hour_on_a_graph(robot, folder, launch, ros_master, collect):
    for block in (*page("my_scheme"), *page("my_target")):
        if block.file:
            (folder / block.file).write_text(block.text)
    reports = collect(f"{SPACE}/controller/diagnosis", ServoReport)
    nodes = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
        nodes=["/aras_visual_servo_controller"],
        **arguments("my_scheme", "aras_visual_servo_nodes.launch", folder),
    )  # fmt: skip
    with time_goes_on():
        try:
            wait_for(
                lambda: reports.messages and reports.messages[-1].phase == "converged", 90.0,
                "a user's scheme to converge",
            )  # fmt: skip
        finally:
            print(*(getattr(reports.messages[-1], key) for key in ("phase", "outcome", "reason"))
                  if reports.messages else (nodes.log.read_text()[-2000:],))  # fmt: skip
        asked = [words for name in ("first_run", "my_target") for words in commands(name)]
        asked = [w for w in asked if w[0] in ASKS or "spawn_model" in w]
        assert len(asked) >= 5
        for words in asked:
            said = ros_master.run(words).stdout
            assert "success: False" not in said, f"{shlex.join(words)}: {said}"
    nodes.stop()
