"""The four schemes of docs/examples reach the goal unchanged, selected by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from loop_rig import CAMERA, STARTS, Rig, lost, picture, the_arm, the_goal, the_servo

from aras_visual_servo_controller import FeatureObserver, Goal, JointSample, create_scheme
from aras_visual_servo_controller.laws import Proportional
from aras_visual_servo_controller.observation.observation import SEGMENTED, Need

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
NAMES = (
    "own_corners:OwnCorners", "photometric:Photometric", "second_order:SecondOrder",
    "joint_mpc:JointMPC")  # fmt: skip


@pytest.fixture(autouse=True)
def examples_to_be_found(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))


def look(observer, stamp, joints):
    """Return an observation like the camera: images if they are needed, otherwise exact features.
    """
    outline = the_goal("2016").target.compute_outline(the_arm().pose(joints.positions))
    if Need.IMAGE in observer.needs:
        return observer.observe_image(stamp, picture(outline), CAMERA, joints)
    return observer.observe_exact_features(stamp, CAMERA, joints, contour=outline)


def taught(scheme):
    """The goal of 2016 as this scheme sees it, written to a file and read again."""
    known = the_goal("2016")
    names = the_arm().names
    joints = JointSample.from_values(0.0, names, known.get_joints(names))
    seen = look(FeatureObserver(the_arm(), scheme.needs | {Need.MOMENTS}), 0.0, joints)
    goal = Goal.teach(scheme, seen, "mine.yaml", depth=known.depth)
    goal = Goal.from_mapping(yaml.safe_load(goal.to_yaml("taught")), "mine.yaml")
    return replace(goal, target=known.target)


def closed(name):
    scheme = create_scheme(name, Proportional(5.0))
    servo = the_servo(scheme=scheme, goal=taught(scheme), hold=0.5)
    return Rig(servo, STARTS["2016"], look=look)


@pytest.mark.parametrize(("name", "distance", "angle"), [
    ("own_corners:OwnCorners", 0.5e-3, 0.5), ("second_order:SecondOrder", 0.2e-3, 0.1),
    ("joint_mpc:JointMPC", 0.1e-3, 0.1),
])  # fmt: skip
def test_the_goal_is_reached(name, distance, angle):
    """Photometric needs pictures; bench/test_user_schemes_run has it."""
    rig = closed(name)
    last = rig.run(3.0)[-1]
    assert (last.phase, last.outcome) == ("converged", "converged"), last.reason
    assert rig.missed[0] < distance and rig.missed[1] < np.radians(angle)


@pytest.mark.parametrize("name", NAMES)
def test_each_is_under_sixty_lines_and_asks_for_little(name):
    lines = (EXAMPLES / f"{name.partition(':')[0]}.py").read_text().splitlines()
    assert len(lines) <= 60 and max(map(len, lines)) <= 100
    if "own_corners" in name or "photometric" in name:
        assert not create_scheme(name).needs & SEGMENTED


def test_a_scheme_with_its_own_eyes_decides_itself_what_is_valid():
    rig = closed("own_corners:OwnCorners")
    rig.look = lambda observer, t, joints: (
        replace(look(observer, t, joints), image=np.full((240, 320), 250, np.uint8))
        if 0.3 <= t < 0.5 else lost(look(observer, t, joints), "the segmentation sees nothing"))
    states = rig.run(0.8)
    assert states[0].phase == "servoing"  # the segmentation's word does not count
    assert {s.reason for s in states if 0.3 <= s.stamp < 0.5} == {
        "own_corners: no dark shape in the image"
    }
    assert states[-1].phase == "servoing"
