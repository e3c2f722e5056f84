"""Base class of effects on the light of an image, for built-in and user-defined effects."""

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
    """Effect on the light of an image before the sensor converts it: blur, glare, dust.

    A subclass implements `apply`, and users name it as 'package.module:Class'. Its parameters are
    annotated attributes, with unit and bounds from `settings.parameter`; every effect is a
    dataclass.

    Attributes:
        name: short name, for messages.
        is_random: whether it uses `random`; such effects are not applied to the image of the goal.
    """

    name: ClassVar[str] = ""
    is_random: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        """Make a dataclass of every effect; its name is that of the class until registration."""
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
            random: generator that depends only on the camera's seed and the image's stamp.
        """


EFFECTS = Registry("effect", __package__, (Effect,), CameraError)
