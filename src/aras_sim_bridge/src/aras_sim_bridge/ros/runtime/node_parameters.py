"""The node's own parameters, checked: an unknown or ill-typed one is an error at start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from aras_sim_bridge.ros.runtime.reconfigure import PHYSICS_FIELDS
from aras_visual_servo_ros.parameters import InvalidParameterError, read

LOG_LEVELS = ("debug", "info", "warn", "error")
SPEED_MODES = ("real_time", "max", "lockstep")
RENDERERS = ("auto", "exact", "tiny", "opengl")
# Written by the node itself, or by others who share the namespace with Gazebo.
FOREIGN = {field.name for field in PHYSICS_FIELDS} | {"cameras", "robot_description"}


@dataclass(frozen=True)
class NodeParameters:
    """Private parameters of the node `gazebo`; the README's table says what each one does."""

    gui: bool = False
    paused: bool = False
    world: str = ""
    renderer: str = "auto"
    speed_mode: str = "real_time"
    clock_rate: float = 250.0
    real_time_factor: float = 1.0
    seed: int = 0
    legacy_camera_info: bool = False
    enable_ros_network: bool = True
    pub_clock_frequency: float = -1.0
    master_check_period: float = 2.0
    log_level: str = "info"
    restore: bool = False
    lockstep_topics: tuple[str, ...] = ()
    lockstep_period: float = 0.0
    lockstep_timeout: float = 5.0

    @classmethod
    def from_mapping(cls, values: Mapping[str, object], namespace: str) -> NodeParameters:
        """Return the parameters of a mapping as the parameter server gives it.

        Raises:
            InvalidParameterError: naming the parameter and the mend.
        """
        defaults = {field.name: field.default for field in fields(cls)}
        parameters = cls(**read(values, defaults, namespace, FOREIGN))
        parameters._check(namespace)
        return parameters

    @property
    def effective_clock_rate(self) -> float:
        """The rate of /clock [Hz]: gazebo_ros's pub_clock_frequency where it is given."""
        return self.clock_rate if self.pub_clock_frequency < 0 else self.pub_clock_frequency

    def _check(self, namespace: str) -> None:
        def require(condition: bool, name: str, what: str) -> None:
            if not condition:
                value = getattr(self, name)
                raise InvalidParameterError(f"{namespace}/{name}", f"is {value!r}; {what}")

        require(self.speed_mode in SPEED_MODES, "speed_mode", f"choose one of {SPEED_MODES}")
        require(self.renderer in RENDERERS, "renderer", f"choose one of {RENDERERS}")
        require(self.log_level in LOG_LEVELS, "log_level", f"choose one of {LOG_LEVELS}")
        require(self.clock_rate >= 0, "clock_rate", "give Hz, or 0 for every step")
        require(self.real_time_factor > 0, "real_time_factor", "give a positive factor")
        require(self.master_check_period > 0, "master_check_period", "give seconds above 0")
