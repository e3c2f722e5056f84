"""Trackers, which find the points of a target in an image; `TRACKERS` is their registry."""

from .base import TRACKERS, TrackedPoints, Tracker

__all__ = ["TRACKERS", "TrackedPoints", "Tracker"]
