"""Light services."""

from __future__ import annotations

from dataclasses import replace

from gazebo_msgs.srv import (
    DeleteLight,
    DeleteLightResponse,
    GetLightProperties,
    GetLightPropertiesResponse,
    SetLightProperties,
    SetLightPropertiesResponse,
)
from std_msgs.msg import ColorRGBA

from aras_sim_bridge.poses import rpy_from_quaternion
from aras_sim_bridge.ros import conversions
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread


class LightServices:
    """Services about lights; the first directional one is the sun of the pictures."""

    def __init__(self, table: ServiceTable, thread: SimulationThread) -> None:
        """Add the services to `table`."""
        self._thread = thread
        table.add("get_light_properties", GetLightProperties, self._get)
        table.add("set_light_properties", SetLightProperties, self._set)
        table.add("delete_light", DeleteLight, self._delete)

    def _get(self, request: GetLightProperties) -> GetLightPropertiesResponse:
        light = self._thread.simulation.light(request.light_name)
        return GetLightPropertiesResponse(
            diffuse=ColorRGBA(*light.diffuse),
            attenuation_constant=light.attenuation_constant,
            attenuation_linear=light.attenuation_linear,
            attenuation_quadratic=light.attenuation_quadratic,
            success=True,
            status_message="GetLightProperties: got properties",
        )

    def _set(self, request: SetLightProperties) -> SetLightPropertiesResponse:
        what = f"light '{request.light_name}'"
        pose = conversions.from_pose(request.pose, f"pose of {what}")
        values = {
            "origin_xyz": pose.xyz,
            "origin_rpy": rpy_from_quaternion(pose.quat),
            "diffuse": _rgba(request.diffuse),
            "specular": _rgba(request.specular),
            "attenuation_constant": request.attenuation_constant,
            "attenuation_linear": request.attenuation_linear,
            "attenuation_quadratic": request.attenuation_quadratic,
            "cast_shadows": request.cast_shadows,
        }
        direction = conversions.from_vector(request.direction, f"direction of {what}")
        note = "set properties"
        if any(direction):
            values["direction"] = direction
        else:
            note += "; the zero direction is none, the light keeps the one it had"

        simulation = self._thread.simulation
        simulation.set_light(replace(simulation.light(request.light_name), **values))
        return SetLightPropertiesResponse(True, f"SetLightProperties: {note}")

    def _delete(self, request: DeleteLight) -> DeleteLightResponse:
        self._thread.simulation.delete_light(request.light_name)
        return DeleteLightResponse(True, f"DeleteLight: deleted '{request.light_name}'")


def _rgba(colour: ColorRGBA) -> tuple[float, float, float, float]:
    return (colour.r, colour.g, colour.b, colour.a)
