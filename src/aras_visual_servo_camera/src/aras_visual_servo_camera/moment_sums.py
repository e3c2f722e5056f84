"""Sums of moments over images, samples and polygons, as compiled loops.

A table (7, 7) contains the moment m_ij at [i, j], and zeros for i + j > MAX_ORDER. Sums over pixels
and samples are written to an array that is one of the arguments.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit

from .edge_pixels import find_edge_moment
from .polygons import find_crossing_edges

MAX_ORDER = 6
SIZE = MAX_ORDER + 1
# Number of samples whose powers x^i and y^j are computed together; it must be a power of two. The
# powers of 256 samples take 28 KiB, which fit into the fastest cache of a processor.
BLOCK = 256
# Nodes and weights of Gauss-Legendre quadrature on [0, 1]: four nodes integrate polynomials up to
# degree 7 exactly.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(MAX_ORDER // 2 + 1)
NODES = 0.5 * (NODES + 1.0)
WEIGHTS = 0.5 * WEIGHTS


@jit("f8[:,::1], f8[:,:], f8[:,:], f8[:,:], f8[:,:], b1, f8[:,::1]")
def sum_image(weights, u_powers, v_powers, u_slopes, v_slopes, has_edges, table):
    """Compute the moments of an image about the origin of its coordinates u and v, px.

    Args:
        weights: (rows, columns) weight of each pixel.
        u_powers, v_powers: (columns, SIZE), (rows, SIZE) powers of the coordinates of the columns
            and the rows.
        u_slopes, v_slopes: derivatives of these powers.
        has_edges: True if the weights are the covered fractions of the pixels. The covered part of
            a partly covered pixel is then located as in the module `edge_pixels`.
        table: (SIZE, SIZE) array to which the moments are written.
    """
    table[:] = 0.0
    first, second = np.empty(SIZE), np.empty(SIZE)
    for row in range(weights.shape[0]):
        first[:] = 0.0
        second[:] = 0.0
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = 0.0
        is_empty = True
        for column in range(weights.shape[1]):
            weight = weights[row, column]
            if weight == 0.0:
                continue
            is_empty = False
            s0 += weight * u_powers[column, 0]
            s1 += weight * u_powers[column, 1]
            s2 += weight * u_powers[column, 2]
            s3 += weight * u_powers[column, 3]
            s4 += weight * u_powers[column, 4]
            s5 += weight * u_powers[column, 5]
            s6 += weight * u_powers[column, 6]
            if has_edges and weight != 1.0:
                across, along = find_edge_moment(weights, row, column)
                for k in range(SIZE):
                    first[k] += across * u_slopes[column, k]
                    second[k] += along * u_powers[column, k]
        if is_empty:
            continue
        for k, value in enumerate((s0, s1, s2, s3, s4, s5, s6)):
            first[k] += value
        for i in range(SIZE):
            for j in range(SIZE - i):
                table[i, j] += first[i] * v_powers[row, j] + second[i] * v_slopes[row, j]


@jit("f8[:], f8[:], f8[:], f8[:,::1]")
def sum_samples(x, y, weight, table):
    """Compute the moments of weighted samples about their centre of gravity.

    Args:
        x, y, weight: (n,) coordinates and weight of each sample.
        table: (SIZE, SIZE) array to which the moments are written.

    Returns:
        Sum of the weights, and x and y of the centre of gravity. If the sum is not positive, the
        centre is NaN, and the table is not written.
    """
    total = x0 = y0 = 0.0
    for n in range(len(x)):
        total += weight[n]
        x0 += weight[n] * x[n]
        y0 += weight[n] * y[n]
    if not total > 0.0:
        return total, np.nan, np.nan
    x0, y0 = x0 / total, y0 / total
    table[:] = 0.0
    px, py = np.empty((SIZE, BLOCK)), np.empty((SIZE, BLOCK))
    dy, products = np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, len(x), BLOCK):
        count = min(BLOCK, len(x) - start)
        padded = 1
        while padded < count:
            padded *= 2
        for n in range(count):
            px[0, n], py[0, n] = 1.0, weight[start + n]
            px[1, n], dy[n] = x[start + n] - x0, y[start + n] - y0
        for n in range(count, padded):
            px[0, n], py[0, n], px[1, n], dy[n] = 1.0, 0.0, 0.0, 0.0
        for k in range(MAX_ORDER):
            for n in range(padded):
                py[k + 1, n] = py[k, n] * dy[n]
        for k in range(1, MAX_ORDER):
            for n in range(padded):
                px[k + 1, n] = px[k, n] * px[1, n]
        for i in range(SIZE):
            for j in range(SIZE - i):
                # Sum the products: add the second half of the array to the first half, until one
                # element is left. Unlike a plain sum, this loop can be vectorised without changing
                # the order of the summands.
                for n in range(padded):
                    products[n] = px[i, n] * py[j, n]
                half = padded // 2
                while half > 0:
                    for n in range(half):
                        products[n] += products[n + half]
                    half //= 2
                table[i, j] += products[0]
    return total, x0, y0


@jit("f8[:,:], f8[::1], f8[:,::1]")
def integrate_polygon(vertices, origin, table):
    """Integrate x^i y^j over a polygon (n, 2), relative to the origin (2,).

    Args:
        vertices: (n, 2) vertices of the polygon.
        origin: (2,) point; if it is NaN, the mean of the vertices is written into it.
        table: (order+1, order+1) output, the moments with a positive area.

    Returns:
        Whether all coordinates are finite; whether the area is zero; the indices of the first two
        edges that cross, or -1 twice.
    """
    order, count = len(table) - 1, len(vertices)
    sum_x = sum_y = 0.0
    for k in range(count):
        sum_x, sum_y = sum_x + vertices[k, 0], sum_y + vertices[k, 1]
        if not (abs(vertices[k, 0]) < np.inf and abs(vertices[k, 1]) < np.inf):
            return False, False, -1, -1
    if np.isnan(origin[0]):
        origin[0], origin[1] = sum_x / count, sum_y / count
    first, second = find_crossing_edges(vertices)
    if first >= 0:
        return True, False, first, second
    x0, y0 = origin[0], origin[1]
    for i in range(order + 1):
        for j in range(order + 1):
            table[i, j] = 0.0
    extent, power_x, power_y = 0.0, np.empty(order + 1), np.empty(order + 1)
    for k in range(count):
        after = k + 1 if k < count - 1 else 0
        px, py = vertices[k, 0] - x0, vertices[k, 1] - y0
        qx, qy = vertices[after, 0] - x0, vertices[after, 1] - y0
        extent = max(extent, abs(px), abs(py))
        doubled = px * qy - py * qx
        for n in range(len(NODES)):
            power_x[0], power_y[0] = doubled * WEIGHTS[n], 1.0
            x, y = px + NODES[n] * (qx - px), py + NODES[n] * (qy - py)
            for i in range(order):
                power_x[i + 1], power_y[i + 1] = power_x[i] * x, power_y[i] * y
            for i in range(order + 1):
                for j in range(order + 1 - i):
                    table[i, j] += power_x[i] * power_y[j]
    sign = 1.0 if table[0, 0] > 0.0 else -1.0
    for i in range(order + 1):
        for j in range(order + 1 - i):
            table[i, j] *= sign / (i + j + 2.0)
    return True, table[0, 0] <= 1e-14 * extent**2, -1, -1


@jit("f8[:,:], f8, f8")
def translate(table, dx, dy):
    """Compute the moments of a shape that is translated by (dx, dy).

    Let m_kl be the given moments. The new moment (i, j) is the sum of
    C(i,k) C(j,l) dx^(i-k) dy^(j-l) m_kl over k and l, where C is the binomial coefficient.
    """
    size = table.shape[0]
    rows, moved = np.zeros((size, size)), np.zeros((size, size))
    for i in range(size):
        factor = 1.0  # `factor` is C(i, k) dx^(i-k); the loop starts at k = i, where it is 1
        for k in range(i, -1, -1):
            for j in range(size):
                rows[i, j] += factor * table[k, j]
            factor *= dx * k / (i - k + 1)
    for j in range(size):
        factor = 1.0
        for k in range(j, -1, -1):
            for i in range(size):
                moved[i, j] += factor * rows[i, k]
            factor *= dy * k / (j - k + 1)
    return moved


@jit("f8[:,:], f8[:,::1]")
def centre_moments(table, centred):
    """Translate moments to the centre of gravity.

    Args:
        table: (order+1, order+1) moments about any point.
        centred: (order+1, order+1) array to which the moments about the centre of gravity are
            written.

    Returns:
        m00; x and y of the centre of gravity; mu20, mu11 and mu02, which are 0 if the order is 1.
    """
    m00 = table[0, 0]
    dx, dy = table[1, 0] / m00, table[0, 1] / m00
    moved = translate(table, -dx, -dy)
    size = len(table)
    for i in range(size):
        for j in range(size):
            centred[i, j] = moved[i, j] if i + j < size else 0.0
    centred[1, 0] = centred[0, 1] = 0.0
    if size < 3:
        return m00, dx, dy, 0.0, 0.0, 0.0
    return m00, dx, dy, centred[2, 0], centred[1, 1], centred[0, 2]
