"""Keeps the graph in step with the simulation: services per robot, topics per camera."""

from __future__ import annotations

import logging
import threading
import traceback
from typing import Any

import rospy

from aras_sim_bridge.ros.camera.camera_topics import CameraTopics
from aras_sim_bridge.ros.control.controller_services import ControllerServices
from aras_sim_bridge.ros.runtime.lockstep import Lockstep
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread

log = logging.getLogger("rosout.faces")

SYNC_TIMEOUT = 60.0  # seconds of wall time: a spawn may be under way, and takes its time


class Faces:
    """The ROS faces of what is in the simulation now."""

    def __init__(
        self,
        thread: SimulationThread,
        lockstep: Lockstep | None = None,
    ) -> None:
        """Make no face yet; see `sync`. `lockstep` lets time wait after each camera frame."""
        self._thread = thread
        self._lockstep = lockstep
        self._lock = threading.Lock()
        # None: what could not be opened; it is not tried again.
        self._robots: dict[str, tuple[Any, ControllerServices | None]] = {}
        self._cameras: list[tuple[Any, CameraTopics | None]] = []

    def sync(self) -> None:
        """Open faces for what is new, close those of what is gone. Not for the simulation's thread:
        registering with the master takes its time.

        What cannot be opened is logged and stays without its face; the others get theirs.
        """

        def look() -> tuple[dict[str, Any], list[Any]]:
            simulation = self._thread.simulation
            return dict(simulation.robots), list(simulation.cameras)

        with self._lock:
            robots, cameras = self._thread.call(look, SYNC_TIMEOUT)
            self._close_gone(robots, cameras)
            for name, robot in robots.items():
                if name not in self._robots:
                    face = _opened(ControllerServices, robot, self._thread, f"robot '{name}'")
                    self._robots[name] = (robot, face)
            known = [camera for camera, _ in self._cameras]
            for camera in cameras:
                if any(camera is other for other in known):
                    continue
                what = f"camera '{camera.sensor.config.name}'"
                face = _opened(CameraTopics, camera, self._thread, what)
                self._cameras.append((camera, face))
                if face is not None and self._lockstep is not None:
                    camera.on_frame = self._lockstep.wrap(camera.on_frame)

    def _close_gone(self, robots: dict[str, Any], cameras: list[Any]) -> None:
        for name, (robot, face) in list(self._robots.items()):
            if robots.get(name) is not robot:
                if face is not None:
                    face.shutdown()
                del self._robots[name]
        for camera, face in list(self._cameras):
            if not any(camera is other for other in cameras):
                if face is not None:
                    face.shutdown()
                self._cameras = [pair for pair in self._cameras if pair[0] is not camera]


def _opened(make: type, thing: Any, thread: SimulationThread, what: str) -> Any:
    """The face of a thing; None, with a log line, where its names cannot be had."""
    try:
        return make(thing, thread)
    except Exception as error:  # whatever it is, the faces of others must not suffer from it
        rospy.logerr(
            "%s is simulated, but has no topics and services: %s; delete its model and spawn it "
            "under other names", what, error,
        )  # fmt: skip
        log.debug("%s", traceback.format_exc())
        return None
