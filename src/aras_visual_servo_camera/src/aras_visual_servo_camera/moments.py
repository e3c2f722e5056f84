"""Raw and centred moments of a shape from an image, a polygon, points or weighted samples.

    m_ij = integral of x^i y^j over the shape,   mu_ij = the same about the centre of gravity.

x = X/Z (to the right) and y = Y/Z (down) are normalised metric image coordinates. The moments
therefore depend only on the scene and the pose, not on the lens or the resolution.

Every constructor first computes the moments about a point near the shape, and then translates them
to the centre of gravity (mu) and to the optical axis (m). If the moments were computed about the
optical axis, cancellation would increase the relative error of mu_ij by the factor
(distance / size)^(i+j), where `distance` is the shape's distance from the axis.

In flat arrays and in the ImageMoments message, moments are in the exchange order: by i + j, and
then by j, i.e. m00, m10, m01, m20, m11, m02, m30, ...
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from math import isfinite, nan

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import MomentsError
from .moment_sums import (
    MAX_ORDER,
    SIZE,
    centre_moments,
    integrate_polygon,
    sum_image,
    sum_samples,
    translate,
)
from .polygons import Array

DENSE = "dense"
POINTS = "points"


@cache
def exponents(order: int) -> tuple[tuple[int, int], ...]:
    """Return all (i, j) with i + j <= order, sorted by i + j, then by j (exchange order)."""
    return tuple((n - j, j) for n in range(order + 1) for j in range(n + 1))


@cache
def _make_flat_index(order: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    pairs = np.array(exponents(order))
    return pairs[:, 0], pairs[:, 1]


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera without distortion, px: u = fx x + cx, v = fy y + cy.

    (u, v) is the (column, row) of a pixel's centre, which is (0, 0) for the first pixel.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def from_K(cls, K: ArrayLike) -> Pinhole:
        """Return the intrinsics of a camera matrix K, (3, 3), or CameraInfo.K (9 numbers)."""
        k = np.asarray(K, dtype=float).reshape(3, 3)
        return cls(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))


@dataclass(frozen=True, eq=False)
class Moments:
    """Image moments m_ij and mu_ij of one shape for i + j <= `order`; immutable.

    Constructors: `from_image`, `from_polygon`, `from_points`, `from_samples`, `from_arrays`.

    Attributes:
        order: highest i + j, up to 6.
        kind: 'dense' for a region, 'points' for a set of points.
        m00: area of the region (normalised, without unit), or number of points.
        xg, yg: centre of gravity, normalised.
        centred: (order+1, order+1) centred moments, mu_ij at [i, j], zero for i + j > order;
            read-only.
    """

    order: int
    kind: str
    m00: float
    xg: float
    yg: float
    centred: Array

    @cached_property
    def raw(self) -> Array:
        """Raw moments (order+1, order+1), m_ij at [i, j], zero for i + j > order; read-only."""
        table = translate(self.centred, self.xg, self.yg)
        return _freeze(table * _make_triangle_mask(self.order))

    @cached_property
    def second(self) -> tuple[float, float, float]:
        """Second-order moments mu20, mu11, mu02; raises MomentsError if the order is below 2."""
        self._check_order(2, 0)
        (_, _, mu02), (_, mu11, _), (mu20, _, _) = self.centred[:3, :3].tolist()
        return mu20, mu11, mu02

    def m(self, i: int, j: int) -> float:
        """Return the raw moment m_ij; raise MomentsError if i + j > order."""
        self._check_order(i, j)
        return float(self.raw[i, j])

    def mu(self, i: int, j: int) -> float:
        """Return the centred moment mu_ij; raise MomentsError if i + j > order."""
        self._check_order(i, j)
        return float(self.centred[i, j])

    @property
    def m_array(self) -> Array:
        """All m_ij, ((order+1)(order+2)/2,), sorted by i + j, then by j."""
        return self.raw[_make_flat_index(self.order)]

    @property
    def mu_array(self) -> Array:
        """All mu_ij, ((order+1)(order+2)/2,), sorted by i + j, then by j."""
        return self.centred[_make_flat_index(self.order)]

    @property
    def area(self) -> float:
        """The area `a` in the features' formulas: m00 for a region, mu20 + mu02 for points."""
        if self.kind == DENSE:
            return self.m00
        return float(self.centred[2, 0] + self.centred[0, 2])

    def _check_order(self, i: int, j: int) -> None:
        if i < 0 or j < 0 or i + j > self.order:
            raise MomentsError(
                f"moment ({i}, {j}) is not available: i + j must be at most {self.order}, the "
                "order with which the moments were computed"
            )

    @classmethod
    def from_arrays(cls, m: ArrayLike, mu: ArrayLike, order: int, kind: str = DENSE) -> Moments:
        """Return the moments from arrays, such as those of an ImageMoments message.

        Args:
            m, mu: ((order+1)(order+2)/2,) raw and centred moments, sorted by i + j, then j.
            order: highest i + j.
            kind: 'dense' for a region, 'points' for a set of points.

        Raises:
            MomentsError: an array has the wrong length, a moment is not finite, or m00 is not
                positive.
        """
        m = np.asarray(m, dtype=float).reshape(-1)
        mu = np.asarray(mu, dtype=float).reshape(-1)
        count = (order + 1) * (order + 2) // 2
        if order < 1 or m.size != count or mu.size != count:
            raise MomentsError(
                f"order {order} needs {count} raw and {count} centred moments, got {m.size} and "
                f"{mu.size}; the order must be at least 1"
            )
        if not (np.isfinite(m).all() and np.isfinite(mu).all()):
            raise MomentsError(
                "moments must be finite; if the target is lost, send no moments and set `valid` to "
                "false"
            )
        if m[0] <= 0.0:
            raise MomentsError(f"m00 = {m[0]:g} must be positive: the shape is empty")
        index = _make_flat_index(order)
        raw, centred = np.zeros((2, order + 1, order + 1))
        raw[index], centred[index] = m, mu
        result = cls(order, kind, float(m[0]), m[1] / m[0], m[2] / m[0], _freeze(centred))
        result.__dict__["raw"] = _freeze(raw)
        return result

    @classmethod
    def from_polygon(
        cls, vertices: ArrayLike, order: int = MAX_ORDER, holes: Sequence[ArrayLike] = ()
    ) -> Moments:
        """Compute the exact moments of a simple polygon.

        The polygon is divided into triangles (0, P, Q), one for each edge PQ. The integral of a
        homogeneous function f of degree d over such a triangle is P x Q / (d + 2) times the mean of
        f over the edge PQ. On the edge, f is a polynomial, whose mean is computed exactly by
        Gauss-Legendre quadrature.

        Args:
            vertices: (n, 2) normalised, clockwise or counter-clockwise. The first vertex is not
                repeated at the end.
            order: highest i + j, at most 6.
            holes: polygons inside the polygon, which are subtracted.

        Raises:
            MomentsError: the order is not 1 to 6, or a polygon has fewer than three vertices, edges
                that cross, no area, or a coordinate that is not finite.
        """
        _check_computable(order)
        origin = np.array((nan, nan))
        table = _integrate_polygon(vertices, origin, order, "polygon")
        for number, hole in enumerate(holes):
            table -= _integrate_polygon(hole, origin, order, f"hole {number}")
        return cls._from_table(table, *origin.tolist(), order, DENSE)

    @classmethod
    def from_points(cls, points: ArrayLike, order: int = MAX_ORDER) -> Moments:
        """Compute the moments of at least three normalised points (n, 2) with the weight one."""
        points = _read_vertices(points, "set of points")
        if not np.isfinite(points).all():
            raise MomentsError("the set of points has a coordinate that is not finite")
        return cls.from_samples(points[:, 0], points[:, 1], np.ones(len(points)), order, POINTS)

    @classmethod
    def from_samples(
        cls, x: Array, y: Array, weight: Array, order: int = MAX_ORDER, kind: str = DENSE,
        extent: tuple[float, float, float] | None = None,
    ) -> Moments:  # fmt: skip
        """Compute moments as the sums of weight x^i y^j over n samples, such as pixels.

        Args:
            x, y: (n,) normalised coordinates of the samples.
            weight: (n,) weight of each sample, such as the area of a pixel.
            order: highest i + j, at most 6.
            kind: 'dense' for a region, 'points' for a set of points.
            extent: variances xx, yy and covariance xy of the coordinates within the area that one
                sample represents, such as the square of a pixel, as (xx, xy, yy). They are included
                to first order. None for samples without extent.

        Raises:
            MomentsError: the order is not 1 to 6, the arrays do not have the same shape (n,), or
                the sum of the weights is not positive.
        """
        _check_computable(order)
        x, y, weight = (np.asarray(a, dtype=float) for a in (x, y, weight))
        if x.ndim != 1 or not x.shape == y.shape == weight.shape:
            raise MomentsError(
                f"x, y and the weights have the shapes {x.shape}, {y.shape} and {weight.shape}, "
                "must have the shape (n,): give one weight for each sample"
            )
        table = np.empty((SIZE, SIZE))
        total, x0, y0 = sum_samples(x, y, weight, table)
        if not total > 0.0:
            raise MomentsError(
                f"the sum of the weights is {total:g}, must be positive: the shape is empty"
            )
        table = table[: order + 1, : order + 1]
        if extent is not None:
            table = _apply_extent(table, extent)
        return cls._from_table(table, x0, y0, order, kind)

    @classmethod
    def from_image(
        cls, weights: NDArray, camera: Pinhole, order: int = MAX_ORDER, full_scale: float = 1.0,
        offset: tuple[int, int] = (0, 0), coverage: bool = False,
    ) -> Moments:  # fmt: skip
        """Compute the moments of an image of weights from a camera without distortion.

        Args:
            weights: (rows, columns) weight of each pixel, any real type.
            camera: intrinsics in pixels of the whole image.
            order: highest i + j, at most 6.
            full_scale: weight of a pixel that the shape covers completely, 255 for a mask.
            offset: (column, row) of weights[0, 0] in the whole image, for a crop.
            coverage: True if a weight is the covered fraction of the pixel's square, False if it is
                a sample at the pixel's centre.

        Raises:
            MomentsError: the order is not 1 to 6, or the sum of the weights is not positive.
        """
        _check_computable(order)
        rows, columns = weights.shape
        # Compiled functions that take arrays in C order need writable arrays (`carray`).
        if weights.dtype != np.float64 or not weights.flags.carray:
            weights = np.array(weights, np.float64, order="C")
        if coverage and full_scale != 1.0:
            weights, full_scale = weights / full_scale, 1.0
        u, u_slopes = _compute_powers(columns, coverage)
        v, v_slopes = _compute_powers(rows, coverage)
        table = np.empty((SIZE, SIZE))
        sum_image(weights, u, v, u_slopes, v_slopes, coverage, table)
        table = table[: order + 1, : order + 1] * _compute_pixel_scale(
            camera.fx, camera.fy, order, full_scale
        )
        x0 = (offset[0] + 0.5 * (columns - 1) - camera.cx) / camera.fx
        y0 = (offset[1] + 0.5 * (rows - 1) - camera.cy) / camera.fy
        return cls._from_table(table, x0, y0, order, DENSE)

    def add(self, raw: Array) -> Moments:
        """Return the moments of the union of this shape and a shape with the moments `raw`.

        raw: (order+1, order+1) raw moments, m_ij at [i, j]. Negative moments remove a part.
        """
        return self._from_table(self.raw + raw, 0.0, 0.0, self.order, self.kind)

    @classmethod
    def _from_table(cls, table: Array, x0: float, y0: float, order: int, kind: str) -> Moments:
        """Return Moments from an array (order+1, order+1) of moments about the point (x0, y0)."""
        centred = np.empty(table.shape)
        m00, dx, dy, *second = centre_moments(table, centred)
        if not (m00 > 0.0 and isfinite(m00)):
            raise MomentsError(f"m00 = {m00:g} must be positive: the shape is empty")
        centred.setflags(write=False)
        result = cls(order, kind, m00, x0 + dx, y0 + dy, centred)
        if order > 1:
            result.__dict__["second"] = tuple(second)
        return result


