"""Model-predictive control of the points in the image, with visibility and speed constraints."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..errors import MeasurementError
from ..features.corners import NumberedPoints
from ..goals.goal import Goal
from ..kinematics.task import Task
from ..laws import Law
from ..observation.observation import Observation
from .base import SCHEMES, SchemeOutput
from .feature_scheme import FeatureSchemeBase

GAIN = 1.0  # gain of the predicted approach if the law has no `gain`, 1/s


@SCHEMES.register("predictive")
class Predictive(FeatureSchemeBase):
    """Model-predictive scheme: points approach the goal exponentially and stay inside the image.

    Over `horizon` s the camera moves with a constant twist v. At each of `steps` instants j dt, the
    predicted points are s + j dt L v and the desired points are s* + (s - s*) exp(-gain j dt). The
    scheme minimises the squared distances between them plus `effort` |v|^2, subject to
    |v| <= `speed`, with lengths in units of the distance at the goal. Predicted points must stay
    `margin` pixels inside the image; a point that is already closer to the border must not move
    outwards. SciPy's sequential least squares programming solves this problem. The inverse
    kinematics applies the joint limits.

    Reference: G. Allibert, E. Courtial and F. Chaumette, Predictive control for constrained
    image-based visual servoing, IEEE T-RO 26(5), 2010.
    """

    feature_class = NumberedPoints
    horizon: ClassVar[float] = 0.4
    steps: ClassVar[int] = 4
    effort: ClassVar[float] = 1e-4
    speed: ClassVar[tuple[float, ...]] = (1.0, 1.0, 1.0, 1.5, 1.5, 1.5)
    # The predicted points stay this far from the image's border, px, because the linear prediction
    # is not exact.
    margin: ClassVar[float] = 12.0

    def __init__(self, law: Law | None = None) -> None:
        super().__init__(law)
        # Imported here, because the import of SciPy's optimisers takes a third of a second.
        from scipy.optimize import minimize

        self._minimize = minimize
        self._last_twist = np.zeros(6)

    def reset(self) -> None:
        """Forget all earlier images."""
        super().reset()
        self._last_twist = np.zeros(6)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Compute the features of an image and the camera task."""
        measured = self.check_measurement(
            self.feature.measure(self.require_visible(observation), goal)
        )
        scale = np.repeat((goal.distance, 1.0), 3)
        self._last_twist, note = self._plan_twist(
            observation, measured.error, measured.s, measured.L * scale
        )
        twist = scale * self._last_twist
        return SchemeOutput(
            names=self.names, features=measured.s, desired=measured.desired,
            error=measured.error, task=Task.from_twist(twist), L=measured.L,
            ambiguity=measured.ambiguity, notes=(*measured.notes, note) if note else measured.notes,
        )  # fmt: skip

    def _plan_twist(
        self, observation: Observation, error: np.ndarray, s: np.ndarray, L: np.ndarray
    ) -> tuple[np.ndarray, str]:
        """Return the optimal twist (6,), and a note if a constraint could not be met.

        Args:
            observation: observation with the camera.
            error: (k,) error s - s*.
            s: (k,) normalised coordinates of the points.
            L: (k, 6) interaction matrix, with lengths in units of the distance at the goal.
        """
        gain = float(getattr(self.law, "gain", GAIN))
        dt = self.horizon / self.steps
        times = dt * np.arange(1, self.steps + 1)
        rows = np.vstack([tau * L for tau in times])
        desired_change = np.concatenate([(np.exp(-gain * tau) - 1.0) * error for tau in times])
        H = rows.T @ rows + self.effort * np.eye(6)
        g = -rows.T @ desired_change
        low, high = self._compute_borders(observation, s)
        ahead = self.horizon * L
        found = self._minimize(
            lambda v: 0.5 * v @ H @ v + g @ v, self._last_twist, jac=lambda v: H @ v + g,
            method="SLSQP", bounds=[(-most, most) for most in self.speed],
            constraints=[
                {"type": "ineq", "fun": lambda v: high - s - ahead @ v, "jac": lambda v: -ahead},
                {"type": "ineq", "fun": lambda v: s + ahead @ v - low, "jac": lambda v: ahead},
            ],
            options={"maxiter": 50, "ftol": 1e-12},
        )  # fmt: skip
        if not np.isfinite(found.x).all():
            raise MeasurementError("the predicted twist is not finite")
        return found.x, "" if found.success else "the target cannot be kept in view on this path"

    def _compute_borders(
        self, observation: Observation, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest and the largest coordinates (k,), normalised, inside the image."""
        camera, margin = observation.camera, self.margin
        middle_u, middle_v = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
        u = np.array([margin, camera.width - 1 - margin, middle_u, middle_u])
        v = np.array([middle_v, middle_v, margin, camera.height - 1 - margin])
        x, y, _ = camera.normalise(u, v)
        low = np.tile([x[0], y[2]], len(s) // 2)
        high = np.tile([x[1], y[3]], len(s) // 2)
        return np.minimum(low, s), np.maximum(high, s)
