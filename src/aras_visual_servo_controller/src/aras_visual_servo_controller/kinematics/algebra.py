"""Compiled linear algebra of small matrices, for the inverse kinematics and the features."""

from math import isfinite

import numpy as np

from aras_visual_servo_base.compiled import jit

# A singular value is treated as 0 if it is below this fraction of the largest one. Rounding errors
# of float64 are 1e-15.
ROUNDING_TOLERANCE = 1e-12
# Two rows of the matrix are treated as orthogonal if the cosine of their angle is below this.
RIGHT_ANGLE = 2e-15
SWEEPS = 40  # maximum number of Jacobi sweeps; six are usual


def is_finite(vector: np.ndarray) -> bool:
    """Return whether all elements of a vector (k,) are finite."""
    # The sum of squares is fast to compute. It is finite only if all elements are finite, but it is
    # infinite for finite elements above 1e154, too.
    return isfinite(vector.dot(vector)) or bool(np.isfinite(vector).all())


@jit("f8[:,:]")
def svd(a):
    """Compute the singular value decomposition U (m, r), s (r,), V^T (r, n) of a (m, n).

    r = min(m, n), which may be 0; the singular values are in descending order. The algorithm is
    one-sided Jacobi rotation (M. Hestenes, Inversion of matrices by biorthogonalization, 1958). If
    a singular value is 0, its vector in the larger of U and V is 0.

    Raises:
        numpy.linalg.LinAlgError: an element is not finite.
    """
    m, n = a.shape
    r, length = min(m, n), max(m, n)
    largest = 0.0
    for i in range(m):
        for j in range(n):
            if not abs(a[i, j]) < np.inf:
                raise np.linalg.LinAlgError("a matrix that is not finite has no singular values")
            largest = max(largest, abs(a[i, j]))
    # Let A be the matrix `a`, or its transpose if `a` has more rows than columns, divided by
    # `largest`. During all sweeps, rows = turn @ A.
    rows, turn = np.zeros((r, length)), np.eye(r)
    if largest > 0.0:  # dividing by `largest` prevents overflow and underflow of squares
        for i in range(r):
            for j in range(length):
                rows[i, j] = (a[i, j] if m <= n else a[j, i]) / largest
    for _ in range(SWEEPS):
        done = True
        for i in range(r - 1):
            for j in range(i + 1, r):
                one, other, both = 0.0, 0.0, 0.0
                for k in range(length):
                    one += rows[i, k] * rows[i, k]
                    other += rows[j, k] * rows[j, k]
                    both += rows[i, k] * rows[j, k]
                if abs(both) <= RIGHT_ANGLE * np.sqrt(one * other):
                    continue
                done = False
                slope = (other - one) / (2.0 * both)
                tangent = 1.0 / (abs(slope) + np.sqrt(1.0 + slope * slope))
                if slope < 0.0:
                    tangent = -tangent
                cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
                sine = cosine * tangent
                for k in range(length):
                    x, y = rows[i, k], rows[j, k]
                    rows[i, k], rows[j, k] = cosine * x - sine * y, sine * x + cosine * y
                for k in range(r):
                    x, y = turn[i, k], turn[j, k]
                    turn[i, k], turn[j, k] = cosine * x - sine * y, sine * x + cosine * y
        if done:
            break
    sizes, order = np.empty(r), np.empty(r, np.int64)
    # These loops normalise and sort the rows. NumPy's norm and argsort would do the same, but they
    # compile to ten times as much machine code.
    for i in range(r):
        square = 0.0
        for k in range(length):
            square += rows[i, k] * rows[i, k]
        sizes[i] = np.sqrt(square)
        place = i
        while place > 0 and sizes[order[place - 1]] < sizes[i]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = i
    u, s, vt = np.empty((m, r)), np.empty(r), np.empty((r, n))
    for i in range(r):
        row = order[i]
        size = sizes[row]
        s[i] = size * largest
        for k in range(length):
            value = rows[row, k] / size if size > 0.0 else 0.0
            if m <= n:
                vt[i, k] = value
            else:
                u[k, i] = value
        for k in range(r):
            if m <= n:
                u[k, i] = turn[row, k]
            else:
                vt[i, k] = turn[row, k]
    return u, s, vt


@jit("f8[:,:], f8[:,:]")
def multiply(a, b):
    """Compute a @ b; for small matrices this is faster than a BLAS call."""
    product = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            for k in range(a.shape[1]):
                product[i, j] += a[i, k] * b[k, j]
    return product


