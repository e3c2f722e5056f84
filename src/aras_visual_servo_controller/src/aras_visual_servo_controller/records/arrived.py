"""Whether the camera is at its goal as of one image, and what that leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

from .remedy import Remedy

NOTHING = Remedy()


@dataclass(frozen=True)
class LeftOpen:
    """What an arrival leaves open.

    Attributes:
        distance, angle: 99.7 % bounds on how far the camera is from its goal, m and rad; inf where
            it may be anywhere along a direction, NaN where the scheme has no L to tell them by.
        up_to: the same in words, '180° and 0.6 mm' or '1 direction'; empty where it is next to
            nothing.
        reason, remedy: why, and what would narrow it.
    """

    distance: float = nan
    angle: float = nan
    up_to: str = ""
    reason: str = ""
    remedy: Remedy = NOTHING


@dataclass(frozen=True)
class Arrived:
    """What is known of the arrival as of one image.

    Attributes:
        reached: the camera is at its goal.
        short: why it is not, in words, where the features' tolerances alone would do; else empty.
        elsewhere: why the camera is elsewhere although every feature is at its goal, as text; else
            empty.
        open: what the arrival leaves open; None until the goal is reached.
    """

    reached: bool = False
    short: str = ""
    elsewhere: str = ""
    open: LeftOpen | None = None


NOT_ARRIVED = Arrived()
