"""The ideal plant: a camera that flies as the scheme's twist says, one exact motion an image.

What papers and tutorials compute: no arm, no limits of joints, no delay; the twist of one image
moves the camera by its exponential until the next.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.poses import exponential, inverse
from aras_visual_servo_controller.arm.resolution import Resolution
from aras_visual_servo_controller.arm.resolver import Resolver
from aras_visual_servo_controller.arm.task import Task

from .base import JointReading, Reading
from .free_body import FreeBody
from .kinematic import FreeCamera
from .sight import NS, Exposures, Sight

STILL = np.zeros(6)


class IdealCamera(FreeCamera):
    """Takes the twist (6,) of the believed camera; the first image is at 0 s."""

    outputs = frozenset(("twist",))
    has_exact_plane = True

    def __init__(
        self, arm: FreeBody, believed: FreeBody, q: np.ndarray, sight: Sight, seed: int = 0
    ) -> None:
        """Stand at coordinates q (6,); `believed`: the same body with the camera as believed."""
        super().__init__(arm, q, sight, seed=seed)
        self._believed, self._asked = believed, STILL
        self._exposures = [Exposures(sight, self._random, first=0)]

    def advance(self, until_ns: int) -> list[Reading]:
        """Go to the next image, or to `until_ns` if it does not come before."""
        (exposure,) = self._exposures
        image_ns = exposure.due_ns
        time_ns = min(image_ns, until_ns)
        if self._asked is not STILL:
            mounting = self._believed.mounting
            motion = exponential(self._asked * ((time_ns - self.time_ns) / NS))
            self._pose = self._pose @ mounting @ motion @ inverse(mounting)
        self.time_ns = time_ns
        if image_ns > time_ns:
            return []
        q, speed = self.joints()
        image = exposure.expose(self.at_rest())
        return [
            JointReading(time_ns, self.joint_names, q.tolist(), speed.tolist()),
            *([] if image is None else [image]),
        ]

    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates and their rates now."""
        q = self.arm.coordinates(self._pose)
        return q, np.linalg.solve(self._believed.jacobian(q), self._asked)

    def _taken(self, kind: str, values: np.ndarray) -> None:
        self._asked = values if values.any() else STILL


class ExactResolver(Resolver):
    """Answers a task's own twist, slowed as a whole to the greatest speed.

    The coordinates' velocities are those that reach, at the next image, what the twist reaches.
    """

    def __init__(
        self, body: FreeBody, rate: float, speed: Sequence[float] | None = None
    ) -> None:
        """`rate`: images a second; `speed`: greatest m/s and rad/s of each component, or none."""
        super().__init__(body)
        self._period = 1.0 / rate
        self._greatest = np.full(6, np.inf) if speed is None else np.repeat(speed, 3)

    def resolve(
        self, q: np.ndarray, task: Task, dt: float, previous: np.ndarray | None = None
    ) -> Resolution:
        """See Resolver.resolve; the same whatever `dt` and `previous`."""
        twist = task.twist / max(1.0, float((np.abs(task.twist) / self._greatest).max()))
        moved = self.arm.pose(q) @ exponential(twist * self._period)
        velocities = (self.arm.coordinates(moved) - q) / self._period
        return Resolution(
            velocities, velocities, twist, twist, STILL, 1.0, np.full(6, np.inf), (), "", (),
            task.L, self.arm.jacobian(q), task.modelled, np.inf,
        )  # fmt: skip
