"""How long a physics step the loaded PIDs bear.

A PD loop on joints of inertia M, effort = -P q - D q̇ with the derivative taken from positions, and
steps of h s that move velocities first and positions with the new velocities:

    v' = v - h M⁻¹ (P q + D v),  q' = q + h v'

swings with growing amplitude as soon as an eigenvalue of M⁻¹ (2 h D + h² P) is above 4. Integral
terms, limits and friction are left out; friction and limits bound the swing, but do not end it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from aras_sim_bridge.control.drives import POSITION_BY_PID, VELOCITY_BY_PID
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.switching import LoadedController

STABILITY_BOUND = 4.0
_HALVINGS = 60
_MARGIN = 1.05  # of a factor that is told with two digits


def collect_gains(
    hardware: RobotHardware, running: Iterable[LoadedController], joints: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """P and D (n,) of the loops that are closed at present, in the order of `joints`."""
    gains = {name: (0.0, 0.0) for name in joints}
    for entry in running:
        gains |= entry.controller.get_loop_gains()
    for drive in hardware.drives:
        if drive.kind == POSITION_BY_PID:
            gains[drive.handle.name] = drive.pid.gains.p, drive.pid.gains.d
        elif drive.kind == VELOCITY_BY_PID:
            gains[drive.handle.name] = 0.0, drive.pid.gains.p
    P, D = np.array([gains[name] for name in joints]).reshape(-1, 2).T
    return P, D


def compute_step_eigenvalue(
    inverse: np.ndarray, P: np.ndarray, D: np.ndarray, step: float
) -> float:
    """The largest eigenvalue of M⁻¹ (2 h D + h² P); above BOUND the loops diverge.

    Args:
        inverse: M⁻¹ (n, n). P, D: (n,). step: h, s.
    """
    root = np.sqrt(np.maximum(2.0 * step * D + step * step * P, 0.0))
    return float(np.linalg.eigvalsh(root[:, None] * inverse * root)[-1])


def find_longest_step(inverse: np.ndarray, P: np.ndarray, D: np.ndarray, step: float) -> float:
    """The longest step below `step`, which diverges, that does not, s."""
    low, high = 0.0, step
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (
            (low, middle)
            if compute_step_eigenvalue(inverse, P, D, middle) > STABILITY_BOUND
            else (middle, high)
        )
    return low


def find_gain_reductions(
    inverse: np.ndarray, P: np.ndarray, D: np.ndarray, step: float
) -> np.ndarray:
    """(n,) By what to divide the gains of each joint, 1 or more, so that steps of `step` s are
    borne. Always the joint is taken that swings most, so as few are above 1 as do."""
    factors = np.ones(len(P))
    while True:
        root = np.sqrt((2.0 * step * D + step * step * P) / factors)
        values, vectors = np.linalg.eigh(root[:, None] * inverse * root)
        if values[-1] <= STABILITY_BOUND:
            return factors
        factors[np.argmax(vectors[:, -1] ** 2)] *= max(values[-1] / STABILITY_BOUND, _MARGIN)


def report_stability(
    hardware: RobotHardware,
    running: Iterable[LoadedController],
    joints: tuple[str, ...],
    inverse_inertia: Callable[[], np.ndarray],
    step: float,
) -> str:
    """What steps of `step` s will do to the loops that are closed at present, where they do not
    bear them; empty where they do. inverse_inertia: M⁻¹ (n, n) of `joints`, where they stand."""
    P, D = collect_gains(hardware, running, joints)
    if not (P.any() or D.any()):
        return ""
    inverse = inverse_inertia()
    if compute_step_eigenvalue(inverse, P, D, step) <= STABILITY_BOUND:
        return ""
    longest = find_longest_step(inverse, P, D, step)
    factors = find_gain_reductions(inverse, P, D, step)
    lower = ", ".join(
        f"'{joints[i]}' {float(f'{_MARGIN * factors[i]:.2g}'):g}-fold"
        for i in np.argsort(-factors) if factors[i] > 1.0
    )
    return (f"the loaded PIDs are unstable at steps of {step:g} s: where the joints stand they "
            f"bear {longest:.2g} s; take shorter steps or lower the gains of {lower}")
