"""Exceptions of the bridge: one base, one subclass a kind of fault."""


class SimError(Exception):
    """Base of every fault the bridge reports; the text says what, where and how to mend it."""


class DescriptionError(SimError):
    """A robot description (URDF and its <gazebo> tags) that cannot be used."""


class WorldError(SimError):
    """The physics world refused a request: unknown model, bad pose, bad step size."""


class HardwareError(SimError):
    """Joints, transmissions or limits that do not make a usable robot."""


class ControllerError(SimError):
    """A controller or the controller manager refused a request."""


class RenderingError(SimError):
    """No renderer, or a renderer that failed."""


class CameraError(SimError):
    """A camera that is configured wrongly or cannot deliver."""
