"""The bridge's exceptions: one base, one subclass a kind of fault.

Every message says what is wrong, where (which file, link, joint or parameter), and how to fix it;
the ROS skin logs the text or returns it as a service's status message, unchanged.
"""

from collections.abc import Iterable

from aras_visual_servo_base.errors import DescriptionError as DescriptionError
from aras_visual_servo_base.errors import SimError as SimError


class UnsupportedPartError(DescriptionError):
    """A part of a model that cannot be served; the model is served without it."""


class WorldError(SimError):
    """The physics world refuses a request: unknown name, impossible value, name taken."""


class WindowError(WorldError):
    """Bullet's window cannot be opened on this display."""


class UnknownModelError(WorldError):
    """No model is called `name`; `known` are those that exist."""

    def __init__(self, name: str, available: Iterable[str]) -> None:
        self.name, self.available = name, tuple(available)
        super().__init__(
            f"model '{name}' does not exist; there are: {_format_names(self.available)}"
        )


class UnknownLinkError(WorldError):
    """A model has no link of that name; `known` are those it has."""

    def __init__(self, model: str, link: str, available: Iterable[str]) -> None:
        self.model, self.link, self.available = model, link, tuple(available)
        super().__init__(
            f"model '{model}' has no link '{link}'; it has: {_format_names(self.available)}"
        )


class UnknownJointError(WorldError):
    """A model has no moving joint of that name; `known` are those it has."""

    def __init__(self, model: str, joint: str, available: Iterable[str]) -> None:
        self.model, self.joint, self.available = model, joint, tuple(available)
        super().__init__(
            f"model '{model}' has no moving joint '{joint}'; it has: "
            f"{_format_names(self.available)}"
        )


def _format_names(names: tuple[str, ...]) -> str:
    return ", ".join(names) or "none"


class HardwareError(SimError):
    """Transmissions, joint interfaces or limits do not fit the robot."""


class ControllerError(SimError):
    """A controller cannot be loaded, started, stopped, or refuses its parameters."""


class RenderingError(SimError):
    """No renderer can be made, or the one in use failed."""


class CameraError(SimError):
    """A camera's configuration is impossible or contradicts itself."""
