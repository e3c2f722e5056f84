"""check_interaction_matrix accepts correct interaction matrices and finds wrong ones."""

import re
from dataclasses import replace

import numpy as np
import pytest

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import (
    FEATURES,
    ConfigurationError,
    Need,
    check_interaction_matrix,
)
from aras_visual_servo_controller.errors import InteractionMatrixError, ServoError
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver

EXACT = {Need.MOMENTS, Need.CONTOUR, Need.CORNERS}
# Those that one camera measures without images, of a target of any shape.
OF_EXACT_VIEWS = [name for name in FEATURES if FEATURES[name].needs <= EXACT
                  and FEATURES[name].camera_count == 1 and name != "vanishing_points"]  # fmt: skip


@pytest.mark.parametrize("name", OF_EXACT_VIEWS)
def test_built_in_features_agree_with_their_differences(name):
    check = check_interaction_matrix(name)
    assert check.is_correct and check.errors.size and (check.errors < 1e-6).all()
    of_feature = check_interaction_matrix(FEATURES.create(name))
    np.testing.assert_array_equal(of_feature.errors, check.errors)


class Wrong(type(FEATURES.create("points"))):
    """`points` with a change of L, of one entry by a factor unless it is a function."""

    def __init__(self, change):
        super().__init__()
        self.change = change

    def measure(self, observation, goal):
        found = super().measure(observation, goal)
        L = found.L.copy()
        if callable(self.change):
            self.change(L)
        else:
            row, column, factor = self.change
            L[row, column] *= factor
        return replace(found, L=L)


@pytest.mark.parametrize(("column", "axis"), list(enumerate(("vx", "vy", "vz", "wx", "wy", "wz"))))
def test_a_wrong_column_is_named(column, axis):
    row = 0 if column == 0 else 1  # dy/dt does not depend on vx
    assert check_interaction_matrix(Wrong((row, column, 1.0))).errors.max() < 1e-6
    with pytest.raises(ServoError, match=rf"off by [\d.]+ % .*column {axis}: L is "):
        check_interaction_matrix(Wrong((row, column, -1.0)))


def test_the_tolerance_is_relative_to_the_row_and_entries_count_in_units_of_the_depth():
    slightly = Wrong((2, 0, 1.01))
    with pytest.raises(ServoError, match="tolerance 0.1 %"):
        check_interaction_matrix(slightly)
    errors = check_interaction_matrix(slightly, tolerance=0.02).errors
    assert 0.001 < errors[2] < 0.01 and np.delete(errors, 2).max() < 1e-6
    with pytest.raises(ServoError, match="row 'y1'"):
        check_interaction_matrix(Wrong((3, 2, float("nan"))))

    def two(L):  # 1 1/m at a depth of 0.3 m is less than 0.5
        L[1, [1, 3]] += 1.0, 0.5

    with pytest.raises(InteractionMatrixError, match="row 'y0' .* column wx"):
        check_interaction_matrix(Wrong(two))


def test_the_worst_entry_is_reported_with_its_names_and_pose():
    with pytest.raises(InteractionMatrixError) as error:
        check_interaction_matrix(Wrong((3, 4, -2.0)))
    check = error.value.check
    assert not check.is_correct and check.errors.shape == (12,)
    pose, row, column = check.find_worst_entry()
    assert (row, column) == (3, 4) and check.find_worst_entry(3) == (pose, 3, 4)
    assert check.L[pose, 3, 4] == pytest.approx(-2.0 * check.differences[pose, 3, 4], rel=1e-4)
    np.testing.assert_allclose(check.L[:, :3], check.differences[:, :3], atol=1e-5)
    x, y, z = check.poses[pose][:3, 3]
    place = f"camera at xyz ({x:.3g}, {y:.3g}, {z:.3g}) m, rpy ("
    first, *rows, last = repr(check).splitlines()
    assert first == "points: L is wrong in 1 of 12 rows (tolerance 0.1 %, 3 poses)"
    assert rows[0].split() == ["y1", f"{100 * check.errors[3]:.2g}", "%", "WRONG"]
    assert len(rows) == 12 and all(line.endswith(" ok") for line in rows[1:])
    for text in (str(error.value), last):
        assert "row 'y1'" in text and "column wy: L is " in text and place in text
    value = float(re.search(r"finite differences (\S+),", str(error.value))[1])
    assert value == pytest.approx(check.differences[pose, 3, 4], rel=1e-3)


def test_the_worst_of_several_poses_is_reported():
    def hidden(L):
        L[0, 3] += 0.1 if L[0, 0] > -1.0 / 0.34 else 0.0

    with pytest.raises(InteractionMatrixError) as error:
        check_interaction_matrix(Wrong(hidden))
    check = error.value.check
    worst, row, column = check.find_worst_entry()
    assert (row, column) == (0, 3)
    others = np.delete(check.poses, worst, axis=0)
    assert check_interaction_matrix(Wrong(hidden), world_T_camera=others[:1]).is_correct
    for wrong in (check.poses[worst], check.poses[worst][None]):
        with pytest.raises(InteractionMatrixError, match="column wx"):
            check_interaction_matrix(Wrong(hidden), world_T_camera=wrong)


@pytest.mark.parametrize(("given", "said"), [
    ("point", "unknown feature 'point': did you mean 'points'"),
    ("no_such_module:A", "feature 'no_such_module:A': cannot import no_such_module"),
    ("aras_visual_servo_controller:Law", "Law is not a class derived from Feature"),
    (FEATURES.create("luminance"), "luminance needs image: pass as observe"),
    (FEATURES.create("stereo_points"), "reads cameras by name: pass as observe"),
])  # fmt: skip
def test_what_is_no_feature_is_refused(given, said):
    with pytest.raises(ConfigurationError, match=said):
        check_interaction_matrix(given)


def test_a_class_of_a_module_is_checked(tmp_path, monkeypatch):
    (tmp_path / "my_points.py").write_text(
        "from aras_visual_servo_controller import FEATURES\n"
        "class Mine(type(FEATURES.create('points'))):\n"
        "    def measure(self, observation, goal):\n"
        "        found = super().measure(observation, goal)\n"
        "        found.L[1, 5] *= -1.0\n"
        "        return found\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InteractionMatrixError, match="Mine: row 'y0' .* column wz"):
        check_interaction_matrix("my_points:Mine")


def test_a_function_of_the_users_observes():
    """A larger target farther away: the steps follow the depth."""
    corners = np.array([(-3.0, -2.0, 0.0), (3.0, -2.5, 0.0), (3.5, 2.0, 0.0), (-3.0, 2.0, 0.0)])
    observer, poses = FeatureObserver(None, frozenset((Need.CORNERS,))), []

    def observe(pose):
        poses.append(pose)
        points = (corners - pose[:3, 3]) @ pose[:3, :3]
        plane = Plane(*(-pose[2, :3] / pose[2, 3]).tolist())
        return observer.observe_exact_features(
            0.0, None, world_T_camera=pose, contour=points[:, :2] / points[:, 2:], plane=plane)

    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 20.0
    check = check_interaction_matrix(FEATURES.create("lines"), observe, pose)
    assert check.errors.max() < 1e-6 and len(poses) == 14
