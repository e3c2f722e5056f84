"""Errors of the simulator; each message says what is wrong, where, and how to fix it."""


class SimError(Exception):
    """Base class of all errors that the simulator reports to its user."""


class DescriptionError(SimError):
    """A robot or world description (URDF, SDF, mesh, package path) cannot be used.

    Attributes:
        fault: what is wrong, and where.
        remedy: how to fix it; '' if this is clear from the fault.
        path: path of the invalid file; '' if it is unknown.
    """

    def __init__(self, fault: str, remedy: str = "", path: str = "") -> None:
        super().__init__(f"{fault}; {remedy}" if remedy else fault)
        self.fault, self.remedy, self.path = fault, remedy, path


class HandEyeFileError(SimError):
    """The file of a hand-eye calibration is invalid, or does not fit the robot description."""


class NumbaUnavailableError(Exception):
    """Numba, which compiles functions, is not installed or cannot be loaded.

    It is not a SimError, because it is no error in a world or in settings.
    """
