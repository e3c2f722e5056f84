"""check_interaction_matrix accepts correct interaction matrices and finds wrong ones."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

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
from aras_visual_servo_controller.errors import InteractionMatrixError

EXACT = {Need.MOMENTS, Need.CONTOUR, Need.CORNERS}


def of_exact_views() -> list[str]:
    """Names of the features that one camera measures without images, of a target of any shape."""
    features = {name: FEATURES[name] for name in FEATURES if FEATURES[name].camera_count == 1}
    names = [name for name, cls in features.items() if cls.needs <= EXACT]
    return [name for name in names if name != "vanishing_points"]  # of a parallelogram alone


@pytest.mark.parametrize("name", of_exact_views())
def test_built_in_features_agree_with_their_differences(name: str) -> None:
    check = check_interaction_matrix(name)
    assert check.is_correct and check.errors.size and (check.errors < 1e-6).all()
    np.testing.assert_array_equal(
        check_interaction_matrix(FEATURES.create(name)).errors, check.errors
    )


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
    assert check_interaction_matrix(Wrong(1, column, 1.0)).errors.max() < 1e-6
    axis = ("vx", "vy", "vz", "wx", "wy", "wz")[column]
    row = 0 if column == 0 else 1  # dy/dt does not depend on vx
    with pytest.raises(ServoError, match=rf"off by [\d.]+ % .*column {axis}: L is "):
        check_interaction_matrix(Wrong(row, column, -1.0))


def test_the_tolerance_is_relative_to_the_row() -> None:
    slightly = Wrong(2, 0, 1.01)
    with pytest.raises(ServoError, match="tolerance 0.1 %"):
        check_interaction_matrix(slightly)
    errors = check_interaction_matrix(slightly, tolerance=0.02).errors
    assert 0.001 < errors[2] < 0.01 and np.delete(errors, 2).max() < 1e-6


def test_a_number_that_is_not_finite_is_found() -> None:
    with pytest.raises(ServoError, match="row 'c3'"):
        check_interaction_matrix(Wrong(3, 2, float("nan")))


def test_the_worst_entry_is_reported_with_its_names_and_pose() -> None:
    with pytest.raises(InteractionMatrixError) as error:
        check_interaction_matrix(Wrong(3, 4, -2.0))
    check = error.value.check
    assert not check.is_correct and check.errors.shape == (12,)
    pose, row, column = check.find_worst_entry()
    assert (row, column) == (3, 4) and check.find_worst_entry(3) == (pose, 3, 4)
    assert check.L[pose, 3, 4] == pytest.approx(-2.0 * check.differences[pose, 3, 4], rel=1e-4)
    np.testing.assert_allclose(check.L[:, :3], check.differences[:, :3], atol=1e-5)
    x, y, z = check.poses[pose][:3, 3]
    place = f"camera at xyz ({x:.3g}, {y:.3g}, {z:.3g}) m, rpy ("
    first, *rows, last = repr(check).splitlines()
    assert first == "Wrong: L is wrong in 1 of 12 rows (tolerance 0.1 %, 3 poses)"
    assert rows[0].split() == ["c3", f"{100 * check.errors[3]:.2g}", "%", "WRONG"]
    assert len(rows) == 12 and all(line.endswith(" ok") for line in rows[1:])
    for text in (str(error.value), last):
        assert "row 'c3'" in text and "column wy: L is " in text and place in text
    value = float(re.search(r"finite differences (\S+),", str(error.value))[1])
    assert value == pytest.approx(check.differences[pose, 3, 4], rel=1e-3)


def test_the_worst_of_several_poses_is_reported() -> None:
    """An error that shows only far from the target."""

    class Hidden(Wrong):
        def measure(self, observation, goal):
            found = super().measure(observation, goal)
            L = found.L.copy()
            L[0, 3] += 0.1 if L[0, 0] > -1.0 / 0.34 else 0.0
            return replace(found, L=L)

    feature = Hidden(0, 0, 1.0)
    with pytest.raises(InteractionMatrixError) as error:
        check_interaction_matrix(feature)
    check = error.value.check
    worst, row, column = check.find_worst_entry()
    assert (row, column) == (0, 3)
    others = [pose for i, pose in enumerate(check.poses) if i != worst]
    assert check_interaction_matrix(feature, world_T_camera=np.array(others)[:1]).is_correct
    for wrong in (check.poses[worst], check.poses[worst][None]):
        with pytest.raises(InteractionMatrixError, match="column wx"):
            check_interaction_matrix(feature, world_T_camera=wrong)


def test_entries_are_compared_in_units_of_the_depth() -> None:
    """1 1/m at a depth of 0.3 m is less than 0.5."""

    class Two(Wrong):
        def measure(self, observation, goal):
            found = super().measure(observation, goal)
            L = found.L.copy()
            L[1, 1] += 1.0
            L[1, 3] += 0.5
            return replace(found, L=L)

    with pytest.raises(InteractionMatrixError, match="row 'c1' .* column wx"):
        check_interaction_matrix(Two(0, 0, 1.0))


@pytest.mark.parametrize(("given", "said"), [
    ("point", "unknown feature 'point': did you mean 'points'"),
    ("no_such_module:A", "feature 'no_such_module:A': cannot import no_such_module"),
    ("aras_visual_servo_controller:Law", "Law is not a class derived from Feature"),
])  # fmt: skip
def test_what_is_no_feature_is_refused(given: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        check_interaction_matrix(given)


def test_a_class_of_a_module_is_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_points.py").write_text(
        "from aras_visual_servo_controller import FEATURES\n"
        "class Mine(type(FEATURES.create('points'))):\n"
        "    def measure(self, observation, goal):\n"
        "        found = super().measure(observation, goal)\n"
        "        found.L[1, 5] *= -1.0\n"
        "        return found\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InteractionMatrixError, match="Mine: row 'y0' .* column wz"):
        check_interaction_matrix("my_points:Mine")


def test_a_feature_of_images_needs_a_function() -> None:
    with pytest.raises(ConfigurationError, match="luminance needs image: pass as observe"):
        check_interaction_matrix(FEATURES.create("luminance"))
    with pytest.raises(ConfigurationError, match="reads cameras by name: pass as observe"):
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
    check = check_interaction_matrix(FEATURES.create("lines"), observe, pose)
    assert check.errors.max() < 1e-6 and len(poses) == 14