@jit("f8[:,:], f8[:]")
def multiply_vector(a, x):
    """Compute a @ x."""
    product = np.zeros(a.shape[0])
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            product[i] += a[i, k] * x[k]
    return product


@jit("f8[:,:], f8[:], f8")
def solve_least_squares(L, e, tolerance):
    """Compute the least-squares solution L^+ e (n,) for L (k, n) and e (k,).

    Singular values up to `tolerance` times the largest one are treated as 0.
    """
    u, s, vt = svd(L)
    parts = multiply_vector(u.T, e)
    for i in range(len(s)):
        parts[i] = parts[i] / s[i] if s[i] > tolerance * s[0] else 0.0
    return multiply_vector(vt.T, parts)


@jit("f8[:,:], f8[:], f8, f8[:], f8[::1]")
def solve_scaled(L, e, tolerance, scale, solution):
    """Write the product of `scale` (n,) and the result of `solve_least_squares` into `solution`."""
    found = solve_least_squares(L, e, tolerance)
    for i in range(len(found)):
        solution[i] = scale[i] * found[i]


@jit("f8[:,:], b1[:], f8, f8, f8[:,:], f8, f8[::1]")
def compute_uncertainty(L, modelled, depth, accuracy, accuracy_columns, tolerance, uncertainty):
    """Compute `Task.uncertainty` (r,), for the r singular directions of a task; return r.

    Args:
        L, modelled, depth: attributes of the task.
        accuracy, accuracy_columns: attribute `accuracy` of the task: a number and an array (k, 0),
            or any number and an array (k, m) with m > 0.
        tolerance: attribute `rank_tolerance` of the task.
        uncertainty: (6,) output, of which the first r elements are used.
    """
    k, n = len(L), 0
    columns = np.empty((k, 6))
    for j in range(6):
        if modelled[j]:
            for i in range(k):
                columns[i, n] = L[i, j] * (depth if j < 3 else 1.0)
            n += 1
    u, s, _ = svd(columns[:, :n])
    for i in range(len(s)):
        noise = accuracy
        if accuracy_columns.shape[1] > 0:
            square = 0.0
            for j in range(accuracy_columns.shape[1]):
                total = 0.0
                for row in range(k):
                    total += u[row, i] * accuracy_columns[row, j]
                square += total * total
            noise = np.sqrt(square)
        uncertainty[i] = noise / s[i] if s[i] > tolerance * s[0] else np.inf
    return len(s)


@jit("f8[:,:], b1[:], f8, f8")
def is_well_conditioned(L, modelled, distance, ratio):
    """Return whether the smallest singular value of L is above `ratio` times the largest one.

    The rows of L are scaled to length 1 first, because they may have different units.

    Args:
        L: (k, 6) interaction matrix.
        modelled: (6,) whether each column is used.
        distance: unit of length, m.
        ratio: smallest accepted ratio of the singular values.
    """
    count = 0
    for j in range(6):
        count += modelled[j]
    rows, n = np.zeros((len(L), count)), 0
    for j in range(6):
        if modelled[j]:
            for i in range(len(L)):
                rows[i, n] = L[i, j] * (distance if j < 3 else 1.0)
            n += 1
    for i in range(len(L)):
        square = 0.0
        for j in range(count):
            square += rows[i, j] * rows[i, j]
        if square > 0.0:
            length = np.sqrt(square)
            for j in range(count):
                rows[i, j] /= length
    s = svd(multiply(rows.T, rows) if len(rows) > count else multiply(rows, rows.T))[1]
    return s[-1] > ratio * ratio * s[0]


@jit("f8[:,::1], i8", allocates=False)
def triangularise(rows, columns):
    """Reduce the first `columns` columns of a matrix (m, n), m > columns, to a triangle, in place.

    The matrix is multiplied by orthogonal reflections (A. Householder, Unitary triangularization of
    a nonsymmetric matrix, 1958). Linear equations in these columns then have the same least-squares
    solution as before, which depends on the first `columns` rows only.
    """
    for j in range(columns):
        square = 0.0
        for i in range(j, len(rows)):
            square += rows[i, j] * rows[i, j]
        if square == rows[j, j] * rows[j, j]:
            continue  # the elements below the diagonal are already zero
        head = -np.copysign(np.sqrt(square), rows[j, j])
        pivot = rows[j, j] - head  # first element of the normal of the Householder reflection
        for k in range(j + 1, rows.shape[1]):
            total = pivot * rows[j, k]
            for i in range(j + 1, len(rows)):
                total += rows[i, j] * rows[i, k]
            total /= -head * pivot
            rows[j, k] -= total * pivot
            for i in range(j + 1, len(rows)):
                rows[i, k] -= total * rows[i, j]
        rows[j, j] = head
        for i in range(j + 1, len(rows)):
            rows[i, j] = 0.0


