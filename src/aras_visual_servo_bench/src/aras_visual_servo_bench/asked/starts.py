"""Where a run starts: a pose of the camera, or one that is drawn at random."""

from __future__ import annotations

import math
from dataclasses import dataclass

from aras_visual_servo_base.settings import check, parameter

from ..errors import ExperimentError, require
from ..targets.target_spec import Pair, Six
from .cameras import HALF_TURN


@dataclass(frozen=True)
class Sampler:
    """Draws starts from which the target is wholly in view, with the experiment's seed.

    height: of the camera above the target, least and greatest, m. side: greatest offset along
    the world's x and y, m. turn: greatest turn about the vertical from the goal's heading, rad.
    tilt: greatest lean from the goal's attitude, rad. margin: of the view, px from each border.
    attempts: after which the sampler gives up.
    """

    height: Pair = parameter((0.15, 0.5), "m")
    side: float = parameter(0.1, "m", least=0.0)
    turn: float = parameter(2.967, "rad", least=0.0, most=HALF_TURN)  # 170 degrees
    tilt: float = parameter(0.0, "rad", least=0.0, most=HALF_TURN)
    margin: float = parameter(2.0, "px", least=0.0)
    attempts: int = parameter(500, least=1)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "start")
        low, high = self.height
        require(0.0 < low <= high, f"start.height is {low:g} to {high:g}, must rise from above 0 m")

    def __str__(self) -> str:
        low, high = self.height
        turns = f"turned by up to {math.degrees(self.turn):.3g}°"
        tilts = f", tilted by up to {math.degrees(self.tilt):.3g}°" if self.tilt else ""
        return (f"drawn, camera {low:g} to {high:g} m above the target and up to {self.side:g} m "
                f"beside it, {turns}{tilts}")  # fmt: skip


@dataclass(frozen=True)
class CameraPose:
    """A pose of the camera's optical frame in the world: x, y, z (m), roll, pitch, yaw (rad)."""

    pose: Six

    def __str__(self) -> str:
        x, y, z = (f"{value:.4g}" for value in self.pose[:3])
        roll, pitch, yaw = (f"{math.degrees(value):.4g}" for value in self.pose[3:])
        return f"camera at x {x}, y {y}, z {z} m, roll {roll}°, pitch {pitch}°, yaw {yaw}°"
