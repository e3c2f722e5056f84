"""Expected values of each registered feature, computed independently from 3-D geometry.

Nothing here uses the package's own formulas: points come from a pose by projection, moments from
dense sums over a triangulation, poses from the poses themselves.
"""

import numpy as np
from free_camera import exponential, pose
from scipy.spatial.transform import Rotation

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane

CAMERA = CameraModel(640, 480, (800.0, 0, 317.3, 0, 760.0, 244.1, 0, 0, 1))
CORNERS = np.array([[-0.11, -0.05, 0], [0.09, -0.08, 0], [0.13, 0.06, 0], [-0.07, 0.04, 0]])
PARALLELOGRAM = np.array([[-0.11, -0.06, 0], [0.09, -0.08, 0], [0.12, 0.05, 0], [-0.08, 0.07, 0]])
GOAL = pose((0.02, -0.03, 0.7), (0.15, -0.2, 0.1))
VIEWS = [
    pose((0.05, 0.04, 0.9), (0.2, 0.3, 0.5)),
    pose((-0.04, 0.06, 0.21), (-0.3, 0.1, -1.2)),
    pose((0.03, -0.08, 1.1), (0.1, -0.25, 2.6)),
]


def places(camera_T_object, corners=CORNERS):
    return corners @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]


def seen(camera_T_object, corners=CORNERS):
    P = places(camera_T_object, corners)
    return P[:, :2] / P[:, 2:]


def look(observer, camera_T_object, stamp=0.0, corners=CORNERS):
    plane = Plane.from_pose(camera_T_object[:3, :3], camera_T_object[:3, 3])
    points = seen(camera_T_object, corners)
    return observer.observe_exact_features(
        stamp, CAMERA, contour=points, points=points, plane=plane,
        world_T_camera=np.linalg.inv(camera_T_object))  # fmt: skip


def moved(camera_T_object, twist):
    """Return camera_T_object after a camera twist (6,) for one unit of time."""
    return np.linalg.inv(exponential(np.asarray(twist))) @ camera_T_object


# Values s of each feature at a pose c of the object in the camera's frame.


def points(c):
    return seen(c).ravel()


def polar(c):
    z = seen(c) @ (1, 1j)
    return np.column_stack([abs(z), np.angle(z)]).ravel()


def lines(c):
    """Return each line n . (x, y, 1) = 0, from the plane of the edge and the camera's centre."""
    P = places(c)
    n = np.cross(P, np.roll(P, -1, axis=0))
    n = n / np.linalg.norm(n[:, :2], axis=1)[:, None]
    return np.column_stack([-n[:, 2], np.arctan2(n[:, 1], n[:, 0])]).ravel()


def segments(c, is_normalised=False):
    z = seen(c) @ (1, 1j)
    way = np.roll(z, -1) - z
    middle, length = 0.5 * (z + np.roll(z, -1)), abs(way)
    if is_normalised:
        middle, length = middle / length, 1.0 / length
    return np.column_stack([middle.real, middle.imag, length, np.angle(way)]).ravel()


def vanishing(c):
    D = np.diff(PARALLELOGRAM[:3], axis=0) @ c[:3, :3].T
    return np.array([[d[2] / np.hypot(d[0], d[1]), np.arctan2(d[1], d[0])] for d in D]).ravel()


def theta_u(c):
    return Rotation.from_matrix((GOAL @ np.linalg.inv(c))[:3, :3]).as_rotvec()


def translation(c):
    return (GOAL @ np.linalg.inv(c))[:3, 3]


def translation_camera(c):
    return (c @ (*CORNERS.mean(axis=0), 1.0))[:3]


def two_and_half(c):
    X, Y, Z = translation_camera(c)
    return np.array([X / Z, Y / Z, np.log(Z), *theta_u(c)])


# Moments, by quadrature over the quadrilateral.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(9)
GRID = np.array([(a, b) for a in NODES for b in NODES])
GRID_WEIGHTS = np.array([u * v for u in WEIGHTS for v in WEIGHTS])


def integral(c, function):
    """Return the integral of a function of z = x + i y over the target's image."""
    z0, z1, z2, z3 = seen(c) @ (1, 1j)
    a, b = 0.5 * (GRID.T + 1.0)
    z = (1 - a) * (1 - b) * z0 + a * (1 - b) * z1 + a * b * z2 + (1 - a) * b * z3
    by_a = (1 - b) * (z1 - z0) + b * (z2 - z3)
    by_b = (1 - a) * (z3 - z0) + a * (z2 - z1)
    area = abs((np.conj(by_a) * by_b).imag)
    return np.sum(function(z) * area * GRID_WEIGHTS) / 4.0


