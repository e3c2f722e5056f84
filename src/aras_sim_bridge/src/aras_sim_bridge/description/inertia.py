"""Checks of inertia tensors, and their principal axes, which Bullet needs."""

import numpy as np

from aras_sim_bridge.description.types import Inertial, Vector3
from aras_sim_bridge.errors import DescriptionError

# Largest violation of the triangle inequality that causes no warning, as a fraction of the inertia
# tensor's trace. Rounding in CAD exports causes smaller violations.
_TRIANGLE_TOLERANCE = 1e-3
# If no principal moment of a tensor is larger than this, kg m², a negative moment causes a warning
# instead of an error. Common robot models contain such tensors, for example for TIAGo's antennas,
# which have masses of milligrams.
_NEGLIGIBLE = 1e-6
# A tensor whose largest radius of gyration is smaller than this, m, counts as zero.
_SMALLEST_RADIUS = 1e-6


def inertia_tensor(inertia: tuple[float, ...]) -> np.ndarray:
    """Return the symmetric (3, 3) matrix of (ixx, ixy, ixz, iyy, iyz, izz)."""
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
    """Return the checked inertial parameters of a link, or None for a link without mass.

    A tensor that violates the triangle inequality causes a warning but is used, because the
    equations of motion only need it to be positive definite. A tensor that is zero or nearly zero,
    or that has a negative principal moment but none above 1e-6 kg m² in magnitude, causes a warning
    and is replaced by that of a solid sphere of 5 cm radius.

    Raises:
        DescriptionError: the mass is negative, or a principal moment is negative and one is above
            1e-6 kg m² in magnitude.
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
    if negative or principal[1] <= 0.0 or principal[2] < mass * _SMALLEST_RADIUS**2:
        sphere = 0.4 * mass * 0.05**2
        what = f"has a negative principal moment ({principal[0]:.4g})" if negative else "is zero"
        warnings.append(
            f"{where}: the inertia tensor {what}, so the tensor of a solid sphere of 5 cm radius "
            f"({sphere:.3g} kg m²) is used; correct ixx … izz"
        )
        return Inertial(mass, xyz, rpy, (sphere, 0.0, 0.0, sphere, 0.0, sphere))
    if principal[2] - principal[0] - principal[1] > _TRIANGLE_TOLERANCE * trace:
        warnings.append(
            f"{where}: principal moments {', '.join(f'{m:.4g}' for m in principal)} break the "
            "triangle inequality, which is physically impossible; they are used as they are; "
            "correct ixx … izz"
        )
    return Inertial(mass, xyz, rpy, tuple(inertia))


def principal_axes(inertia: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the principal moments (3,) and a rotation matrix (3, 3) with the axes as columns.

    For a diagonal tensor the order of the axes is unchanged and the rotation is the identity.
    """
    xx, xy, xz, yy, yz, zz = inertia
    if not (xy or xz or yz):
        return np.array([xx, yy, zz]), np.eye(3)
    moments, axes = np.linalg.eigh(inertia_tensor(inertia))
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return moments, axes
