"""Camera settings below the parameter /gazebo/cameras.

They change cameras of spawned robots, or define further cameras that are fixed in the world.
"""

from __future__ import annotations

from collections.abc import Mapping

import rospy

from aras_sim_bridge.camera import mounting
from aras_sim_bridge.description import RobotDescription
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_visual_servo_ros.parameters import get_parameter

# Time to wait until a camera is added, s of wall time. The first camera takes long, because it sets
# up the renderer.
ADD_TIMEOUT = 60.0
_reported_names: set[str] = set()


def read_cameras() -> Mapping[str, object]:
    """Return the camera settings by camera name; log an error if they are not a mapping."""
    values = get_parameter("~cameras")
    if isinstance(values, dict):
        return values
    rospy.logerr("%s is %r, must be a mapping of camera names to settings",
                 rospy.resolve_name("~cameras"), values)
    return {}


def mount_world_cameras(thread: SimulationThread) -> None:
    """Add all cameras whose settings contain `parent: world`.

    An error is logged for a camera with invalid settings.
    """
    for name, settings in mounting.find_world_cameras(read_cameras()):
        try:
            thread.call(lambda n=name, s=settings: thread.simulation.add_camera(n, s), ADD_TIMEOUT)
        except SimError as error:
            rospy.logerr("camera %s/%s is not simulated: "
                         "%s", rospy.resolve_name("~cameras"), name, error)


def check_unused_names(
    settings: Mapping[str, object], thread: SimulationThread, new: RobotDescription
) -> None:
    """Log a warning for camera settings whose camera does not exist, once for each camera name.

    Args:
        settings: settings of all cameras.
        thread: simulation thread.
        new: description of the model that has just been spawned.
    """
    if not new.cameras:
        return
    cameras = thread.call(lambda: list(thread.simulation.cameras))
    names = {camera.sensor.config.camera_name for camera in cameras}
    names |= {camera.name for camera in new.cameras}
    names |= {camera.plugin.camera_name for camera in new.cameras if camera.plugin is not None}
    for name in mounting.find_unused_names(settings, names):
        if name not in _reported_names:
            _reported_names.add(name)
            rospy.logwarn(
                "the settings %s/%s belong to no camera; use the name of an existing camera: %s",
                rospy.resolve_name("~cameras"), name, ", ".join(sorted(filter(None, names))),
            )  # fmt: skip
