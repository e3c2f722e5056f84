"""Faults of the servo loop. Every message says what, where and how to fix it."""

# Of a target that kinematics have behind the camera, or the image on the far side of its plane.
POINT_BEHIND_CAMERA = "a point of the target lies behind the camera"


class ServoError(Exception):
    """Base class of all errors that the controller reports to its user."""


class ConfigurationError(ServoError):
    """A parameter, goal or configuration file that cannot be used."""


class UnreachableError(ServoError):
    """A camera pose outside the workspace of the arm.

    Attributes:
        excess: how far beyond the reach the wrist would have to go, m.
    """

    def __init__(self, message: str, distance: float) -> None:
        super().__init__(message)
        self.distance = distance


class MeasurementError(ServoError):
    """An image that cannot be servoed on: target lost, wrong size, not finite. The arm holds."""


class TaskError(ServoError):
    """A task that nobody can execute: wrong shapes, numbers that are not finite."""


class SchemeError(ServoError):
    """A scheme that raised, answered what is no decision, or whose L is wrong.

    Attributes:
        trace: its traceback, empty where there is none.
    """

    def __init__(self, message: str, trace: str = "") -> None:
        super().__init__(message)
        self.trace = trace


class SchemeTimeoutError(SchemeError):
    """A scheme whose code has not come to its end within the time that it may take."""
