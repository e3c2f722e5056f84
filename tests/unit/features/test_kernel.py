"""Kernel features of the original, compared with its arithmetic pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from aras_visual_servo_camera.errors import DegenerateFeatureError
from aras_visual_servo_camera.kernel import compute_kernel_features, compute_original_moments
from aras_visual_servo_camera.moments import Pinhole


def mask() -> np.ndarray:
    image = np.zeros((24, 32), np.uint8)
    image[6:14, 9:22] = 255
    image[10:18, 18:26] = 255
    return image


def test_kernel_features_pixel_by_pixel() -> None:
    dx, dy, p, q = 0.017, 0.0185, -2, -2
    k, J = np.zeros(4), np.zeros((4, 4))
    for i, j in np.argwhere(mask()) + 1:
        x, y = i * dx, j * dy
        k[:3] += np.array([x**p, y**q, 1.0]) * dx * dy
        J[0, 0] -= p * x ** (p - 1)
        J[0, 3] += p * x ** (p - 1) * y
        J[1, 1] -= q * y ** (q - 1)
        J[1, 3] -= q * y ** (q - 1) * x
        J[2, 2] += 2
    J[3, 3] = -1
    v, u = np.argwhere(mask()).T.astype(float)
    u, v = u - u.mean(), v - v.mean()
    k[3] = 0.5 * np.arctan2(2 * (u * v).sum(), (u * u).sum() - (v * v).sum())
    result = compute_kernel_features(mask())
    np.testing.assert_allclose(result.values, k, rtol=1e-12)
    np.testing.assert_allclose(result.jacobian, J, rtol=1e-12)
    np.testing.assert_allclose(result.inverse @ J, np.eye(4), atol=1e-9)
    layout = result.to_message_data()
    assert len(layout) == 20
    np.testing.assert_array_equal(layout[:16], result.inverse.ravel())
    np.testing.assert_array_equal(layout[16:], result.values)


def test_moment_layout() -> None:
    camera = Pinhole(200.0, 210.0, 15.0, 11.0)
    rows, columns = np.argwhere(mask()).T.astype(float)
    row, column, m00, alpha = compute_original_moments(mask(), camera)
    assert row == pytest.approx((rows.mean() - 11.0) / 210.0)
    assert column == pytest.approx((columns.mean() - 15.0) / 200.0)
    assert m00 == len(rows)
    assert alpha == pytest.approx(0.1 * compute_kernel_features(mask()).values[3])


def test_lost_target_gives_no_numbers() -> None:
    empty = np.zeros((24, 32), np.uint8)
    with pytest.raises(DegenerateFeatureError, match="no target"):
        compute_kernel_features(empty)
    with pytest.raises(DegenerateFeatureError, match="no target"):
        compute_original_moments(empty, Pinhole(1.0, 1.0, 0.0, 0.0))