def area(c):
    return integral(c, np.ones_like).real


def middle(c):
    return integral(c, lambda z: z) / area(c)


def mu(c, i, j):
    g = middle(c)
    return integral(c, lambda z: (z.real - g.real) ** i * (z.imag - g.imag) ** j).real


def complex_moment(c, p, q):
    """Return c_pq, the integral of z^p conj(z)^q about the centroid."""
    g = middle(c)
    return integral(c, lambda z: (z - g) ** p * np.conj(z - g) ** q)


def basic(c):
    pairs = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    return np.array([integral(c, lambda z, i=i, j=j: z.real**i * z.imag**j).real for i, j in pairs])


def centred(c):
    orders = ((2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
    return np.array([mu(c, i, j) for i, j in orders])


def centre(c):
    return np.array([middle(c).real, middle(c).imag])


def an(c):
    depth = 1.0 / Plane.from_pose(GOAL[:3, :3], GOAL[:3, 3]).C
    return np.array([depth * np.sqrt(area(GOAL) / area(c))])


def xn_yn(c):
    return an(c) * centre(c)


def alpha(c):
    """Return the angle of the long axis, on the side that the target's first side tells."""
    half, begun = (0.5 * np.angle(complex_moment(place, 2, 0)) for place in (c, GOAL))
    sides = [np.diff(seen(place)[:2] @ (1, 1j))[0] for place in (GOAL, c)]
    turned = begun + np.angle(sides[1] / sides[0])
    return np.array([half + np.pi * np.round((turned - half) / np.pi)])


def ellipse(c):
    m00 = area(c)
    return np.array([*centre(c), mu(c, 2, 0) / m00, mu(c, 1, 1) / m00, mu(c, 0, 2) / m00])


def tilts(c):
    """Return Sx, Sy of Chaumette 2004, from complex moments."""
    c20, c11 = complex_moment(c, 2, 0), complex_moment(c, 1, 1).real
    # i c30 has the parts mu03 - 3 mu21 and mu30 - 3 mu12.
    both = 1j * complex_moment(c, 3, 0) * np.conj(c20**2)
    s = both / (abs(c20) ** 2 * c11**1.5 / np.sqrt(area(c)))
    return np.array([s.real, s.imag])


def symmetries(c):
    c11 = complex_moment(c, 1, 1).real
    return np.array([abs(complex_moment(c, 2, 0)) ** 2 / c11**2,
                     area(c) * abs(complex_moment(c, 3, 0)) ** 2 / c11**3])  # fmt: skip


def stacked(*functions):
    return lambda c: np.concatenate([function(c) for function in functions])


VALUES = {
    "points": points,
    "numbered_points": points,
    "polar_points": polar,
    "points_3d": lambda c: places(c).ravel(),
    "depth": lambda c: np.log(translation_camera(c)[2:]),
    "lines": lines,
    "segments": segments,
    "normalised_segments": lambda c: segments(c, is_normalised=True),
    "vanishing_points": vanishing,
    "theta_u": theta_u,
    "translation": translation,
    "translation_camera": translation_camera,
    "pose": stacked(translation, theta_u),
    "model": stacked(translation, theta_u),
    "pose_camera": stacked(translation_camera, theta_u),
    "two_and_half_d": two_and_half,
    "basic_moments": basic,
    "centred_moments": centred,
    "gravity_centre": centre,
    "gravity_centre_normalised": xn_yn,
    "area": lambda c: np.array([area(c)]),
    "area_normalised": an,
    "alpha": alpha,
    "ellipse": ellipse,
    "sx_sy": tilts,
    "px_py": symmetries,
    "moments_pitch": lambda c: np.array([*xn_yn(c), *an(c), tilts(c)[1], *alpha(c)]),
    "moments_six": stacked(xn_yn, an, tilts, alpha),
}
TARGETS = {"vanishing_points": PARALLELOGRAM}
# Where s has an angle, and its period.
PERIODS = {
    "polar_points": [0, 2 * np.pi] * 4,
    "lines": [0, 2 * np.pi] * 4,
    "segments": [0, 0, 0, 2 * np.pi] * 4,
    "normalised_segments": [0, 0, 0, 2 * np.pi] * 4,
    "vanishing_points": [0, 2 * np.pi] * 2,
    "alpha": [2 * np.pi],
    "moments_pitch": [0, 0, 0, 0, 2 * np.pi],
    "moments_six": [0, 0, 0, 0, 0, 2 * np.pi],
}
