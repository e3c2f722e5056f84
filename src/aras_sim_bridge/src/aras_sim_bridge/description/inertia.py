"""Checks of inertia tensors, and their principal axes, which is the form Bullet computes with."""

import numpy as np

from aras_sim_bridge.description.types import Inertial, Vector3
from aras_sim_bridge.errors import DescriptionError

# Rounding in CAD exports breaks the triangle inequality by less than this share of the trace.
_TRIANGLE_TOLERANCE = 1e-3
# kg m². Shipped robots have links of a milligram with made-up tensors (TIAGo's antennas).
_NEGLIGIBLE = 1e-6


def inertia_tensor(inertia: tuple[float, ...]) -> np.ndarray:
    """(3, 3) symmetric matrix of (ixx, ixy, ixz, iyy, iyz, izz)."""
    xx, xy, xz, yy, yz, zz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def make_inertial(
    where: str,
    mass: float,
    xyz: Vector3,
    rpy: Vector3,
    inertia: tuple[float, ...],
    warnings: list[str],
) -> Inertial | None:
    """An Inertial that a rigid body can have, or None for a link without mass.

    A tensor that breaks the triangle inequality is kept, with a warning (the equations of motion
    only need it positive). A missing or zero tensor, and one with a negative principal moment that
    is too small to matter, is replaced by that of a solid sphere of 5 cm radius, with a warning.

    Raises:
        DescriptionError: negative mass, or a tensor with a negative principal moment.
    """
    if mass < 0.0:
        raise DescriptionError(f"{where}: mass is {mass} kg; it must not be negative")
    if mass == 0.0:
        return None
    principal = np.linalg.eigvalsh(inertia_tensor(inertia))
    trace = float(principal.sum())
    negative = principal[0] < -1e-9 * max(abs(principal[2]), 1e-12)
    if negative and np.abs(principal).max() > _NEGLIGIBLE:
        raise DescriptionError(
            f"{where}: the inertia tensor has a negative principal moment ({principal[0]:.4g}); "
            "check the signs of ixx … izz"
        )
    if negative or principal[1] <= 0.0:
        sphere = 0.4 * mass * 0.05**2
        what = f"has a negative principal moment ({principal[0]:.4g})" if negative else "is zero"
        warnings.append(
            f"{where}: the inertia tensor {what}; used that of a solid sphere of 5 cm radius "
            f"({sphere:.3g} kg m²)"
        )
        return Inertial(mass, xyz, rpy, (sphere, 0.0, 0.0, sphere, 0.0, sphere))
    if principal[2] - principal[0] - principal[1] > _TRIANGLE_TOLERANCE * trace:
        warnings.append(
            f"{where}: principal moments {', '.join(f'{m:.4g}' for m in principal)} break the "
            "triangle inequality, so no body has them; used as they are"
        )
    return Inertial(mass, xyz, rpy, tuple(inertia))


def principal_axes(inertia: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments (3,) and the rotation (3, 3) whose columns are their axes.

    A diagonal tensor keeps its axes, so that nothing is permuted for the common case.
    """
    xx, xy, xz, yy, yz, zz = inertia
    if not (xy or xz or yz):
        return np.array([xx, yy, zz]), np.eye(3)
    moments, axes = np.linalg.eigh(inertia_tensor(inertia))
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return moments, axes
