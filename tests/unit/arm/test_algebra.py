"""Singular value decomposition of small matrices, compared with LAPACK, and failing inputs."""

import numpy as np
import pytest

from aras_visual_servo_controller.kinematics.algebra import (
    are_finite,
    has_singular_values_above,
    is_finite,
    is_task_finite,
    is_well_conditioned,
    solve_least_squares,
    solve_linear,
    svd,
    triangularise,
)

SHAPES = [(1, 1), (2, 6), (6, 2), (4, 6), (6, 6), (6, 7), (11, 6), (12, 7), (6, 12)]


def rebuilt(u, s, vt):
    return (u * s) @ vt


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scale", [1e-200, 1e-3, 1.0, 1e200])
def test_values_are_lapack_s_and_vectors_rebuild_the_matrix(shape, scale):
    random = np.random.default_rng(sum(shape))
    for _ in range(20):
        a = scale * random.normal(size=shape) * 10.0 ** random.uniform(-4, 0, shape[1])
        u, s, vt = svd(a)
        expected = np.linalg.svd(a, compute_uv=False)
        assert np.abs(s - expected).max() < 1e-14 * expected[0]
        assert np.abs(rebuilt(u, s, vt) - a).max() < 1e-14 * expected[0]
        assert np.abs(u.T @ u - np.eye(min(shape))).max() < 1e-13
        assert np.abs(vt @ vt.T - np.eye(min(shape))).max() < 1e-13


@pytest.mark.parametrize("shape", [(6, 4), (4, 6), (6, 6)])
def test_a_matrix_without_full_rank(shape):
    random = np.random.default_rng(2)
    a = random.normal(size=(shape[0], 2)) @ random.normal(size=(2, shape[1]))
    u, s, vt = svd(a)
    assert s[1] > 0.1 and s[2] < 1e-14
    assert np.abs(rebuilt(u, s, vt) - a).max() < 1e-14 * s[0]
    nothing = svd(np.zeros(shape))
    assert not nothing[1].any() and not rebuilt(*nothing).any()
    for rows, columns in ((0, shape[1]), (shape[0], 0), (0, 0)):
        u, s, vt = svd(np.zeros((rows, columns)))
        assert (u.shape, s.shape, vt.shape) == ((rows, 0), (0,), (0, columns))
    for bad in (np.nan, np.inf, -np.inf):
        a[2, 3] = bad
        with pytest.raises(np.linalg.LinAlgError, match="not finite"):
            svd(a)


def test_any_order_of_memory_and_read_only_arrays_are_taken():
    a = np.random.default_rng(5).normal(size=(6, 12))
    a.setflags(write=False)
    for view in (a, a.T, a[:, ::2], np.asfortranarray(a)):
        assert np.abs(rebuilt(*svd(view)) - view).max() < 1e-14


@pytest.mark.parametrize("shape", [(6, 4), (6, 6), (6, 7)])
@pytest.mark.parametrize(("least", "above"), [(0.0120001, True), (0.0119999, False), (0.0, False)])
def test_whether_a_motion_is_weak_is_told_without_its_singular_values(shape, least, above):
    random = np.random.default_rng(shape[1])
    for _ in range(20):
        u, s, vt = np.linalg.svd(random.normal(size=shape), full_matrices=False)
        s = np.append(random.uniform(0.02, 2.0, len(s) - 1), least)
        assert has_singular_values_above((u * s) @ vt, 0.012) == above


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scale", [1e-150, 1.0])
def test_least_squares_are_lapack_s(shape, scale):
    random = np.random.default_rng(sum(shape))
    left, right = (np.linalg.qr(random.normal(size=(n, n)))[0] for n in shape)
    s = np.geomspace(1.0, 1e-3, min(shape))
    L, e = np.zeros(shape), random.normal(size=shape[0])
    np.fill_diagonal(L, scale * s)
    L = left @ L @ right
    for tolerance in (1e-9, 0.0101, 1.0):
        kept = s > tolerance
        expected = right[: len(s)][kept].T @ (left.T[: len(s)][kept] @ e / (scale * s[kept]))
        found = solve_least_squares(L, e, tolerance)
        assert np.abs(found - expected).max() <= 1e-10 * np.linalg.norm(e) / scale


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_number_that_is_not_finite_is_noticed_wherever_it_is(bad):
    whole = np.array([1e300, -1e300, 0.0, 5e-324])
    for check, *arrays in (
        (are_finite, whole), (is_finite, whole), (is_task_finite, np.ones((4, 6)), whole)
    ):  # fmt: skip
        assert check(*arrays)
        for which, array in enumerate(arrays):
            for place in range(array.size):
                wrong = [one.copy() for one in arrays]
                wrong[which].flat[place] = bad
                assert not check(*wrong), (check, which, place)


@pytest.mark.parametrize("rows", [7, 8, 12, 200])
def test_reduced_rows_have_the_normal_equations_of_all_rows(rows):
    random = np.random.default_rng(rows)
    a = random.normal(size=(rows, 9))
    a[:, 3] = 0.0 if rows == 8 else a[:, 3]  # a direction that no row measures
    reduced = a.copy()
    triangularise(reduced, 6)
    first = reduced[:6]
    np.testing.assert_allclose(first[:, :6].T @ first, a[:, :6].T @ a, atol=1e-12 * rows)
    assert np.abs(np.tril(first[:, :6], -1)).max() == 0.0


def test_a_linear_system_is_solved_as_by_lapack_also_with_a_zero_pivot():
    random = np.random.default_rng(5)
    for _ in range(50):
        a, b = random.normal(size=(6, 6)), random.normal(size=6)
        a[0, 0] = 0.0
        found = b.copy()
        solve_linear(a.copy(), found)
        np.testing.assert_allclose(found, np.linalg.solve(a, b), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rows", [3, 6, 40])
def test_the_condition_of_l_is_that_of_rows_of_length_one_in_depths(rows):
    random = np.random.default_rng(rows)
    L, modelled, distance = random.normal(size=(rows, 6)), np.arange(6) != 3, 0.3
    L[0] = 0.0  # a feature that does not move
    scaled = (L * ([distance] * 3 + [1.0] * 3))[1:, modelled]
    scaled /= np.linalg.norm(scaled, axis=1, keepdims=True)
    padded = np.vstack([np.zeros(5), scaled])
    s = np.linalg.svd(padded, compute_uv=False)
    ratio = s[-1] / s[0]
    if ratio < 1e-9:
        assert not is_well_conditioned(L, modelled, distance, 1e-3)
        return
    assert is_well_conditioned(L, modelled, distance, 0.999 * ratio)
    assert not is_well_conditioned(L, modelled, distance, 1.001 * ratio)
