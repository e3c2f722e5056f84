"""Serving a table of services so that every fault becomes one answer and one log line."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Callable

import rospy

from aras_sim_bridge.errors import SimError

log = logging.getLogger("rosout.services")


class ServiceTable:
    """Services of one namespace that come up and go down together."""

    def __init__(self, namespace: str) -> None:
        """Serve below `namespace`, an absolute name."""
        self._namespace = namespace.rstrip("/")
        self._services: list[rospy.Service] = []

    def add(
        self,
        name: str,
        service: type,
        handler: Callable,
        on_fault: Callable[[str], object],
        call_fails: bool = False,
    ) -> None:
        """Advertise one service.

        Args:
            name: below the namespace.
            handler: takes the request, returns the response; raises SimError for what a client
                did wrong or the simulation cannot do.
            on_fault: makes the response that reports such a fault from its text.
            call_fails: let the client see a failed call (ServiceException) instead.
        """

        kind = service._type.rpartition("/")[2]  # gazebo_ros begins its texts with the type

        def serve(request: object) -> object:
            try:
                return handler(request)
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
            return on_fault(text)

        self._services.append(rospy.Service(f"{self._namespace}/{name}", service, serve))

    def shutdown(self) -> None:
        """Take all of them off the graph."""
        for service in self._services:
            service.shutdown("no longer served")
        self._services.clear()
