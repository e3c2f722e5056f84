"""Services that read, change and delete lights."""

from __future__ import annotations

from dataclasses import replace

from gazebo_msgs.srv import DeleteLight, GetLightProperties, SetLightProperties
from std_msgs.msg import ColorRGBA

from aras_sim_bridge.ros import conversions
from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.simulation import Simulation

ATTENUATION = ("attenuation_constant", "attenuation_linear", "attenuation_quadratic")


@service_handler(GetLightProperties, "got properties")
def get_light_properties(simulation: Simulation, request: GetLightProperties) -> Fields:
    """Return colour and attenuation of a light."""
    light = simulation.light(request.light_name)
    attenuation = {name: getattr(light, name) for name in ATTENUATION}
    return {"diffuse": ColorRGBA(*light.diffuse), **attenuation}


@service_handler(SetLightProperties)
def set_light_properties(simulation: Simulation, request: SetLightProperties) -> Fields:
    """Set all properties of a light except its type; a zero direction is ignored."""
    what = f"light '{request.light_name}'"
    pose = conversions.from_pose(request.pose, f"pose of {what}")
    values = {
        "origin_xyz": pose.xyz,
        "origin_rpy": pose.rpy,
        "diffuse": _read_rgba(request.diffuse),
        "specular": _read_rgba(request.specular),
        "cast_shadows": request.cast_shadows,
        **{name: getattr(request, name) for name in ATTENUATION},
    }
    direction = conversions.from_vector(request.direction, f"direction of {what}")
    text = "SetLightProperties: set properties"
    if any(direction):
        values["direction"] = direction
    else:
        text += "; the direction is unchanged, because the requested direction is zero"
    simulation.set_light(replace(simulation.light(request.light_name), **values))
    return {"status_message": text}


@service_handler(DeleteLight)
def delete_light(simulation: Simulation, request: DeleteLight) -> Fields:
    """Delete a light."""
    simulation.delete_light(request.light_name)
    return {"status_message": f"DeleteLight: deleted '{request.light_name}'"}


def _read_rgba(colour: ColorRGBA) -> tuple[float, float, float, float]:
    return (colour.r, colour.g, colour.b, colour.a)
