"""Faults of what every package reads; each message says what is wrong, where, and the remedy."""


class SimError(Exception):
    """Base class of all errors that the simulator reports to its user."""


class DescriptionError(SimError):
    """A robot or world description (URDF, SDF, mesh, package path) cannot be used.

    fault: what is wrong, and where. remedy: how to fix it; '' where the fault says so itself.
    path: of the file that is at fault, '' where it is not known.
    """

    def __init__(self, fault: str, remedy: str = "", path: str = "") -> None:
        super().__init__(f"{fault}; {remedy}" if remedy else fault)
        self.fault, self.remedy, self.path = fault, remedy, path
