"""ROS interfaces of the robots, cameras and sensors that currently exist in the simulation."""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable

import rospy

from aras_sim_bridge.camera.mounting import MountedCamera
from aras_sim_bridge.controlled_model import ControlledModel
from aras_sim_bridge.ros.camera.topics import CameraTopics
from aras_sim_bridge.ros.control.manager_services import ManagerServices
from aras_sim_bridge.ros.runtime.restart_record import RestartRecord
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.ros.sensors import SensorTopic
from aras_sim_bridge.sensors import PeriodicSensor

log = logging.getLogger(__name__)

# Timeout of `sync`, s of wall time. A spawn that is in progress in the simulation thread may delay
# `sync`.
SYNC_TIMEOUT = 60.0
Entity = ControlledModel | MountedCamera | PeriodicSensor
EntityInterface = ManagerServices | CameraTopics | SensorTopic


class DeviceInterfaces:
    """ROS interfaces: services of each robot, topics of each camera and sensor."""

    def __init__(
        self,
        thread: SimulationThread,
        before_frame: Callable[[], None] | None = None,
        restart_record: RestartRecord | None = None,
    ) -> None:
        """Create an object without interfaces; `sync` opens them.

        Args:
            thread: simulation thread.
            before_frame: function that is called before each camera frame is published, or None.
            restart_record: record of the spawned models on the parameter server.
        """
        self._thread = thread
        self.restart_record = restart_record or RestartRecord(False)
        self._before_frame = before_frame
        self._lock = threading.Lock()
        # ROS interfaces by entity. The value is None if an interface could not be opened; opening
        # is not tried again.
        self._interfaces: dict[Entity, EntityInterface | None] = {}

    def sync(self) -> None:
        """Open the interfaces of new robots, cameras and sensors and close those of removed ones.

        If an interface cannot be opened, an error is logged and the interface is left out. Do not
        call this in the simulation thread, because registration with the ROS master is slow.
        """

        def list_entities() -> list[Entity]:
            simulation = self._thread.simulation
            return [*simulation.robots.values(), *simulation.cameras, *simulation.sensors]

        with self._lock:
            entities = self._thread.call(list_entities, SYNC_TIMEOUT)
            for entity in self._interfaces.keys() - set(entities):
                interface = self._interfaces.pop(entity)
                if interface is not None:
                    interface.shutdown()
            for entity in entities:
                if entity not in self._interfaces:
                    self._interfaces[entity] = self._open(entity)

    def _open(self, entity: Entity) -> EntityInterface | None:
        """Open the interface of a robot, camera or sensor; return None and log if this fails."""
        try:
            if isinstance(entity, ControlledModel):
                what = f"robot '{entity.name}'"
                return ManagerServices(entity, self._thread, self.restart_record)
            if isinstance(entity, PeriodicSensor):
                what = f"sensor '{entity.description.topic}'"
                return SensorTopic(entity, self._thread)
            what = f"camera '{entity.sensor.config.name}'"
            return CameraTopics(entity, self._thread, self._before_frame)
        # A failure must not affect the interfaces of other entities, so catch every exception.
        except Exception as error:
            rospy.logerr(
                "%s is simulated, but has no topics and services: %s; delete its model and spawn "
                "it with other names", what, error,
            )  # fmt: skip
            log.debug("%s", traceback.format_exc())
            return None