@jit("f8[:,:], f8[:], f8[:,:], f8[:,::1], f8[::1], f8[:,::1]")
def reduce_equations(L, rate, accuracy, reduced_L, reduced_rate, reduced_accuracy):
    """Copy the equations L x = rate; if there are more than six, reduce them to a triangle.

    Args:
        L, rate: (k, 6) and (k,) the equations.
        accuracy: (k, m) further columns, which are transformed like `rate`.
        reduced_L, reduced_rate, reduced_accuracy: outputs with min(k, 6) rows.

    Returns:
        Whether L and rate are finite; if not, the outputs are undefined.
    """
    count, total = len(L), 0.0
    rows = np.empty((count, 7 + accuracy.shape[1]))
    for i in range(count):
        for j in range(6):
            rows[i, j] = L[i, j]
        rows[i, 6] = rate[i]
        for j in range(7):
            total += 0.0 * rows[i, j]
        for j in range(accuracy.shape[1]):
            rows[i, 7 + j] = accuracy[i, j]
    if count > 6:
        triangularise(rows, 6)
    for i in range(len(reduced_L)):
        for j in range(6):
            reduced_L[i, j] = rows[i, j]
        reduced_rate[i] = rows[i, 6]
        for j in range(accuracy.shape[1]):
            reduced_accuracy[i, j] = rows[i, 7 + j]
    return total == 0.0


@jit("f8[:,::1], f8[::1]", allocates=False)
def solve_linear(matrix, values):
    """Overwrite `values` (n,) with the solution x of matrix @ x = values.

    The matrix (n, n) must be invertible and is overwritten, too. The algorithm is Gaussian
    elimination with partial pivoting.
    """
    count = len(values)
    for i in range(count):
        pivot = i
        for k in range(i + 1, count):
            if abs(matrix[k, i]) > abs(matrix[pivot, i]):
                pivot = k
        for j in range(i, count):
            matrix[i, j], matrix[pivot, j] = matrix[pivot, j], matrix[i, j]
        values[i], values[pivot] = values[pivot], values[i]
        for k in range(i + 1, count):
            factor = matrix[k, i] / matrix[i, i]
            values[k] -= factor * values[i]
            for j in range(i + 1, count):
                matrix[k, j] -= factor * matrix[i, j]
    for i in range(count - 1, -1, -1):
        for j in range(i + 1, count):
            values[i] -= matrix[i, j] * values[j]
        values[i] /= matrix[i, i]


@jit("f8[:,:], f8")
def has_singular_values_above(a, bound):
    """Return whether all singular values of a (m, n) are greater than `bound`.

    This is the case if the Cholesky decomposition of a a^T - bound^2 I exists. If a has more rows
    than columns, a^T a is used instead.
    """
    side = a if a.shape[0] <= a.shape[1] else a.T
    squares = multiply(side, side.T)
    for i in range(len(squares)):
        squares[i, i] -= bound * bound
        for j in range(i + 1):
            for k in range(j):
                squares[i, j] -= squares[i, k] * squares[j, k]
            if j < i:
                squares[i, j] /= squares[j, j]
        if not squares[i, i] > 0.0:
            return False
        squares[i, i] = np.sqrt(squares[i, i])
    return True


@jit("f8[:]")
def are_finite(values):
    """Return whether all elements of an array (k,) are finite; for compiled functions.

    Each element is multiplied by 0, and the products are added: the sum is NaN if an element is not
    finite.
    """
    total = 0.0
    for value in values:
        total += 0.0 * value
    return total == 0.0


@jit("f8[:,:], f8[:]")
def is_task_finite(L, rate):
    """Return whether L (k, 6) and rate (k,) are finite."""
    total = 0.0
    for row in L:
        for value in row:
            total += 0.0 * value
    for value in rate:
        total += 0.0 * value
    return total == 0.0
