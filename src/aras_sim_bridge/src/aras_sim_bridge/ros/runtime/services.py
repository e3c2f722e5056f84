"""Serving a table of services so that every fault becomes one answer and one log line."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Callable

import rospy
from genpy import Message

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread

log = logging.getLogger("rosout.services")


class ServiceTable:
    """Services of one namespace that come up and go down together."""

    def __init__(self, namespace: str, thread: SimulationThread) -> None:
        """Serve below `namespace`, an absolute name."""
        self._namespace = namespace.rstrip("/")
        self._thread = thread
        self._services: list[rospy.Service] = []

    def add(
        self,
        name: str,
        service: type,
        handler: Callable[[Message], Message],
        outside: bool = False,
        call_fails: bool = False,
    ) -> None:
        """Advertise one service.

        Args:
            name: below the namespace.
            handler: takes the request, returns the response; raises SimError for what a client
                did wrong or the simulation cannot do. Runs in the simulation's thread between two
                steps, so it neither waits nor speaks to the master.
            outside: run the handler in rospy's thread instead, for one that does.
            call_fails: let the client of a fault see a failed call (ServiceException) instead of a
                response with success false and the reason.
        """
        kind = service._type.rpartition("/")[2]  # gazebo_ros begins its texts with the type

        def serve(request: Message) -> Message:
            try:
                if outside:
                    return handler(request)
                return self._thread.call(lambda: handler(request))
            except SimError as error:
                text = f"{kind}: {error}"
                rospy.logerr("%s/%s: %s", self._namespace, name, error)
            except rospy.ServiceException:
                raise
            except Exception as error:
                text = f"{kind}: internal error, {type(error).__name__}: {error}"
                rospy.logerr("%s/%s: %s (please report it)", self._namespace, name, text)
                log.debug("%s", traceback.format_exc())
            if call_fails:
                raise rospy.ServiceException(text)
            response = service._response_class()
            if hasattr(response, "status_message"):
                response.status_message = text
            return response

        self._services.append(rospy.Service(f"{self._namespace}/{name}", service, serve))

    def shutdown(self) -> None:
        """Take all of them off the graph."""
        for service in self._services:
            service.shutdown("no longer served")
        self._services.clear()
