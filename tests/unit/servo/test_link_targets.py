"""A link of a model in a world file as the target: its shape and its pose in the simulation."""

import numpy as np
import pytest

from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.targets.geometry import PoseHistory

PLANE = "<geometry><plane><normal>0 0 1</normal></plane></geometry>"
BOX = "<geometry><box><size>{}</size></box></geometry>"
LOOKS = "<material><ambient>0.7 0.1 0.1 1</ambient><diffuse>0.7 0.1 0.1 1</diffuse></material>"
SIZE = "0.08 0.05 0.06"
WORLD = f"""<?xml version="1.0"?>
<sdf version="1.6"><world name="a">
<light name="sun" type="directional">
  <direction>-0.3 0.2 -1</direction><diffuse>0.8 0.8 0.8 1</diffuse>
</light>
<model name="ground_plane"><static>1</static><link name="link">
  <collision name="c">{PLANE}</collision><visual name="v">{PLANE}</visual></link></model>
<model name="crate"><pose>0.02 0.01 HEIGHT 0 0 0.4</pose>
  <link name="body"><pose>0 0 0 0 0 0.2</pose>
    <inertial><mass>0.5</mass>
      <inertia><ixx>0.001</ixx><iyy>0.001</iyy><izz>0.001</izz></inertia></inertial>
    <collision name="c">{BOX.format(SIZE)}</collision>
    <visual name="v">{BOX.format(SIZE)}{LOOKS}</visual></link>
  MORE
</model></world></sdf>"""
LID = f"""<link name="lid"><pose>0.3 0 0 0 0 0</pose>
  <visual name="v">{BOX.format('0.05 0.05 0.01')}</visual></link>
  <joint name="j" type="fixed"><parent>body</parent><child>lid</child></joint>"""


@pytest.fixture
def world(tmp_path):
    """Writes the world with the crate's middle at a height, m, and more in its model."""
    def written(height=0.6205, more=""):
        path = tmp_path / f"{height}.world"
        path.write_text(WORLD.replace("HEIGHT", str(height)).replace("MORE", more))
        return str(path)
    return written


def before(world, **more):
    return Experiment(**{
        "world": world, "target": {"model": "crate"}, "gain": 2.0, "duration": 10.0,
        "scheme": "moments", "controller_parameters": {"segmentation": {"method": "label"}},
        "goal": {"pose": [0.03, -0.02, 0.89, np.pi, 0.0, 0.0]}, "seed": 2,
        "start": {"height": [0.28, 0.4], "side": 0.05, "turn": 0.6, "margin": 4}, **more,
    })  # fmt: skip


def test_a_crate_of_the_world_that_falls_is_followed(world):
    """That the arm goes there, docs/solid_targets.md shows."""
    height = 0.64
    result = run(before(world(height), duration=0.6))
    first, last = (result.target.world_T_target(time) for time in (0.0, 8.0))
    assert first[:3, 3] == pytest.approx([0.02, 0.01, height], abs=1e-6)
    assert last[:3, 3] == pytest.approx([0.02, 0.01, 0.62], abs=1e-3)  # on the table
    # The root's frame is the model's own.
    assert np.arctan2(last[1, 0], last[0, 0]) == pytest.approx(0.4, abs=1e-3)
    fallen = height - last[2, 3]  # the goal falls with it
    assert result.goal_pose[2, 3] == pytest.approx(0.89 - fallen, abs=1e-5)


def test_its_pose_can_be_tracked(world):
    result = run(before(world(), scheme="model"))
    assert result.outcome.startswith("converged")
    assert result.verdict.distance < 5e-4 and result.verdict.angle < 5e-3


def test_a_course_tells_the_last_pose_before_a_time():
    course, one, other = PoseHistory(), np.eye(4), 2.0 * np.eye(4)
    assert course.find_pose(1.0) is None
    course.add(0.5, one)
    course.add(0.6, one.copy())
    course.add(0.7, other)
    assert course.find_pose(0.4) is None
    assert course.find_pose(0.5) is one and course.find_pose(0.699) is one
    assert course.find_pose(0.7) is other and course.find_pose(9.0) is other


@pytest.mark.parametrize(("target", "more", "why"), [
    ({"model": "crat"}, "", "there is no model 'crat' in world .*did you mean 'crate'"),
    ({"model": "crate", "link": "bod"}, "", "has no link 'bod' with visuals: did you mean 'body'"),
    ({"model": "crate"}, LID, "has 2 links with visuals .body, lid.; name the target's"),
    ({"model": "ground_plane"}, "", "target: ground_plane::link is not a closed surface"),
])  # fmt: skip
def test_a_link_that_is_not_there_is_named(world, target, more, why):
    with pytest.raises(ExperimentError, match=why):
        assemble(before(world(0.6205, more), target=target))


@pytest.mark.parametrize(("changes", "why"), [
    ({"world": ""}, "world is not set: set world to the path or name of the file"),
    ({"plant": "free", "world": ""}, "only plant bullet has a world"),
    ({"target": {"model": "crate", "shape": "square"}}, "has the link's shape"),
])  # fmt: skip
def test_what_a_link_cannot_be_is_said(world, changes, why):
    with pytest.raises(ExperimentError, match=why):
        before(world()).with_changes(**changes)
