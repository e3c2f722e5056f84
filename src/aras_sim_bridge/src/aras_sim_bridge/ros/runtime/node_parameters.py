"""Private parameters of the simulator node; unknown names and wrong types are errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from aras_sim_bridge.rendering import EXPOSURES, RENDERERS, SHADOWS
from aras_sim_bridge.ros.runtime.reconfigure_parameters import PHYSICS_FIELDS
from aras_visual_servo_base.settings import build, parameter
from aras_visual_servo_ros.parameters import InvalidParameterError

LOG_LEVELS = ("debug", "info", "warn", "error")
SPEED_MODES = ("real_time", "max", "lockstep")
# Private parameters that belong to other parts of the node. They are not reported as unknown.
OTHER_PARAMETERS = {field.name for field in PHYSICS_FIELDS} | {"cameras", "robot_description"}


@dataclass(frozen=True)
class NodeParameters:
    """Private parameters of the node `gazebo`; the table in the README describes each one."""

    gui: bool = False
    paused: bool = False
    world: str = ""
    renderer: str = parameter("auto", choices=RENDERERS)
    exposure: str = parameter(EXPOSURES[0], choices=EXPOSURES)
    shadows: str = parameter("world", choices=("world", *SHADOWS))
    speed_mode: str = parameter("real_time", choices=SPEED_MODES)
    clock_rate: float = parameter(250.0, "Hz; 0 for every step", least=0.0)
    real_time_factor: float = parameter(1.0, above=0.0)
    seed: int = 0
    legacy_camera_info: bool = False
    enable_ros_network: bool = True
    extra_interfaces: bool = True
    pub_clock_frequency: float = -1.0
    master_check_period: float = parameter(2.0, "s", above=0.0)
    log_level: str = parameter("info", choices=LOG_LEVELS)
    restore: bool = False
    lockstep_topics: tuple[str, ...] = parameter((), splits_words=True)
    lockstep_period: float = 0.0
    lockstep_timeout: float = 5.0

    @classmethod
    def from_mapping(cls, values: Mapping[str, object], namespace: str) -> NodeParameters:
        """Return the parameters in a mapping that was read from the parameter server.

        Nested namespaces and the names in OTHER_PARAMETERS are ignored.

        Raises:
            InvalidParameterError: a parameter is unknown or has an invalid value.
        """
        names = {field.name for field in fields(cls)}
        own_values = {
            name: value
            for name, value in values.items()
            if name in names or name not in OTHER_PARAMETERS and not isinstance(value, Mapping)
        }
        return build(cls, own_values, f"parameter {namespace}/", InvalidParameterError)

    @property
    def effective_clock_rate(self) -> float:
        """Rate of /clock, Hz; gazebo_ros's pub_clock_frequency has priority over clock_rate."""
        return self.clock_rate if self.pub_clock_frequency < 0 else self.pub_clock_frequency
