"""What a real camera adds to its images. `EFFECTS` has the effects that a file here declares."""

from .base import EFFECTS, Effect
from .sensor import AutoExposure, EffectChain, Effects, SensorModel

__all__ = ["EFFECTS", "AutoExposure", "Effect", "EffectChain", "Effects", "SensorModel"]
