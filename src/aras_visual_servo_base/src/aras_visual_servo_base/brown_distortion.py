"""Compiled loops of Brown's lens model, which `lenses.brown` documents.

`D` contains all 14 coefficients; those that a camera does not have are zero. If `is_tilted`, the
sensor of the camera is tilted, and `tilt` is its homography (3, 3).
"""

from __future__ import annotations

from .compiled import jit, jit_inline

ITERATIONS = 30
# Errors of the distorted coordinates, normalised: Newton's method stops below GOAL_ERROR, and its
# result is valid below VALID_ERROR.
GOAL_ERROR, VALID_ERROR = 1e-14, 1e-10


@jit_inline
def _distort_point(x, y, D, tilt, is_tilted):
    """Return the distorted x and y of a point, and a, b, c, d of the Jacobian [[a, b], [c, d]]."""
    p1, p2 = D[2], D[3]
    r2 = x * x + y * y
    top = 1.0 + r2 * (D[0] + r2 * (D[1] + r2 * D[4]))
    low = 1.0 + r2 * (D[5] + r2 * (D[6] + r2 * D[7]))
    radial = top / low
    dtop = D[0] + r2 * (2.0 * D[1] + 3.0 * D[4] * r2)
    dlow = D[5] + r2 * (2.0 * D[6] + 3.0 * D[7] * r2)
    slope = (dtop - radial * dlow) / low  # d(radial)/d(r2)
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    a = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    b = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    d = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    # Thin prism.
    xd, yd = xd + r2 * (D[8] + D[9] * r2), yd + r2 * (D[10] + D[11] * r2)
    of_x, of_y = 2.0 * (D[8] + 2.0 * D[9] * r2), 2.0 * (D[10] + 2.0 * D[11] * r2)
    a, b, c, d = a + of_x * x, b + of_x * y, b + of_y * x, d + of_y * y
    if not is_tilted:
        return xd, yd, a, b, c, d
    u = tilt[0, 0] * xd + tilt[0, 1] * yd + tilt[0, 2]
    v = tilt[1, 0] * xd + tilt[1, 1] * yd + tilt[1, 2]
    w = tilt[2, 0] * xd + tilt[2, 1] * yd + tilt[2, 2]
    xt, yt = u / w, v / w
    # Chain rule: the Jacobian of the tilt times the Jacobian of the previous steps.
    e, f = (tilt[0, 0] - xt * tilt[2, 0]) / w, (tilt[0, 1] - xt * tilt[2, 1]) / w
    g, h = (tilt[1, 0] - yt * tilt[2, 0]) / w, (tilt[1, 1] - yt * tilt[2, 1]) / w
    return xt, yt, e * a + f * c, e * b + f * d, g * a + h * c, g * b + h * d


@jit("f8[:], f8[:], f8[:], f8[:,:], b1, f8[:,::1]", allocates=False)
def distort_points(x, y, D, tilt, is_tilted, out):
    """Distort n points; write x, y and a, b, c, d of the Jacobian to `out` (6, n)."""
    for n in range(len(x)):
        xd, yd, a, b, c, d = _distort_point(x[n], y[n], D, tilt, is_tilted)
        out[0, n], out[1, n] = xd, yd
        out[2, n], out[3, n], out[4, n], out[5, n] = a, b, c, d


@jit("f8[:], f8[:], f8[:], f8[:,:], b1, f8, f8[:,::1], b1[::1]", allocates=False)
def undistort_points(xd, yd, D, tilt, is_tilted, largest_radius, out, valid):
    """Invert the distortion of n points by Newton's method.

    The distorted radius increases with the undistorted radius only up to a certain radius. A root
    beyond this radius is wrong. A wrong root is recognised because its undistorted radius is above
    `largest_radius`, or because the determinant or the trace of the Jacobian is not positive.

    Args:
        xd, yd: (n,) distorted coordinates, normalised.
        largest_radius: roots beyond this undistorted radius are rejected.
        out: (2, n) array to which x and y are written, 0 for points that are not valid.
        valid: (n,) array to which the validity of each point is written. A point is valid if the
            iteration converges to a root that is not rejected.
    """
    for n in range(len(xd)):
        x, y = xd[n], yd[n]
        px, py, a, b, c, d = _distort_point(x, y, D, tilt, is_tilted)
        for _ in range(ITERATIONS):
            ex, ey = px - xd[n], py - yd[n]
            if abs(ex) + abs(ey) < GOAL_ERROR:
                break
            determinant = a * d - b * c
            x, y = x - (d * ex - b * ey) / determinant, y - (a * ey - c * ex) / determinant
            px, py, a, b, c, d = _distort_point(x, y, D, tilt, is_tilted)
        valid[n] = (
            abs(px - xd[n]) + abs(py - yd[n]) < VALID_ERROR
            and a * d - b * c > 0.0
            and a + d > 0.0
            and x * x + y * y < largest_radius * largest_radius
        )
        out[0, n] = x if valid[n] else 0.0
        out[1, n] = y if valid[n] else 0.0