def _freeze(array: Array) -> Array:
    array.setflags(write=False)
    return array


@cache
def _make_triangle_mask(order: int) -> Array:
    i = np.arange(order + 1)
    return (i[:, None] + i[None, :] <= order).astype(float)


def _apply_extent(table: Array, extent: tuple[float, float, float]) -> Array:
    """Add the effect of the samples' extent to their moments, to first order.

    The effect on m_ij is half of xx d2f/dx2 + 2 xy d2f/dxdy + yy d2f/dy2, summed over the samples
    with their weights, where f = x^i y^j and (xx, xy, yy) are the variances and the covariance of
    the extent.
    """
    xx, xy, yy = extent
    k = np.arange(table.shape[0], dtype=float)
    i, j = k[:, None], k[None, :]
    result = table.copy()
    result[2:, :] += 0.5 * xx * (i * (i - 1))[2:] * table[:-2, :]
    result[1:, 1:] += xy * (i * j)[1:, 1:] * table[:-1, :-1]
    result[:, 2:] += 0.5 * yy * (j * (j - 1))[:, 2:] * table[:, :-2]
    return result


@lru_cache(maxsize=4096)
def _compute_powers(size: int, coverage: bool) -> tuple[Array, Array]:
    """Compute the powers 0 to SIZE - 1 of the coordinates of `size` pixels in a row.

    The coordinates are relative to the middle of the row. With `coverage`, the power of a pixel is
    the mean over the pixel, otherwise the value at its centre.

    Returns:
        The powers (size, SIZE), and their derivatives (size, SIZE).
    """
    u, k = np.arange(size) - 0.5 * (size - 1), np.arange(SIZE)
    if coverage:
        high, low = ((u[:, None] + half) ** (k + 1) for half in (0.5, -0.5))
        powers = (high - low) / (k + 1)
    else:
        powers = u[:, None] ** k
    slopes = np.zeros((size, SIZE))
    slopes[:, 1:] = k[1:] * powers[:, :-1]
    return _freeze(powers), _freeze(slopes)


