"""/gazebo/cameras on the parameter server: presets of robots' cameras, and cameras of the world."""

from __future__ import annotations

from collections.abc import Mapping

import rospy

from aras_sim_bridge.camera import mounting
from aras_sim_bridge.description import RobotDescription
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_visual_servo_ros.parameters import get_parameter

ADD_TIMEOUT = 60.0  # seconds of wall time: the first camera sets up the renderer
_reported_names: set[str] = set()


def read_cameras() -> Mapping[str, object]:
    """All settings of cameras; empty, with a log line, where there is something else."""
    values = get_parameter("~cameras")
    if isinstance(values, dict):
        return values
    rospy.logerr("%s is %r; give settings by camera name", rospy.resolve_name("~cameras"), values)
    return {}


def mount_world_cameras(thread: SimulationThread) -> None:
    """Put every camera with `parent: world` into the simulation; a wrong one is left out."""
    for name, settings in mounting.find_world_cameras(read_cameras()):
        try:
            thread.call(lambda n=name, s=settings: thread.simulation.add_camera(n, s), ADD_TIMEOUT)
        except SimError as error:
            rospy.logerr("%s/%s is left out: %s", rospy.resolve_name("~cameras"), name, error)


def check_unused_names(
    settings: Mapping[str, object], thread: SimulationThread, new: RobotDescription
) -> None:
    """Say once which settings belong to no camera; `new` is the description just spawned."""
    if not new.cameras:
        return
    cameras = thread.call(lambda: list(thread.simulation.cameras))
    names = {camera.sensor.config.camera_name for camera in cameras}
    names |= {c.name for c in new.cameras}
    names |= {c.plugin.camera_name for c in new.cameras if c.plugin is not None}
    for name in mounting.find_unused_names(settings, names):
        if name not in _reported_names:
            _reported_names.add(name)
            rospy.logwarn(
                "the settings %s/%s belong to no camera; there are %s",
                rospy.resolve_name("~cameras"), name, ", ".join(sorted(filter(None, names))),
            )  # fmt: skip
