"""Services as functions: what they act on and a request go in, the fields of the answer come out.

    @serves(GetLightProperties, "got properties")
    def get_light_properties(simulation: Simulation, request: GetLightProperties) -> Fields:

is the service get_light_properties of whichever table it is added to. Every fault becomes one
answer and one log line.
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

Fields = dict[str, object] | None  # of an answer that differ from its defaults
Handler = Callable[[object, Message], Fields]


@dataclass(frozen=True)
class ServicePolicy:
    """How a handler is served; see `service_handler`."""

    service: type
    success_text: str
    in_caller_thread: bool
    call_fails: bool

    @property
    def type_name(self) -> str:
        """The type's name without its package: gazebo_ros begins its texts with it."""
        return self.service._type.rpartition("/")[2]

    def make_response(self, fields: Fields) -> Message:
        """The answer of a call that went well."""
        response = self.service._response_class
        text = f"{self.type_name}: {self.success_text}" if self.success_text else ""
        well = {"success": True, "ok": True, "status_message": text}
        given = {name: well[name] for name in well if name in response.__slots__}
        return response(**{**given, **(fields or {})})


def service_handler(
    service: type, success_text: str = "", in_caller_thread: bool = False, call_fails: bool = False
) -> Callable[[Handler], Handler]:
    """Decorator: a function, or method, that serves `service` under its own name.

    It takes the simulation, between two steps in the simulation's thread, so it neither waits nor
    speaks to the master. It raises SimError for what a client did wrong or the simulation cannot
    do. Its answer's `success` or `ok` is true unless it says otherwise.

    Args:
        done: the answer's status message, behind the service type's name.
        outside: call it with the SimulationThread instead, in rospy's thread, where it may wait.
        call_fails: let the client of a fault see a failed call (ServiceException) instead of a
            response with success false and the reason.
    """

    def mark(handler: Handler) -> Handler:
        handler.terms = ServicePolicy(service, success_text, in_caller_thread, call_fails)
        return handler

    return mark


def find_handlers(*places: object) -> list[Handler]:
    """The handlers that modules and objects have."""
    found = (getattr(place, name) for place in places for name in dir(place))
    return [member for member in found if isinstance(getattr(member, "terms", None), ServicePolicy)]


class ServiceTable:
    """Services of one namespace that come up and go down together."""

    def __init__(
        self,
        namespace: str,
        thread: SimulationThread,
        *handlers: Handler,
        call_lock: contextlib.AbstractContextManager | None = None,
    ) -> None:
        """Serve below `namespace`, an absolute name.

        turn: held during a call, so that one at a time is answered; None: any number.
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
        terms: ServicePolicy = handler.terms

        def serve(request: Message) -> Message:
            with self._call_lock:
                return call_handler(handler, request, name, self._thread)

        self._services.append(rospy.Service(name, terms.service, serve))

    def shutdown(self) -> None:
        """Take all of them off the graph."""
        for service in self._services:
            service.shutdown("no longer served")
        self._services.clear()


def call_handler(
    handler: Handler, request: Message, name: str, thread: SimulationThread
) -> Message:
    """Return a handler's answer, or that of its fault; `name` is the service's, for the log.

    Raises:
        rospy.ServiceException: where the call itself shall fail.
    """
    terms: ServicePolicy = handler.terms
    try:
        if terms.in_caller_thread:
            fields = handler(thread, request)
        else:
            fields = thread.call(lambda: handler(thread.simulation, request))
        return terms.make_response(fields)
    except SimError as error:
        text = f"{terms.type_name}: {error}"
        # Who ends at the same Ctrl-C, as spawners do, asks in vain: that is no fault.
        tell = rospy.logdebug if str(error) == SHUTTING_DOWN else rospy.logerr
        tell("%s: %s", name, error)
    except rospy.ServiceException:
        raise
    except USER_FAULTS as error:
        text = f"{terms.type_name}: internal error, {type(error).__name__}: {error}"
        rospy.logerr("%s: %s (please report it)", name, text)
        log.debug("%s", traceback.format_exc())
    if terms.call_fails:
        raise rospy.ServiceException(text)
    response = terms.service._response_class()
    if hasattr(response, "status_message"):
        response.status_message = text
    return response
