"""Image effects of real cameras. `EFFECTS` is the registry of the effects in this folder."""

from .base import EFFECTS, Effect
from .effect_chain import AutoExposure, EffectChain, Effects, SensorModel

__all__ = ["EFFECTS", "AutoExposure", "Effect", "EffectChain", "Effects", "SensorModel"]