@lru_cache(maxsize=64)
def _compute_pixel_scale(fx: float, fy: float, order: int, full_scale: float) -> Array:
    if not (fx > 0.0 and fy > 0.0 and isfinite(fx) and isfinite(fy)):
        raise MomentsError(f"focal lengths must be positive and finite, got fx={fx:g}, fy={fy:g}")
    n = np.arange(1, order + 2)
    return _freeze(np.outer(fx ** -n.astype(float), fy ** -n.astype(float)) / full_scale)


def _check_computable(order: int) -> None:
    if not 1 <= order <= MAX_ORDER:
        raise MomentsError(f"the order is {order}, must be 1 to {MAX_ORDER}")


def _read_vertices(points: ArrayLike, label: str) -> Array:
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise MomentsError(
            f"the {label} needs at least three points (x, y), got an array of shape {points.shape}"
        )
    return points


def _integrate_polygon(vertices: ArrayLike, origin: Array, order: int, label: str) -> Array:
    """Compute the moments (order+1, order+1) of a polygon (n, 2) about an origin (2,).

    If the origin is NaN, the mean of the vertices is written into it. The area is positive. `label`
    names the polygon in messages.
    """
    table, vertices = np.empty((order + 1, order + 1)), _read_vertices(vertices, label)
    is_finite, is_empty, first, second = integrate_polygon(vertices, origin, table)
    if not is_finite:
        raise MomentsError(f"the {label} has a coordinate that is not finite")
    if first >= 0:
        raise MomentsError(
            f"edges {first} and {second} of the {label} cross: sort its vertices so that the "
            "outline is simple"
        )
    if is_empty:
        raise MomentsError(
            f"the {label} has no area: its vertices lie on one line; add a vertex off this line"
        )
    return table
