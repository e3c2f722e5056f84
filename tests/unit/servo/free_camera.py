"""Free camera that executes twists, written independently of the package's formulas."""

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation


def pose(translation, rotation_vector):
    """Return the pose (4, 4) of a translation (3,), m, and a rotation vector (3,), rad."""
    a_T_b = np.eye(4)
    a_T_b[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    a_T_b[:3, 3] = translation
    return a_T_b


def exponential(twist):
    """Return before_T_after (4, 4) of a body twist (6,) over one unit of time."""
    v, (x, y, z) = twist[:3], twist[3:]
    return expm(np.block([[np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.c_[v]],
                          [np.zeros((1, 4))]]))  # fmt: skip
