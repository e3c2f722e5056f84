"""Services written as functions of the simulation and the request.

    @service_handler(GetLightProperties, "got properties")
    def get_light_properties(simulation: Simulation, request: GetLightProperties) -> Fields:

defines the service `get_light_properties`. A handler returns the fields of the response. A
ServiceTable advertises services; it answers an error with a response and logs it in one line.
"""

from __future__ import annotations

import contextlib
import logging
import traceback
from collections.abc import Callable
from dataclasses import dataclass

import rospy
from genpy import Message

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.simulation_thread import SHUTTING_DOWN, SimulationThread
from aras_visual_servo_base.names import USER_FAULTS

log = logging.getLogger(__name__)

# Values in a service's response, by field name. Fields that are left out have their default values.
Fields = dict[str, object] | None
Handler = Callable[[object, Message], Fields]


@dataclass(frozen=True)
class ServicePolicy:
    """Options of a service handler; see `service_handler`."""

    service: type
    success_text: str
    in_caller_thread: bool
    call_fails: bool

    @property
    def type_name(self) -> str:
        """Name of the service type without its package; status messages start with it."""
        return self.service._type.rpartition("/")[2]

    def make_response(self, fields: Fields) -> Message:
        """Return the response of a successful call."""
        response = self.service._response_class
        text = f"{self.type_name}: {self.success_text}" if self.success_text else ""
        success = {"success": True, "ok": True, "status_message": text}
        defaults = {name: success[name] for name in success if name in response.__slots__}
        return response(**{**defaults, **(fields or {})})


def service_handler(
    service: type, success_text: str = "", in_caller_thread: bool = False, call_fails: bool = False
) -> Callable[[Handler], Handler]:
    """Mark a function or method as the handler of the service of the same name.

    The handler is called with the simulation and the request, in the simulation thread between two
    steps. Therefore it must neither block nor call the ROS master. It returns the fields of the
    response; `success` and `ok` default to true. It raises SimError if the request is invalid or
    cannot be fulfilled.

    Args:
        service: service type.
        success_text: status message of a successful call, without the name of the service type.
        in_caller_thread: whether to call the handler in rospy's thread, where it may block. Its
            first argument is then the SimulationThread instead of the simulation.
        call_fails: whether to report an error as a failed call (ServiceException in the client)
            instead of a response with `success` false and the reason.
    """

    def mark(handler: Handler) -> Handler:
        handler.policy = ServicePolicy(service, success_text, in_caller_thread, call_fails)
        return handler

    return mark


def find_handlers(*places: object) -> list[Handler]:
    """Return all service handlers among the attributes of modules and objects."""
    found = (getattr(place, name) for place in places for name in dir(place))
    return [item for item in found if isinstance(getattr(item, "policy", None), ServicePolicy)]


class ServiceTable:
    """Services of one namespace that are advertised and shut down together."""

    def __init__(
        self,
        namespace: str,
        thread: SimulationThread,
        *handlers: Handler,
        call_lock: contextlib.AbstractContextManager | None = None,
    ) -> None:
        """Advertise the services of `handlers` below `namespace`, an absolute name.

        call_lock: lock that is acquired for each call, so that calls are served one at a time; None
            allows concurrent calls.
        """
        self._namespace = namespace.rstrip("/")
        self._thread = thread
        self._call_lock = call_lock or contextlib.nullcontext()
        self._services: list[rospy.Service] = []
        try:
            for handler in handlers:
                self._advertise(handler)
        except Exception:
            self.shutdown()
            raise

    def _advertise(self, handler: Handler) -> None:
        name = f"{self._namespace}/{handler.__name__}"
        policy: ServicePolicy = handler.policy

        def serve(request: Message) -> Message:
            with self._call_lock:
                return self._call(handler, request, name)

        self._services.append(rospy.Service(name, policy.service, serve))

    def shutdown(self) -> None:
        """Shut down all services of the table."""
        for service in self._services:
            service.shutdown("no longer served")
        self._services.clear()

    def _call(self, handler: Handler, request: Message, name: str) -> Message:
        """Call a handler and return its response, or the response that reports its error.

        `name` is the name of the service, for log messages.

        Raises:
            rospy.ServiceException: the handler failed and its policy is `call_fails`.
        """
        policy, thread = handler.policy, self._thread
        try:
            if policy.in_caller_thread:
                fields = handler(thread, request)
            else:
                fields = thread.call(lambda: handler(thread.simulation, request))
            return policy.make_response(fields)
        except SimError as error:
            text = f"{policy.type_name}: {error}"
            # Do not log an error for calls that are refused during shutdown: spawners normally
            # unload their controllers after Ctrl-C.
            write_log = rospy.logdebug if str(error) == SHUTTING_DOWN else rospy.logerr
            write_log("%s: %s", name, error)
        except rospy.ServiceException:
            raise
        except USER_FAULTS as error:
            text = f"{policy.type_name}: internal error, {type(error).__name__}: {error}"
            rospy.logerr("%s: %s (please report it)", name, text)
            log.debug("%s", traceback.format_exc())
        if policy.call_fails:
            raise rospy.ServiceException(text)
        response = policy.service._response_class()
        if hasattr(response, "status_message"):
            response.status_message = text
        return response
