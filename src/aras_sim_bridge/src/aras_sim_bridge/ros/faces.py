"""Keeps the graph in step with the simulation: services per robot, topics per camera."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from aras_sim_bridge.ros.camera_topics import CameraTopics
from aras_sim_bridge.ros.controller_services import ControllerServices
from aras_sim_bridge.ros.lockstep import Lockstep
from aras_sim_bridge.ros.simulation_thread import SimulationThread

SYNC_TIMEOUT = 60.0  # seconds of wall time: a spawn may be under way, and takes its time


class Faces:
    """The ROS faces of what is in the simulation now."""

    def __init__(
        self,
        thread: SimulationThread,
        tick: Callable[[int], None],
        lockstep: Lockstep | None = None,
    ) -> None:
        """Make no face yet; see `sync`.

        Args:
            tick: called with the simulated time [ns] before each camera frame goes out.
            lockstep: lets time wait after each camera frame.
        """
        self._thread = thread
        self._tick = tick
        self._lockstep = lockstep
        self._lock = threading.Lock()
        self._robots: dict[str, tuple[Any, ControllerServices]] = {}
        self._cameras: list[tuple[Any, CameraTopics]] = []

    def sync(self) -> None:
        """Open faces for what is new, close those of what is gone. Not for the simulation's thread:
        registering with the master takes its time."""

        def look() -> tuple[dict[str, Any], list[Any]]:
            simulation = self._thread.simulation
            return dict(simulation.robots), list(simulation.cameras)

        with self._lock:
            robots, cameras = self._thread.call(look, SYNC_TIMEOUT)
            self._close_gone(robots, cameras)
            for name, robot in robots.items():
                if name not in self._robots:
                    self._robots[name] = (robot, ControllerServices(robot, self._thread))
            known = [camera for camera, _ in self._cameras]
            for camera in cameras:
                if not any(camera is other for other in known):
                    self._cameras.append((camera, CameraTopics(camera, self._thread)))
                    camera.on_frame = self._ticked(camera.on_frame)
                    if self._lockstep is not None:
                        camera.on_frame = self._lockstep.wrap(camera.on_frame)

    def _ticked(self, publish: Callable[[Any], None]) -> Callable[[Any], None]:
        def on_frame(frame: Any) -> None:
            self._tick(self._thread.now_ns())
            publish(frame)

        return on_frame

    def _close_gone(self, robots: dict[str, Any], cameras: list[Any]) -> None:
        for name, (robot, face) in list(self._robots.items()):
            if robots.get(name) is not robot:
                face.shutdown()
                del self._robots[name]
        for camera, face in list(self._cameras):
            if not any(camera is other for other in cameras):
                face.shutdown()
                self._cameras = [pair for pair in self._cameras if pair[0] is not camera]
