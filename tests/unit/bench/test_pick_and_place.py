"""A movable box under a target (the gallery shows that it can be grasped and put down)."""

import importlib.util
from pathlib import Path

import pytest

from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble

EXAMPLE = Path(__file__).resolve().parents[3] / "docs" / "examples" / "pick_and_place.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("pick_and_place", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def robot(example, tmp_path_factory):
    return example.with_gripper(tmp_path_factory.mktemp("arm"))


def test_a_goal_is_shown_by_an_arm_that_stands_where_it_is_asked_for(example, robot):
    """Its picture came 34 ms after the start, when the arm had sagged by 2.2 mm."""
    result = run(example.experiment(robot, 1).with_changes(gain=4.0, time_after_convergence=0.1))
    assert result.converged and result.verdict.is_reached
    assert result.verdict.distance < 1e-4


def test_a_hand_that_is_taken_for_the_target_is_told(example, robot):
    """The loop said converged 52 mm off: the finger, which never moves in the picture, was it."""
    wide = example.experiment(robot, 0).with_changes(camera={"horizontal_fov": 2.0})
    with pytest.raises(ExperimentError, match="another object is detected as the target"):
        assemble(wide)
