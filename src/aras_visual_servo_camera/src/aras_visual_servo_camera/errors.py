"""Faults of this package: one base class, one subclass a kind, each message ready to be shown."""


class VisionError(Exception):
    """Base of every fault that this package raises on purpose."""


class ImageError(VisionError):
    """An image message that cannot be read: encoding, size or length of the data."""


class CalibrationError(VisionError):
    """A camera_info that no pixel can be normalised with."""


class SegmentationError(VisionError):
    """A segmentation that was asked for with impossible settings."""


class MomentsError(VisionError):
    """A shape that has no usable moments: empty, too few points, crossing edges, not finite."""


class FeatureError(VisionError):
    """A feature that does not exist or that lacks what it needs."""


class DegenerateFeatureError(FeatureError):
    """A feature that is undefined for this shape.

    Attributes:
        name: the feature.
        reason: why it is undefined, in words.
    """

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"feature '{name}' is undefined here: {reason}")
        self.name = name
        self.reason = reason


class ModelError(VisionError):
    """A mesh that no pose can be tracked by: open, inside out, or not in metres."""


class ParameterError(VisionError):
    """A parameter of the node that is unknown, ill-typed or out of range."""
