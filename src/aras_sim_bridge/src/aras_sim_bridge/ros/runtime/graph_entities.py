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
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.ros.runtime.spawn_record import SpawnRecord
from aras_sim_bridge.ros.sensors import SensorTopic
from aras_sim_bridge.sensors import RateSensor
from aras_sim_bridge.simulation import ControlledModel

log = logging.getLogger(__name__)

SYNC_TIMEOUT = 60.0  # seconds of wall time: a spawn may be under way, and takes its time
Entity = ControlledModel | MountedCamera | RateSensor
EntityInterface = ManagerServices | CameraTopics | SensorTopic


class GraphEntities:
    """What of the simulation is on the graph: each robot's and each camera's face."""

    def __init__(
        self,
        thread: SimulationThread,
        before_frame: Callable[[], None] | None = None,
        spawn_record: SpawnRecord | None = None,
    ) -> None:
        """Put nothing there yet; see `sync`. `before_frame` is called before a frame goes out."""
        self._thread = thread
        self.spawn_record = spawn_record or SpawnRecord(False)
        self._before_frame = before_frame
        self._lock = threading.Lock()
        # By robot, camera or sensor; None: what could not be opened, which is not tried again.
        self._interfaces: dict[Entity, EntityInterface | None] = {}

    def sync(self) -> None:
        """Open faces for what is new, close those of what is gone. Not for the simulation's thread:
        registering with the master takes its time.

        What cannot be opened is logged and stays without its face; the others get theirs.
        """

        def list_entities() -> list[Entity]:
            simulation = self._thread.simulation
            return [*simulation.robots.values(), *simulation.cameras, *simulation.sensors]

        with self._lock:
            things = self._thread.call(list_entities, SYNC_TIMEOUT)
            self._close_others(things)
            for thing in things:
                if thing not in self._interfaces:
                    self._interfaces[thing] = self._open(thing)

    def _close_others(self, entities: Iterable[Entity]) -> None:
        for thing in self._interfaces.keys() - set(entities):
            face = self._interfaces.pop(thing)
            if face is not None:
                face.shutdown()

    def _open(self, entity: Entity) -> EntityInterface | None:
        """The face of a thing; None, with a log line, where its names cannot be had."""
        try:
            if isinstance(entity, ControlledModel):
                return ManagerServices(entity, self._thread, self.spawn_record)
            if isinstance(entity, RateSensor):
                return SensorTopic(entity, self._thread)
            return CameraTopics(entity, self._thread, self._before_frame)
        except Exception as error:  # whatever it is, the faces of others must not suffer from it
            if isinstance(entity, ControlledModel):
                what = f"robot '{entity.name}'"
            elif isinstance(entity, RateSensor):
                what = f"sensor '{entity.description.topic}'"
            else:
                what = f"camera '{entity.sensor.config.name}'"
            rospy.logerr(
                "%s is simulated, but has no topics and services: %s; delete its model and spawn "
                "it under other names", what, error,
            )  # fmt: skip
            log.debug("%s", traceback.format_exc())
            return None
