"""Trackers: they find the points of a target in an image. `TRACKERS` has them by name."""

from .base import TRACKERS, TrackedPoints, Tracker

__all__ = ["TRACKERS", "TrackedPoints", "Tracker"]
