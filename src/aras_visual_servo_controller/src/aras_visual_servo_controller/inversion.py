"""The linear algebra of an image and of one answer of the resolver, compiled.

The resolver's twists are scaled: the rotations by a length, so that all six numbers are in m/s.
"""

import numpy as np

from aras_visual_servo_camera.compiled import MASK, MATRIX, NUMBER, VECTOR, compiled

RANK_TOLERANCE = 1e-4  # below this part of the greatest singular value there is nothing but noise
# From this part of L's greatest singular value on all twists are seen alike.
WELL_SEEN = 0.05
# A weak joint motion is damped at least as if the demand saw so much of it.
LEAST_SEEN = 0.3
SMALLEST = 1e-9  # a singular value below is a rounding error
# Cosine between two rows that rounding leaves of a right angle; six sweeps are usual.
RIGHT_ANGLE, SWEEPS = 2e-15, 40


@compiled(MATRIX)
def svd(a):
    """U (m, r), s (r,) largest first, V^T (r, n) of a (m, n), r = min(m, n); also of no rows.

    By one-sided Jacobi rotations (M. Hestenes, Inversion of matrices by biorthogonalization, 1958).
    Where a singular value is 0 its vector on the longer side is 0 too.

    Raises:
        numpy.linalg.LinAlgError: a number is not finite.
    """
    m, n = a.shape
    r, length = min(m, n), max(m, n)
    largest = 0.0
    for i in range(m):
        for j in range(n):
            if not abs(a[i, j]) < np.inf:
                raise np.linalg.LinAlgError("singular values of a matrix that is not finite")
            largest = max(largest, abs(a[i, j]))
    rows, turn = np.zeros((r, length)), np.eye(r)  # turn @ the shorter side = rows
    if largest > 0.0:  # squares of what is scaled by it neither overflow nor vanish
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
    sizes = np.sqrt((rows * rows).sum(axis=1))
    order = np.argsort(-sizes)
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


@compiled(MATRIX, MATRIX)
def _times(a, b):
    """a @ b; BLAS takes longer to be called."""
    product = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            for k in range(a.shape[1]):
                product[i, j] += a[i, k] * b[k, j]
    return product


@compiled(MATRIX, VECTOR)
def _applied(a, x):
    """a @ x."""
    product = np.zeros(a.shape[0])
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            product[i] += a[i, k] * x[k]
    return product


@compiled(MATRIX, VECTOR, NUMBER)
def least_squares(L, e, tolerance):
    """L^+ e (n,) of L (k, n); singular values up to `tolerance` of the greatest count as 0."""
    u, s, vt = svd(L)
    parts = _applied(u.T, e)
    for i in range(len(s)):
        parts[i] = parts[i] / s[i] if s[i] > tolerance * s[0] else 0.0
    return _applied(vt.T, parts)


@compiled(MATRIX, VECTOR, MATRIX, VECTOR, MATRIX, MATRIX, NUMBER, NUMBER)
def demanded(L, rate, held, speeds, free, scaled, least, fully):
    """Rows for a task, and those for what it does not model.

    What is held leaves the other twists; in those the task is inverted, so that its wishes for what
    it does not model do not weigh.

    Args:
        L, rate: (k, 6), (k,) of the task.
        held, speeds: (p, 6) directions that are held, (p,) wanted along them.
        free: (6 - p, 6) the other directions.
        scaled: (6, n) the arm's Jacobian.
        least, fully: singular value from which the arm moves a held direction at all, and fully.

    Returns:
        basis (m, 6), orthonormal directions; wanted (m,) along them; weights (m,), 0 to 1, where
        the arm has to choose.
    """
    # Along which of the held directions can the arm move?
    turned, reach, _ = svd(_times(held, scaled))
    along, wanted = _times(turned.T, held), _applied(turned.T, speeds)
    weights = np.empty(len(reach))
    for i in range(len(reach)):
        part = min(max((reach[i] - least) / (fully - least), 0.0), 1.0)
        weights[i] = part * part * (3.0 - 2.0 * part)
    # What holding does to the features on its way is not the rest's to do.
    rest = rate - _applied(L, _applied(along.T, weights * wanted))
    u, s, vt = svd(_times(L, free.T))
    rank = 0
    while rank < len(s) and s[rank] > RANK_TOLERANCE * s[0]:
        rank += 1
    seen = _applied(u.T, rest)
    basis = np.empty((rank + len(reach), 6))
    basis[:rank], basis[rank:] = _times(vt[:rank], free), along
    speed, weight = np.empty(len(basis)), np.empty(len(basis))
    speed[rank:], weight[rank:] = wanted, weights
    for i in range(rank):
        speed[i] = seen[i] / s[i]
        # A twist that the features hardly show weighs less where the arm has to choose.
        weight[i] = min(1.0, s[i] / (WELL_SEEN * s[0]))
    return basis, speed, weight


@compiled(MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, MASK, VECTOR, NUMBER, NUMBER)
def solved(scaled, basis, wanted, weights, wish, free, fixed, damping, below):
    """Joint velocities for a demand, the others at their fixed ones, and what is free.

    Args:
        scaled: (6, n) the arm's Jacobian.
        basis, wanted, weights: as `demanded` answers them.
        wish: (n,) velocities where the demand leaves a choice.
        free, fixed: (n,) joints that may move, velocities (n,) of the others.
        damping, below: greatest damping, and singular value of the Jacobian where it sets in.

    Returns:
        (n,) for the demand; (n,) of the wish, what the demand does not see.
    """
    joints = np.flatnonzero(free)
    arm = np.empty((6, len(joints)))
    for column, joint in enumerate(joints):
        arm[:, column] = scaled[:, joint]
    rows = weights.copy().reshape(-1, 1) * basis
    rates = weights * wanted - _applied(rows, _applied(scaled, fixed))
    task = _times(rows, arm)
    turned, s, weak = svd(arm)
    strong = 0
    while strong < len(s) and s[strong] >= below:
        strong += 1
    m = len(task)
    damped = np.empty((m + len(s) - strong, len(joints)))
    damped[:m] = task
    # As strong as the demand is in that direction, whatever the units of its rows.
    seen = _times(rows, turned)
    for i in range(strong, len(s)):
        strength = max(np.sqrt((seen[:, i] * seen[:, i]).sum()), LEAST_SEEN)
        ratio = s[i] / below
        damped[m + i - strong] = damping * np.sqrt(1.0 - ratio * ratio) * strength * weak[i]
    u, s, vt = svd(damped)
    wishes = np.empty(len(joints))
    for column, joint in enumerate(joints):
        wishes[column] = wish[joint]
    towards, against = _applied(u[:m].T, rates), _applied(u[:m].T, _applied(task, wishes))
    for i in range(len(s)):
        inverse = 1.0 / s[i] if s[i] >= SMALLEST else 0.0
        towards[i] *= inverse
        against[i] *= inverse
    moved, kept = _applied(vt.T, towards), wishes - _applied(vt.T, against)
    primary, secondary = fixed.copy(), np.zeros(len(free))
    for column, joint in enumerate(joints):
        primary[joint], secondary[joint] = moved[column], kept[column]
    return primary, secondary


@compiled(MATRIX, VECTOR, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR)
def account(basis, wanted, scaled, jacobian, scale, primary, velocities):
    """Twists (6,) in SI units: asked for, given by the velocities (n,), and lost by the primary."""
    short = wanted - _applied(basis, _applied(scaled, primary))
    asked, missing = _applied(basis.T, wanted), _applied(basis.T, short)
    return asked / scale, _applied(jacobian, velocities), missing / scale
