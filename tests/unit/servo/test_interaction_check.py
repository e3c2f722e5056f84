"""check_interaction_matrix accepts right interaction matrices and finds wrong ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import (
    FEATURES,
    ConfigurationError,
    Feature,
    FeatureObserver,
    Need,
    ServoError,
    check_interaction_matrix,
)

EXACT = {Need.MOMENTS, Need.CONTOUR, Need.CORNERS}


def of_exact_views() -> list[str]:
    """Names of the features that one camera measures without images, of a target of any shape."""
    features = {name: FEATURES[name] for name in FEATURES if FEATURES[name].camera_count == 1}
    names = [name for name, cls in features.items() if cls.needs <= EXACT]
    return [name for name in names if name != "vanishing_points"]  # of a parallelogram alone


@pytest.mark.parametrize("name", of_exact_views())
def test_built_in_features_agree_with_their_differences(name: str) -> None:
    errors = check_interaction_matrix(FEATURES.create(name))
    assert errors.size and (errors < 1e-6).all()


class Wrong(Feature):
    """`points` with one column of one row scaled."""

    needs = frozenset((Need.CORNERS,))

    def __init__(self, row: int, column: int, factor: float) -> None:
        self.points, self.at, self.factor = FEATURES.create("points"), (row, column), factor
        self.names = tuple(f"c{i}" for i in range(12))

    def teach(self, observation):
        return self.points.teach(observation)

    def measure(self, observation, goal):
        taught = replace(goal, features={"points": goal.features[self.name]})
        found = self.points.measure(observation, taught)
        L = found.L.copy()
        L[self.at] *= self.factor
        return replace(found, L=L)

    def check(self, goal):
        self.points.check(replace(goal, features={"points": goal.features[self.name]}))


@pytest.mark.parametrize("column", range(6))
def test_a_wrong_column_is_named(column: int) -> None:
    assert check_interaction_matrix(Wrong(1, column, 1.0)).max() < 1e-6
    axis = ("vx", "vy", "vz", "wx", "wy", "wz")[column]
    row = 0 if column == 0 else 1  # dy/dt does not depend on vx
    with pytest.raises(ServoError, match=f"row 'c{row}' .* most in column {axis}: L is "):
        check_interaction_matrix(Wrong(row, column, -1.0))


def test_the_tolerance_is_relative_to_the_row() -> None:
    slightly = Wrong(2, 0, 1.01)
    with pytest.raises(ServoError, match="tolerance 0.1 %"):
        check_interaction_matrix(slightly)
    errors = check_interaction_matrix(slightly, tolerance=0.02)
    assert 0.001 < errors[2] < 0.01 and np.delete(errors, 2).max() < 1e-6


def test_a_number_that_is_not_finite_is_found() -> None:
    with pytest.raises(ServoError, match="row 'c3'"):
        check_interaction_matrix(Wrong(3, 2, float("nan")))


def test_a_feature_of_images_needs_a_function() -> None:
    with pytest.raises(ConfigurationError, match="luminance needs image: give observe"):
        check_interaction_matrix(FEATURES.create("luminance"))
    with pytest.raises(ConfigurationError, match="reads cameras by name: give observe"):
        check_interaction_matrix(FEATURES.create("stereo_points"))


def test_a_function_of_the_users_observes() -> None:
    """A larger target farther away: the steps follow the depth."""
    corners = np.array([(-3.0, -2.0), (3.0, -2.5), (3.5, 2.0), (-3.0, 2.0)])
    poses = []

    def observe(pose):
        poses.append(pose)
        points = (np.column_stack([corners, np.zeros(4)]) - pose[:3, 3]) @ pose[:3, :3]
        plane = Plane(*(-pose[2, :3] / pose[2, 3]).tolist())
        return FeatureObserver(None, frozenset((Need.CORNERS,))).observe_exact_features(
            0.0, None, world_T_camera=pose, contour=points[:, :2] / points[:, 2:],
            plane=plane,
        )  # fmt: skip

    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 20.0
    errors = check_interaction_matrix(FEATURES.create("lines"), observe, pose)
    assert errors.max() < 1e-6 and len(poses) == 14
