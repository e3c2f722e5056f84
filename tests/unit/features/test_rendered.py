"""Grey moments of rendered images: L compared with the outline's and with a moved camera."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

import numpy as np
import pytest
from feature_cases import TARGET, rotation
from feature_cases import View as Pose

from aras_visual_servo_camera.features import PAPER_FEATURES, Reference
from aras_visual_servo_camera.features import compute_moment_features as compute
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.pipeline import Pipeline, PipelineSettings
from aras_visual_servo_camera.undistortion import CameraModel

rendering = pytest.importorskip("aras_sim_bridge.rendering")
description = pytest.importorskip("aras_sim_bridge.description")
bridge_world = pytest.importorskip("aras_sim_bridge.world")

K = np.array([[188.04, 0, 159.5], [0, 188.04, 119.5], [0, 0, 1]])
CAMERA = CameraModel(320, 240, tuple(K.ravel()))
THICKNESS = 2e-5  # m: the target is flat; its sides must not show


@pytest.fixture(scope="module")
def renderer() -> Iterator:
    world = bridge_world.World()

    def box(x0, x1, y0, y1, top, height, colour) -> None:
        shape = description.Geometry("box", size=(x1 - x0, y1 - y0, height))
        link = description.Link(
            "link", None, (description.Visual("visual", (0, 0, 0), (0, 0, 0), shape),)
        )
        name = f"box{len(world.models)}"
        model = description.RobotDescription(
            name, "link", {"link": link}, {}, static=True, colours={"link": colour}
        )
        place = ((x0 + x1) / 2, (y0 + y1) / 2, top - height / 2)
        world.spawn(model, name, bridge_world.Pose(place))

    # the world's z points up; the target lies in the plane z = 0, seen from above
    box(-2, 2, -2, 2, -THICKNESS, 0.1, (1, 1, 1, 1))
    box(-0.025, 0.025, -0.025, 0.025, 0, THICKNESS, (0, 0, 0, 1))
    box(0.0125, 0.0375, -0.0175, 0.0075, 0, THICKNESS, (0, 0, 0, 1))
    try:
        made = rendering.create_renderer("opengl", world)
    except Exception as error:  # noqa: BLE001 - whatever keeps this machine from drawing
        world.close()
        pytest.skip(f"no OpenGL here: {error}")
    yield made
    made.close()
    world.close()


def shown(renderer, pose: Pose) -> np.ndarray:
    """Return a grey image (240, 320) of the target at a pose of its frame."""
    optical_T_object = np.eye(4)
    optical_T_object[:3, :3], optical_T_object[:3, 3] = pose.R, pose.t
    world_T_object = np.diag([1.0, -1.0, -1.0, 1.0])  # the object's y and z point down
    view = rendering.View(
        320, 240, world_T_object @ np.linalg.inv(optical_T_object), K, 0.02, 10.0
    )
    return np.ascontiguousarray(renderer.render(view)[..., 0])


def pose(seed: int, tilt: float = 0.1) -> Pose:
    random = np.random.default_rng(seed)
    R = rotation([*random.uniform(-tilt, tilt, 2), 0]) @ rotation([0, 0, random.uniform(-pi, pi)])
    t = np.array([*random.uniform(-0.03, 0.03, 2), random.uniform(0.18, 0.3)])
    return Pose(TARGET, R, t)


def measure(grey: np.ndarray) -> Moments:
    pipeline = Pipeline(PipelineSettings())
    pipeline.set_camera(CAMERA)
    measurement = pipeline.measure(Image(grey, "mono8"))
    assert measurement.valid, measurement.reason
    return measurement.moments


def fitted_slopes(function, at: Pose, reach: float = 0.05, count: int = 91) -> np.ndarray:
    """Return the slopes (k, 6) at zero of polynomials of degree five through `count` images per
    side.

    A picture's alpha errs by 2e-4 rad; differences of two neighbours would show mostly that.
    """
    steps = np.linspace(-reach, reach, count)
    columns = []
    for axis in range(6):
        values = np.array([function(at.moved(step * np.eye(6)[axis])) for step in steps])
        columns.append(np.polynomial.polynomial.polyfit(steps / reach, values, 5)[1] / reach)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_rows_of_a_picture_are_those_of_the_outline(renderer, seed: int) -> None:
    at = pose(seed)
    reference = Reference.from_moments(Moments.from_polygon(TARGET / 0.2), 0.2)
    L = compute(measure(shown(renderer, at)), PAPER_FEATURES, at.plane, reference).L
    exact = compute(Moments.from_polygon(at.image), PAPER_FEATURES, at.plane, reference).L
    assert (np.linalg.norm(L - exact, axis=1) <= 2e-3 * np.linalg.norm(exact, axis=1)).all()


@pytest.mark.parametrize("seed", [0, 5])
def test_rows_against_a_moved_camera(renderer, seed: int) -> None:
    """L from one picture against pictures of a moved camera: within 2 % of the row's norm."""
    at = pose(seed)
    reference = Reference.from_moments(Moments.from_polygon(TARGET / 0.2), 0.2)
    result = compute(measure(shown(renderer, at)), PAPER_FEATURES, at.plane, reference)

    def values(moved: Pose) -> np.ndarray:
        s = compute(
            measure(shown(renderer, moved)), PAPER_FEATURES, moved.plane, reference
        ).values.copy()
        s[3] = result["alpha"] + (s[3] - result["alpha"] + pi / 2) % pi - pi / 2
        return s

    numeric = fitted_slopes(values, at)
    gap = np.linalg.norm(result.L - numeric, axis=1) / np.linalg.norm(numeric, axis=1)
    assert (gap <= 0.02).all(), gap
