"""Small singular value decompositions: LAPACK's, without NumPy's wrapping that costs as much."""

import numpy as np
from scipy.linalg.lapack import dgesdd


def svd(a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U (m, r), s (r,) largest first, V^T (r, n) of a (m, n), r = min(m, n); also of no rows.

    Raises:
        numpy.linalg.LinAlgError: no convergence, as with numbers that are not finite.
    """
    if not a.size:
        m, n = a.shape
        return np.zeros((m, 0)), np.zeros(0), np.zeros((0, n))
    u, s, vt, info = dgesdd(a, full_matrices=0)
    if info != 0 or not s[0] < np.inf:
        raise np.linalg.LinAlgError("no singular values: a matrix of the arm is not finite")
    return u, s, vt
