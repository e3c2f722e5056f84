"""Server for clients of dynamic_reconfigure, such as rqt_reconfigure.

The server in the package dynamic_reconfigure needs a generated ``*Config`` module for each set of
parameters and cannot be shut down. Here, the parameters are given as a list of fields, and the
server can be shut down together with the object that it configures, such as a PID, a control law,
the physics or a camera.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import rospy
from dynamic_reconfigure.msg import (
    BoolParameter,
    Config,
    ConfigDescription,
    DoubleParameter,
    Group,
    GroupState,
    IntParameter,
    ParamDescription,
    StrParameter,
)
from dynamic_reconfigure.srv import Reconfigure, ReconfigureResponse

from aras_visual_servo_ros.parameters import InvalidParameterError, Value

# For each type of a parameter: the list of a Config message that contains such parameters, the type
# of the list's entries, and the Python type of their values.
ENCODINGS = {
    "bool": ("bools", BoolParameter, bool), "int": ("ints", IntParameter, int),
    "str": ("strs", StrParameter, str), "double": ("doubles", DoubleParameter, float),
}  # fmt: skip


@dataclass(frozen=True)
class ReconfigurableParameter:
    """One reconfigurable parameter of type 'double', 'int', 'bool' or 'str'.

    The limits are inclusive; strings have no limits.
    """

    name: str
    type: str
    default: Value
    minimum: Value
    maximum: Value
    description: str = ""
    level: int = 1

    def coerce(self, value: Value) -> Value:
        """Convert `value` to the type of this field and clamp it to the limits.

        Raises:
            InvalidParameterError: the value is NaN, or it is a string and the type of the field is
                not 'str'.
        """
        if self.type == "str":
            return str(value)
        if isinstance(value, str):
            raise InvalidParameterError(f"{self.name} is '{value}', must be of type {self.type}")
        if self.type == "bool":
            return bool(value)
        if value != value:
            raise InvalidParameterError(f"{self.name} is NaN, must be a number")
        limited = min(max(value, self.minimum), self.maximum)
        return int(limited) if self.type == "int" else float(limited)


class ReconfigureServer:
    """Server of set_parameters, parameter_descriptions and parameter_updates in one namespace."""

    def __init__(
        self,
        namespace: str,
        fields: Sequence[ReconfigurableParameter],
        values: Mapping[str, Value],
        apply: Callable[[dict[str, Value]], Mapping[str, Value] | None],
    ) -> None:
        """Advertise the service and topics, and write the values to the parameter server.

        Args:
            namespace: absolute name of the namespace.
            fields: parameters that can be reconfigured.
            values: current values by name. A missing value is set to the default of its field.
            apply: function that is called with the complete new configuration after a
                set_parameters request. It may return the values that are actually in effect. If it
                raises an exception, the error is logged and the old values remain.
        """
        self._namespace = namespace.rstrip("/")
        self._fields = {field.name: field for field in fields}
        self._values = {field.name: values.get(field.name, field.default) for field in fields}
        self._apply = apply
        self._lock = threading.Lock()
        # Requests wait for this lock until the service and the topics are advertised.
        with self._lock:
            self._service = rospy.Service(
                f"{self._namespace}/set_parameters", Reconfigure, self._on_request
            )
            self._descriptions = rospy.Publisher(
                f"{self._namespace}/parameter_descriptions",
                ConfigDescription,
                latch=True,
                queue_size=10,
            )
            self._updates = rospy.Publisher(
                f"{self._namespace}/parameter_updates", Config, latch=True, queue_size=10
            )
            self._descriptions.publish(self._describe())
            self._publish()

    @property
    def values(self) -> dict[str, Value]:
        """Current values by name."""
        with self._lock:
            return dict(self._values)

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set and publish values that were changed elsewhere, for example by another service."""
        with self._lock:
            changed = {
                name: value for name, value in values.items() if self._values.get(name) != value
            }
            if not changed:
                return
            self._values.update(changed)
            self._publish()

    def shutdown(self) -> None:
        """Shut down the service and the topics."""
        self._service.shutdown("no longer served")
        self._descriptions.unregister()
        self._updates.unregister()

    def _on_request(self, request: Reconfigure) -> ReconfigureResponse:
        config = request.config
        with self._lock:
            requested = dict(self._values)
            try:
                for item in [*config.bools, *config.ints, *config.strs, *config.doubles]:
                    if item.name in self._fields:
                        requested[item.name] = self._fields[item.name].coerce(item.value)
                result = self._apply(requested)
                self._values.update(requested if result is None else result)
            except Exception as error:
                rospy.logerr("%s/set_parameters: %s; nothing was changed", self._namespace, error)
            self._publish()
            return ReconfigureResponse(config=self._encode(self._values))

    def _publish(self) -> None:
        self._updates.publish(self._encode(self._values))
        for name, value in self._values.items():
            rospy.set_param(f"{self._namespace}/{name}", value)

    def _encode(self, values: Mapping[str, Value]) -> Config:
        message = Config(groups=[GroupState(name="Default", state=True, id=0, parent=0)])
        for name, field in self._fields.items():
            list_name, kind, convert = ENCODINGS[field.type]
            getattr(message, list_name).append(kind(name, convert(values[name])))
        return message

    def _describe(self) -> ConfigDescription:
        fields = self._fields.values()
        group = Group(name="Default", type="", parent=0, id=0)
        group.parameters = [
            ParamDescription(field.name, field.type, field.level, field.description, "")
            for field in fields
        ]
        return ConfigDescription(
            groups=[group],
            max=self._encode({field.name: field.maximum for field in fields}),
            min=self._encode({field.name: field.minimum for field in fields}),
            dflt=self._encode({field.name: field.default for field in fields}),
        )
