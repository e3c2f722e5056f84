"""Link and joint services."""

from __future__ import annotations

from gazebo_msgs.msg import LinkState
from gazebo_msgs.srv import (
    GetJointProperties,
    GetJointPropertiesResponse,
    GetLinkProperties,
    GetLinkState,
    SetJointProperties,
    SetLinkProperties,
    SetLinkState,
)
from geometry_msgs.msg import Point, Pose, Quaternion

from aras_sim_bridge.errors import SimError, WorldError
from aras_sim_bridge.ros import conversions
from aras_sim_bridge.ros.gazebo_api import entities
from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import closed_chains
from aras_sim_bridge.world.description_changes import change_joint, change_link
from aras_visual_servo_base.poses import Twist, subtract

JOINT_TYPES = {
    "revolute": GetJointPropertiesResponse.REVOLUTE,
    "continuous": GetJointPropertiesResponse.CONTINUOUS,
    "prismatic": GetJointPropertiesResponse.PRISMATIC,
    "fixed": GetJointPropertiesResponse.FIXED,
}
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# ODE's names of what Bullet's joints have; its motor at rest is Coulomb friction.
JOINT_FIELDS = {"damping": "damping", "hiStop": "upper", "loStop": "lower", "fmax": "friction"}


@service_handler(GetLinkState, "got state")
def get_link_state(simulation: Simulation, request: GetLinkState) -> Fields:
    """Pose and twist of a link, relative to another, a model or the world."""
    model, link = entities.find_link(simulation, request.link_name)
    frame, frame_twist = entities.find_frame(simulation, request.reference_frame)
    pose, twist = entities.express_in_frame(*model.link_state(link), frame, frame_twist)
    return {
        "link_state": LinkState(
            request.link_name,
            conversions.to_pose(pose),
            conversions.to_twist(twist),
            request.reference_frame,
        )
    }


@service_handler(SetLinkState)
def set_link_state(simulation: Simulation, request: SetLinkState) -> Fields:
    """Move a model by its root link."""
    move_link(simulation, request.link_state)
    return {"status_message": "SetLinkState: success"}


def move_link(simulation: Simulation, state: LinkState) -> None:
    """Move a model by its root link; raises SimError naming what is wrong."""
    what = f"'{state.link_name}'"
    model, link = entities.find_link(simulation, state.link_name)
    if link != model.description.root:
        raise WorldError(
            f"link {what} hangs on a joint of '{model.name}'; only the root link "
            f"'{model.description.root}' can be put somewhere, joints are set with "
            "set_model_configuration"
        )
    pose = conversions.from_pose(state.pose, f"pose of {what}", zero_is_identity=False)
    twist = conversions.from_twist(state.twist, f"twist of {what}")
    frame, frame_twist = entities.find_frame(simulation, state.reference_frame)
    model.set_pose(frame @ pose)
    linear = subtract(twist.linear, frame_twist.linear)
    model.set_twist(Twist(linear, subtract(twist.angular, frame_twist.angular)))


@service_handler(GetLinkProperties, "got properties")
def get_link_properties(simulation: Simulation, request: GetLinkProperties) -> Fields:
    """Mass, centre of mass and inertia of a link."""
    model, name = entities.find_link(simulation, request.link_name)
    link = model.description.links[name]
    fields = {"gravity_mode": link.gravity, "com": Pose(Point(), Quaternion(0.0, 0.0, 0.0, 1.0))}
    if link.inertial is not None:
        fields["com"].position = Point(*link.inertial.origin_xyz)
        fields["mass"] = link.inertial.mass
        fields |= zip(INERTIA, link.inertial.inertia, strict=True)
    return fields


@service_handler(SetLinkProperties, "properties set")
def set_link_properties(simulation: Simulation, request: SetLinkProperties) -> Fields:
    """Another mass, centre of mass, inertia; whether gravity pulls."""
    com = conversions.from_vector(request.com.position, f"com of '{request.link_name}'")
    inertia = tuple(getattr(request, name) for name in INERTIA)
    conversions.check_bounds((request.mass, *inertia), f"mass and inertia of '{request.link_name}'")
    model, link = entities.find_link(simulation, request.link_name)
    changed = change_link(model.description, link, request.mass, com, inertia, request.gravity_mode)
    simulation.world.change_model(model.name, changed)
    return None


@service_handler(GetJointProperties, "got properties")
def get_joint_properties(simulation: Simulation, request: GetJointProperties) -> Fields:
    """Type, damping, position and rate of a joint."""
    closing = entities.find_loop_joint(simulation, request.joint_name)
    if closing is not None:
        model, one = closing
        ends = (model.link_pose(end) for end in (one.joint.parent, one.joint.child))
        return {"type": JOINT_TYPES[one.joint.kind], "damping": [0.0], "rate": [0.0],
                "position": [closed_chains.compute_position(one, *ends)]}
    model, name = entities.find_joint(simulation, request.joint_name)
    joint = model.description.joints[name]
    fields: Fields = {"type": JOINT_TYPES.get(joint.kind, GetJointPropertiesResponse.BALL)}
    if joint.kind in ("revolute", "continuous", "prismatic"):
        position = rate = 0.0
        if name in model.joint_names:
            positions, velocities, _ = model.read_joints()
            index = model.joint_names.index(name)
            position, rate = positions[index], velocities[index]
        fields |= {"damping": [joint.damping], "position": [position], "rate": [rate]}
    return fields


@service_handler(SetJointProperties)
def set_joint_properties(simulation: Simulation, request: SetJointProperties) -> Fields:
    """What Bullet's joints have of ODE's numbers; the answer names what does nothing."""
    config = request.ode_joint_config
    given: dict[str, float] = {}
    for name in config.__slots__:
        values = getattr(config, name)
        if len(values) > 1:
            raise SimError(
                f"{name} has {len(values)} numbers; joint '{request.joint_name}' has one axis"
            )
        if values:
            given[name] = values[0]
    if given.get("vel", 0.0) != 0.0:
        raise SimError(f"vel is {given['vel']}; a joint is driven by a controller, give 0")
    values = {JOINT_FIELDS[name]: given[name] for name in given if name in JOINT_FIELDS}
    model, joint = entities.find_joint(simulation, request.joint_name)
    changed = change_joint(model.description, joint, **values)
    if values:
        simulation.world.change_model(model.name, changed)
    text = "SetJointProperties: properties set"
    idle = [name for name in given if name not in JOINT_FIELDS and name != "vel"]
    if idle:
        text += f"; {', '.join(idle)} of ODE have no counterpart and do nothing"
    return {"status_message": text}
