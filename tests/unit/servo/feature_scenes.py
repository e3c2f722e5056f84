"""What each registered feature ought to be, written down a second time from 3-D geometry.

Nothing here uses the package's own formulas: points come from a pose by projection, moments from
dense sums over a triangulation, poses from the poses themselves.
"""

import numpy as np
from free_camera import exponential, pose

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel

CAMERA = CameraModel(640, 480, (800.0, 0, 320.0, 0, 800.0, 240.0, 0, 0, 1))
# A parallelogram, for vanishing points, that no turn and no mirror maps onto itself.
CORNERS = np.array([[-0.11, -0.06, 0], [0.09, -0.08, 0], [0.12, 0.05, 0], [-0.08, 0.07, 0]])
GOAL = pose((0.02, -0.03, 0.7), (0.15, -0.2, 0.1))
VIEWS = [
    pose((0.05, 0.04, 0.9), (0.2, 0.3, 0.5)),
    pose((-0.1, 0.06, 0.6), (-0.3, 0.1, -1.2)),
    pose((0.03, -0.08, 1.1), (0.1, -0.25, 2.6)),
]


def places(camera_T_object, corners=CORNERS):
    return corners @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]


def seen(camera_T_object, corners=CORNERS):
    P = places(camera_T_object, corners)
    return P[:, :2] / P[:, 2:]


def look(observer, camera_T_object, stamp=0.0, corners=CORNERS, plane=True):
    plane = Plane.from_pose(camera_T_object[:3, :3], camera_T_object[:3, 3]) if plane else None
    points = seen(camera_T_object, corners)
    return observer.of_exact(
        stamp, CAMERA, contour=points, points=points, plane=plane,
        world_T_camera=np.linalg.inv(camera_T_object),
    )  # fmt: skip


def moved(camera_T_object, twist):
    """camera_T_object after a twist (6,) of the camera over one unit of time."""
    return np.linalg.inv(exponential(np.asarray(twist))) @ camera_T_object


# -- values ------------------------------------------------------------------------------------


def points(c):
    return seen(c).ravel()


def polar(c):
    z = seen(c) @ (1, 1j)
    return np.column_stack([abs(z), np.angle(z)]).ravel()


def places_3d(c):
    return places(c).ravel()


def log_depth(c):
    return np.array([np.log((c @ (*CORNERS.mean(axis=0), 1.0))[2])])


def lines(c):
    """Each line by the plane of the edge and the camera's centre: n . (x, y, 1) = 0."""
    P = places(c)
    n = np.cross(P, np.roll(P, -1, axis=0))
    n = n / np.linalg.norm(n[:, :2], axis=1)[:, None]
    return np.column_stack([-n[:, 2], np.arctan2(n[:, 1], n[:, 0])]).ravel()


def _segment_parts(c):
    z = seen(c) @ (1, 1j)
    way = np.roll(z, -1) - z
    return 0.5 * (z + np.roll(z, -1)), abs(way), np.angle(way)


def segments(c):
    middle, length, angle = _segment_parts(c)
    return np.column_stack([middle.real, middle.imag, length, angle]).ravel()


def normalised_segments(c):
    middle, length, angle = _segment_parts(c)
    return np.column_stack([middle.real / length, middle.imag / length, 1 / length, angle]).ravel()


def vanishing(c):
    D = np.array([CORNERS[1] - CORNERS[0], CORNERS[2] - CORNERS[1]]) @ c[:3, :3].T
    return np.array([[d[2] / np.hypot(d[0], d[1]), np.arctan2(d[1], d[0])] for d in D]).ravel()


VALUES = {
    "points": points,
    "numbered_points": points,
    "polar_points": polar,
    "points_3d": places_3d,
    "depth": log_depth,
    "lines": lines,
    "segments": segments,
    "normalised_segments": normalised_segments,
    "vanishing_points": vanishing,
}
# Where s has an angle, and its period.
PERIODS = {
    "polar_points": [0, 2 * np.pi] * 4,
    "lines": [0, 2 * np.pi] * 4,
    "segments": [0, 0, 0, 2 * np.pi] * 4,
    "normalised_segments": [0, 0, 0, 2 * np.pi] * 4,
    "vanishing_points": [0, 2 * np.pi] * 2,
}
