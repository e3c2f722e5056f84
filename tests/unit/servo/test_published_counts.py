"""The published figures of ViSP's four-point tutorials, on a free camera: shared protocols, 1.

lagadic/visp, tutorial-ibvs-4pts-plotter*.cpp: a square of 0.2 m, goal 0.75 m before it, sampled
every 40 ms, stop at |e|^2 < 1e-4, speed saturated as ViSP does it.
"""

import numpy as np
import pytest
from free_camera import exponential, pose

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.features import Feature
from aras_visual_servo_controller.features.points import Points
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.laws import Adaptive, ContinuousStart, Law, Proportional
from aras_visual_servo_controller.schemes import Composed
from aras_visual_servo_controller.seeing.observation import Observer

CAMERA = CameraModel(640, 480, (800.0, 0, 320.0, 0, 800.0, 240.0, 0, 0, 1))
SQUARE = 0.1 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
GOAL = pose((0.0, 0.0, 0.75), (0.0, 0.0, 0.0))
START = pose((0.15, -0.1, 1.0), np.radians((10.0, -10.0, 50.0)))
DT = 0.04


class InOrder(Points):
    """The corners of a simulated target are known by number."""

    ordered = True


def look(observer, stamp, camera_T_object):
    seen = SQUARE @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]
    plane = Plane.from_pose(camera_T_object[:3, :3], camera_T_object[:3, 3])
    return observer.of_exact(
        stamp, CAMERA, points=seen[:, :2] / seen[:, 2:], plane=plane,
        world_T_camera=np.linalg.inv(camera_T_object),
    )  # fmt: skip


def iterations(
    law: Law, interaction: str = "current", start=START, feature: Feature | None = None, dt=DT,
    most=3000,
):  # fmt: skip
    """How many motions until |e|^2 < 1e-4, and the greatest depth on the way, m."""
    scheme = Composed(feature or InOrder(), law, interaction)
    goal = Goal.teach(scheme, look(Observer(None, scheme.needs), 0.0, GOAL))
    scheme.check(goal)
    observer, camera_T_object, depth = Observer(None, scheme.needs), start, 0.0
    for count in range(most):
        depth = max(depth, camera_T_object[2, 3])
        observation = look(observer, count * dt, camera_T_object)
        decision = scheme.compute(observation, goal, count * dt)
        if (decision.error**2).sum() < 1e-4:
            return count, depth
        twist = decision.task.twist
        fastest = max(np.abs(twist[:3]).max() / 1.0, np.abs(twist[3:]).max() / np.pi * 2, 1.0)
        camera_T_object = np.linalg.inv(exponential(dt * twist / fastest)) @ camera_T_object
    return None, depth


@pytest.mark.parametrize(
    ("law", "interaction", "published"),
    [
        (Proportional(0.5), "current", 191),
        (Adaptive(4.0, 0.4, 30.0), "current", 91),
        (ContinuousStart(Adaptive(4.0, 0.4, 30.0), 4.0), "current", 98),
        (Proportional(0.5), "desired", 211),
        (Proportional(0.5), "mean", 203),
    ],
)
def test_iterations_as_published(law, interaction, published):
    assert iterations(law, interaction)[0] == published


@pytest.mark.parametrize(("turn", "depth"), [(60, 0.868), (90, 1.068), (120, 1.519)])
def test_the_camera_retreats_as_published(turn, depth):
    start = pose((0.0, 0.0, 0.75), (0.0, 0.0, np.radians(turn)))
    assert iterations(Proportional(0.5), start=start)[1] == pytest.approx(depth, abs=1e-3)


def test_in_small_steps_the_retreat_is_that_of_the_way_without_steps():
    """Z*/cos(turn/2), within half a percent at 4 ms."""
    start = pose((0.0, 0.0, 0.75), (0.0, 0.0, np.radians(120.0)))
    depth = iterations(Proportional(0.5), start=start, dt=0.004, most=900)[1]
    assert depth == pytest.approx(0.75 / np.cos(np.radians(60.0)), rel=5e-3)


@pytest.mark.parametrize(("turn", "count"), [(60, 180), (90, 197), (120, 207)])
def test_the_mean_interaction_does_not_retreat(turn, count):
    start = pose((0.0, 0.0, 0.75), (0.0, 0.0, np.radians(turn)))
    found, depth = iterations(Proportional(0.5), "mean", start)
    assert found == count
    assert depth < 0.76


def test_condition_numbers_as_published():
    scheme = Composed(InOrder(), Proportional(0.5))
    observer = Observer(None, scheme.needs)
    goal = Goal.teach(scheme, look(observer, 0.0, GOAL))
    for place, condition in ((GOAL, 118.7), (START, 102.3)):
        L = scheme.feature.measure(look(Observer(None, scheme.needs), 0.0, place), goal).L
        assert np.linalg.cond(L) == pytest.approx(condition, abs=0.05)
