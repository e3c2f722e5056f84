"""Exceptions of the controller. Each message says what is wrong, where, and how to fix it."""

# Message if kinematics place the target behind the camera, or if the camera views the target's
# back.
POINT_BEHIND_CAMERA = "a point of the target lies behind the camera"


class ServoError(Exception):
    """Base class of all errors that the controller reports to its user."""


class ConfigurationError(ServoError):
    """A parameter, goal or configuration file that cannot be used."""


class UnreachableError(ServoError):
    """A camera pose outside the workspace of the arm.

    Attributes:
        distance: distance between the desired camera position and that of the nearest posture
            found, m.
    """

    def __init__(self, message: str, distance: float) -> None:
        super().__init__(message)
        self.distance = distance


class MeasurementError(ServoError):
    """An image that cannot be used for control: target lost, wrong size, or values not finite.

    The arm stays where it is until a usable image arrives.
    """


class InvalidTaskError(ServoError):
    """A task that cannot be executed: arrays of wrong shapes, or values that are not finite."""


class SchemeError(ServoError):
    """A failure of a scheme.

    The scheme raised an exception, returned a wrong type, or computed a wrong L.

    Attributes:
        trace: traceback of the exception; empty if the scheme raised none.
    """

    def __init__(self, message: str, trace: str = "") -> None:
        super().__init__(message)
        self.trace = trace


class InteractionMatrixError(SchemeError):
    """An interaction matrix that differs from finite differences.

    Attributes:
        check: the InteractionCheck with all values.
    """

    def __init__(self, message: str, check: object) -> None:
        super().__init__(message)
        self.check = check


class UnresponsiveSchemeError(SchemeError):
    """A scheme whose code did not return within its time limit."""
