"""Keeps the graph in step with the simulation: services per robot, topics per camera."""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable, Iterable

import rospy

from aras_sim_bridge.camera.mounting import MountedCamera
from aras_sim_bridge.ros.camera.topics import CameraTopics
from aras_sim_bridge.ros.control.manager_services import ManagerServices
from aras_sim_bridge.ros.runtime.record import Record
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import ControlledModel

log = logging.getLogger(__name__)

SYNC_TIMEOUT = 60.0  # seconds of wall time: a spawn may be under way, and takes its time
Face = ManagerServices | CameraTopics


class OnGraph:
    """What of the simulation is on the graph: each robot's and each camera's face."""

    def __init__(
        self,
        thread: SimulationThread,
        before_frame: Callable[[], None] | None = None,
        record: Record | None = None,
    ) -> None:
        """Put nothing there yet; see `sync`. `before_frame` is called before a frame goes out."""
        self._thread = thread
        self.record = record or Record(False)
        self._before_frame = before_frame
        self._lock = threading.Lock()
        # By robot or camera; None: what could not be opened, which is not tried again.
        self._faces: dict[ControlledModel | MountedCamera, Face | None] = {}

    def sync(self) -> None:
        """Open faces for what is new, close those of what is gone. Not for the simulation's thread:
        registering with the master takes its time.

        What cannot be opened is logged and stays without its face; the others get theirs.
        """

        def present() -> list[ControlledModel | MountedCamera]:
            simulation = self._thread.simulation
            return [*simulation.robots.values(), *simulation.cameras]

        with self._lock:
            things = self._thread.call(present, SYNC_TIMEOUT)
            self._close_all_but(things)
            for thing in things:
                if thing not in self._faces:
                    self._faces[thing] = self._opened(thing)

    def _close_all_but(self, things: Iterable[ControlledModel | MountedCamera]) -> None:
        for thing in self._faces.keys() - set(things):
            face = self._faces.pop(thing)
            if face is not None:
                face.shutdown()

    def _opened(self, thing: ControlledModel | MountedCamera) -> Face | None:
        """The face of a thing; None, with a log line, where its names cannot be had."""
        try:
            if isinstance(thing, ControlledModel):
                return ManagerServices(thing, self._thread, self.record)
            return CameraTopics(thing, self._thread, self._before_frame)
        except Exception as error:  # whatever it is, the faces of others must not suffer from it
            what = (
                f"robot '{thing.name}'"
                if isinstance(thing, ControlledModel)
                else f"camera '{thing.sensor.config.name}'"
            )
            rospy.logerr(
                "%s is simulated, but has no topics and services: %s; delete its model and spawn "
                "it under other names", what, error,
            )  # fmt: skip
            log.debug("%s", traceback.format_exc())
            return None
