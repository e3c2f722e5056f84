"""Frames of plants."""

from aras_visual_servo_controller.observation.frame import Frame


def take_frames(plant, count=1):
    """Return the next frames of a plant, at least this many."""
    found = []
    while len(found) < count:
        found += [one for one in plant.advance(plant.time_ns + 10**9) if isinstance(one, Frame)]
    return found
