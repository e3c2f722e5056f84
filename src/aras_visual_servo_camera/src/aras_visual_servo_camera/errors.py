"""Exceptions of the package. Their messages are written for the user."""


class VisionError(Exception):
    """Base class of all exceptions that this package raises on purpose."""


class ImageError(VisionError):
    """An image message that cannot be read because of its encoding, size or data length."""


class InvalidIntrinsicsError(VisionError):
    """Intrinsics (CameraInfo) with which pixels cannot be normalised."""


class SegmentationError(VisionError):
    """A segmentation with invalid settings, or an image that cannot be segmented."""


class MomentsError(VisionError):
    """A shape whose moments cannot be computed or used.

    For example, the shape is empty or has fewer than three points, two of its edges cross, or a
    coordinate is not finite.
    """


class UnavailableFeatureError(VisionError):
    """A feature that does not exist, or whose inputs are missing."""


class DegenerateFeatureError(UnavailableFeatureError):
    """A feature that is undefined for the current shape.

    Attributes:
        name: name of the feature.
        reason: explanation why the feature is undefined.
    """

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"feature '{name}' is undefined for this image: {reason}")
        self.name = name
        self.reason = reason


class TrackingModelError(VisionError):
    """A mesh or a start pose that cannot be used for tracking."""


class VisionParameterError(VisionError):
    """A parameter of the node that is unknown, of the wrong type or out of range."""
