"""What an effect on the light of an image is, also one of a user's own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from aras_visual_servo_base.registry import Registry
from aras_visual_servo_base.settings import check

from ...errors import CameraError


@dataclass(frozen=True)
class Effect(ABC):
    """An effect on the light of an image before the sensor converts it: blur, glare, dust.

    A subclass gives `apply`, and is named as 'package.module:Class'. Its parameters are annotated
    attributes, with unit and bounds by `settings.parameter`: every effect is a dataclass.

    Attributes:
        name: short name, for messages.
        is_random: whether it draws from `random`; a goal is taught without such effects.
    """

    name: ClassVar[str] = ""
    is_random: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        """Make a dataclass of every effect, and name it after its class unless it is registered."""
        super().__init_subclass__(**options)
        cls.name = cls.__name__
        dataclass(frozen=True)(cls)

    def __post_init__(self) -> None:
        check(self, CameraError, f"effect {self.name}: ")

    @abstractmethod
    def apply(self, light: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Return the changed light.

        Args:
            light: (rows, columns) or (rows, columns, 3) uint8; it is not changed in place.
            random: depends on the camera's seed and the stamp of the image alone.
        """


EFFECTS = Registry("effect", __package__, (Effect,), CameraError)
