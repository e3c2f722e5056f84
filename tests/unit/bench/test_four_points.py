"""The loop of docs/examples, written out: it agrees with the textbook's equations."""

from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_base.poses import exponential, inverse, pose_difference

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "four_points.py"


@pytest.fixture
def example(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    import four_points

    return four_points


def textbook(start, goal, images, period, gain):
    """world_T_camera after image-based servoing with L at each image and true depths."""
    corners = np.array([(-0.1, -0.1, 0.0), (0.1, -0.1, 0.0), (0.1, 0.1, 0.0), (-0.1, 0.1, 0.0)])

    def seen(pose):
        X, Y, Z = (inverse(pose) @ np.vstack([corners.T, np.ones(4)]))[:3]
        return X / Z, Y / Z, Z

    pose, desired = start, np.column_stack(seen(goal)[:2]).ravel()
    for _ in range(images):
        x, y, Z = seen(pose)
        L = np.zeros((8, 6))
        L[::2] = np.column_stack([-1 / Z, 0 * Z, x / Z, x * y, -1 - x * x, y])
        L[1::2] = np.column_stack([0 * Z, -1 / Z, y / Z, 1 + y * y, -x * y, -x])
        twist = -gain * np.linalg.pinv(L) @ (np.column_stack([x, y]).ravel() - desired)
        pose = pose @ exponential(period * twist)
    return pose


def test_the_example_arrives_by_the_textbooks_path(example, capsys):
    """Joints are the logarithm of the displacement: to first order of a period the same path."""
    assert example.main() < 5e-6
    errors = [float(line.split()[-1]) for line in capsys.readouterr().out.splitlines()[:-1]]
    assert len(errors) == 8 and all(b < 0.3 * a for a, b in zip(errors, errors[1:], strict=False))
    for images in (30, 60):
        pose = textbook(example.WORLD_T_START, example.WORLD_T_GOAL, images, example.PERIOD, 1.5)
        distance, _ = pose_difference(pose, example.WORLD_T_GOAL)
        assert example.main(images) == pytest.approx(distance, rel=0.02)
