"""What can go wrong in the simulator, one class a kind of fault.

Every message says what is wrong, where, and how to mend it; nodes print it as one line.
"""


class SimError(Exception):
    """Base of all errors of the simulator that a user can mend."""


class DescriptionError(SimError):
    """A robot description that cannot be read or does not make sense."""


class WorldError(SimError):
    """A model that cannot be loaded, found or moved."""


class HardwareError(SimError):
    """A joint, limit or transmission that the hardware layer cannot serve."""


class ControllerError(SimError):
    """A controller that cannot be loaded, started, stopped or updated."""


class RenderingError(SimError):
    """A renderer or a shape that cannot be drawn."""


class CameraError(SimError):
    """A camera whose settings contradict each other or cannot be served."""
