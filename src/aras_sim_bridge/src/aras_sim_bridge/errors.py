"""Exceptions of the simulator: one base class and one subclass per kind of error.

Every message states what is wrong, where (file, link, joint or parameter) and how to fix it. The
ROS layer logs the message or returns it as the `status_message` of a service response.
"""

from collections.abc import Iterable

from aras_visual_servo_base.errors import DescriptionError as DescriptionError
from aras_visual_servo_base.errors import SimError as SimError


class UnsupportedPartError(DescriptionError):
    """A part of a model is not supported; the model is simulated without this part."""


class WorldError(SimError):
    """The physics world rejects a request, e.g. for an unknown name or an invalid value."""


class WindowError(WorldError):
    """Bullet's window cannot be opened on this display."""


class UnknownModelError(WorldError):
    """The world has no model `name`; `available` lists the names of the existing models."""

    def __init__(self, name: str, available: Iterable[str]) -> None:
        self.name, self.available = name, tuple(available)
        super().__init__(
            f"model '{name}' does not exist; existing models: {_format_names(self.available)}"
        )


class UnknownLinkError(WorldError):
    """A model has no link of this name; `available` lists the names of its links."""

    def __init__(self, model: str, link: str, available: Iterable[str]) -> None:
        self.model, self.link, self.available = model, link, tuple(available)
        super().__init__(
            f"model '{model}' has no link '{link}'; its links: {_format_names(self.available)}"
        )


class UnknownJointError(WorldError):
    """A model has no movable joint of this name; `available` lists its movable joints."""

    def __init__(self, model: str, joint: str, available: Iterable[str]) -> None:
        self.model, self.joint, self.available = model, joint, tuple(available)
        super().__init__(
            f"model '{model}' has no moving joint '{joint}'; its moving joints: "
            f"{_format_names(self.available)}"
        )


def _format_names(names: tuple[str, ...]) -> str:
    return ", ".join(names) or "none"


class HardwareError(SimError):
    """Transmissions, joint interfaces or joint limits are inconsistent with the robot."""


class ControllerError(SimError):
    """A controller cannot be loaded, started or stopped, or its parameters are invalid."""


class RenderingError(SimError):
    """A renderer cannot be created or has failed."""


class CameraError(SimError):
    """The configuration of a camera is invalid or inconsistent."""
