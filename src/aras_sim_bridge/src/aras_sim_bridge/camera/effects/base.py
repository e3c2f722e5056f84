"""Base class of effects on the light of an image, both built-in and user-defined ones."""

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
    """Effect on the light of an image before the sensor converts it, such as blur, glare or dust.

    A subclass implements `apply` and is selected as 'package.module:Class'. It becomes a dataclass;
    its fields are the parameters of the effect. Their units and bounds are declared with
    `parameter` of aras_visual_servo_base.settings.

    Attributes:
        name: short name, for messages.
        is_random: whether `apply` uses its argument `random`. Random effects are not applied to the
            image that shows the desired view of visual servoing.
    """

    name: ClassVar[str] = ""
    is_random: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        """Make the subclass a dataclass. Its `name` is the class name until it is registered."""
        super().__init_subclass__(**options)
        cls.name = cls.__name__
        dataclass(frozen=True)(cls)

    def __post_init__(self) -> None:
        check(self, CameraError, f"effect {self.name}: ")

    @abstractmethod
    def apply(self, light: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Return the changed light.

        Args:
            light: (rows, columns) or (rows, columns, 3) uint8. It must not be changed in place.
            random: generator of random numbers that depends only on the seed of the camera and the
                stamp of the image.
        """


EFFECTS = Registry("effect", __package__, (Effect,), CameraError)
