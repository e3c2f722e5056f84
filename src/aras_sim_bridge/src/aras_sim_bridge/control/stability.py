"""Longest physics step at which the control loops of the running PIDs are stable.

Consider joints with the inertia matrix M and a PD loop with the effort -P q - D q̇, where q̇ is
computed from positions. A physics step of length h first updates velocities and then positions:

    v' = v - h M⁻¹ (P q + D v),  q' = q + h v'

The amplitude of oscillations grows if an eigenvalue of M⁻¹ (2 h D + h² P) exceeds 4. Integral
terms, limits and friction are neglected. Limits and friction bound such an oscillation but do not
end it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from aras_sim_bridge.control.drives import POSITION_BY_PID, VELOCITY_BY_PID
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.switching import LoadedController

STABILITY_BOUND = 4.0
_HALVINGS = 60
# find_gain_reductions divides gains repeatedly, each time by at least this factor. The reported
# reductions are multiplied by this factor, too, so that they still suffice when rounded to two
# digits.
_MARGIN = 1.05


def collect_gains(
    hardware: RobotHardware, running: Iterable[LoadedController], joints: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gains of the closed control loops, in the order of `joints`.

    The gains are the stiffness P (n,), effort per unit of position, and the damping D (n,), effort
    per unit of velocity; 0 for joints without a loop.
    """
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
    """Return the largest eigenvalue of M⁻¹ (2 h D + h² P).

    If it exceeds STABILITY_BOUND, the motion of the joints diverges.

    Args:
        inverse: inverse M⁻¹ (n, n) of the joints' inertia matrix.
        P, D: stiffness (n,) and damping (n,) of the control loops, see collect_gains.
        step: physics step h, s.
    """
    root = np.sqrt(np.maximum(2.0 * step * D + step * step * P, 0.0))
    return float(np.linalg.eigvalsh(root[:, None] * inverse * root)[-1])


def find_longest_step(inverse: np.ndarray, P: np.ndarray, D: np.ndarray, step: float) -> float:
    """Return the longest stable physics step, s, given that `step` is unstable.

    The other arguments are those of compute_step_eigenvalue.
    """
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
    """Return factors (n,) by which the joints' gains must be divided to make `step` stable.

    All factors are ≥ 1. The gains of the joint with the largest oscillation are reduced first, so
    that few joints are affected. The arguments are those of compute_step_eigenvalue.
    """
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
    """Return a warning if the closed loops are unstable at steps of `step` s, otherwise ''.

    Args:
        inverse_inertia: function that returns M⁻¹ (n, n) of `joints` at their current positions.
    """
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
    return (f"the loaded PIDs are unstable at steps of {step:g} s: at the current joint positions "
            f"they need {longest:.2g} s or less; use shorter steps or lower the gains of {lower}")
