"""The node's own parameters, checked: an unknown or ill-typed one is an error at start."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.reconfigure import PHYSICS_FIELDS

LOG_LEVELS = ("debug", "info", "warn", "error")
SPEED_MODES = ("real_time", "max", "lockstep")
RENDERERS = ("auto", "opengl", "tiny")
# Written by the node itself, or by others who share the namespace with Gazebo.
FOREIGN = {field.name for field in PHYSICS_FIELDS} | {"cameras", "robot_description"}


class ParameterError(SimError):
    """A parameter of the node `gazebo` is unknown, of the wrong type or out of range."""


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
    lockstep_topics: tuple[str, ...] = ()
    lockstep_period: float = 0.0
    lockstep_timeout: float = 5.0

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], namespace: str) -> NodeParameters:
        """Return the parameters of a mapping as the parameter server gives it.

        Raises:
            ParameterError: naming the parameter and the mend.
        """
        known = {field.name: field for field in fields(cls)}
        checked = {}
        for name, value in values.items():
            if name in FOREIGN:
                continue
            if name not in known:
                if isinstance(value, Mapping):
                    continue  # a namespace below ours, e.g. another node's
                near = difflib.get_close_matches(name, known, 1)
                hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
                raise ParameterError(f"unknown parameter {namespace}/{name}; {hint}")
            checked[name] = _convert(f"{namespace}/{name}", value, known[name].default)
        parameters = cls(**checked)
        parameters._check(namespace)
        return parameters

    @property
    def effective_clock_rate(self) -> float:
        """The rate of /clock [Hz]: gazebo_ros's pub_clock_frequency where it is given."""
        return self.clock_rate if self.pub_clock_frequency < 0 else self.pub_clock_frequency

    def _check(self, namespace: str) -> None:
        def require(condition: bool, name: str, what: str) -> None:
            if not condition:
                raise ParameterError(f"{namespace}/{name} is {getattr(self, name)!r}; {what}")

        require(self.speed_mode in SPEED_MODES, "speed_mode", f"choose one of {SPEED_MODES}")
        require(self.renderer in RENDERERS, "renderer", f"choose one of {RENDERERS}")
        require(self.log_level in LOG_LEVELS, "log_level", f"choose one of {LOG_LEVELS}")
        require(self.clock_rate >= 0, "clock_rate", "give Hz, or 0 for every step")
        require(self.real_time_factor > 0, "real_time_factor", "give a positive factor")
        require(self.master_check_period > 0, "master_check_period", "give seconds above 0")


def _convert(name: str, value: Any, default: Any) -> Any:
    """Return value in the type of default; ints pass for floats, nothing else is bent."""
    kind = type(default)
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise ParameterError(f"{name} is {value}; give a finite number")
        return float(value)
    if kind is tuple:
        if isinstance(value, str):
            value = value.split()
        if isinstance(value, list) and all(isinstance(item, str) for item in value):
            return tuple(value)
    elif type(value) is kind:
        return value
    names = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
    wanted = names.get(kind, "a list of texts")
    raise ParameterError(f"{name} is {value!r}, of type {type(value).__name__}; give {wanted}")
