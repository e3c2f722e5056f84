"""Services that read and set states and properties of links and joints."""

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
# Maps ODE's name of a joint property to the name in this simulator. ODE models Coulomb friction by
# a motor that holds the speed 0 with a force of at most fmax.
JOINT_FIELDS = {"damping": "damping", "hiStop": "upper", "loStop": "lower", "fmax": "friction"}


@service_handler(GetLinkState, "got state")
def get_link_state(simulation: Simulation, request: GetLinkState) -> Fields:
    """Return pose and twist of a link relative to another link, a model or the world."""
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
    """Set pose and twist of a model's root link; other links cannot be set."""
    move_link(simulation, request.link_state)
    return {"status_message": "SetLinkState: success"}


def move_link(simulation: Simulation, state: LinkState) -> None:
    """Set pose and twist of a model's root link.

    Raises:
        SimError: a name or a number is invalid, or the link is not a root link.
    """
    what = f"'{state.link_name}'"
    model, link = entities.find_link(simulation, state.link_name)
    if link != model.description.root:
        raise WorldError(
            f"link {what} is not the root link of '{model.name}'; set the pose of the root link "
            f"'{model.description.root}', and joint positions with set_model_configuration"
        )
    pose = conversions.from_pose(state.pose, f"pose of {what}", zero_is_identity=False)
    twist = conversions.from_twist(state.twist, f"twist of {what}")
    frame, frame_twist = entities.find_frame(simulation, state.reference_frame)
    model.set_pose(frame @ pose)
    linear = subtract(twist.linear, frame_twist.linear)
    model.set_twist(Twist(linear, subtract(twist.angular, frame_twist.angular)))


@service_handler(GetLinkProperties, "got properties")
def get_link_properties(simulation: Simulation, request: GetLinkProperties) -> Fields:
    """Return mass, centre of mass, inertia and gravity mode of a link."""
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
    """Set mass, centre of mass, inertia and gravity mode of a link."""
    com = conversions.from_vector(request.com.position, f"com of '{request.link_name}'")
    inertia = tuple(getattr(request, name) for name in INERTIA)
    conversions.check_bounds((request.mass, *inertia), f"mass and inertia of '{request.link_name}'")
    model, link = entities.find_link(simulation, request.link_name)
    changed = change_link(model.description, link, request.mass, com, inertia, request.gravity_mode)
    simulation.world.change_model(model.name, changed)


@service_handler(GetJointProperties, "got properties")
def get_joint_properties(simulation: Simulation, request: GetJointProperties) -> Fields:
    """Return type, damping, position and velocity of a joint."""
    loop_joint = entities.find_loop_joint(simulation, request.joint_name)
    if loop_joint is not None:
        model, loop = loop_joint
        poses = (model.link_pose(link) for link in (loop.joint.parent, loop.joint.child))
        return {"type": JOINT_TYPES[loop.joint.kind], "damping": [0.0], "rate": [0.0],
                "position": [closed_chains.compute_position(loop, *poses)]}
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
    """Set damping, stops and friction of a joint.

    The response lists other requested properties, which are not set.
    """
    config = request.ode_joint_config
    properties: dict[str, float] = {}
    for name in config.__slots__:
        values = getattr(config, name)
        if len(values) > 1:
            raise SimError(
                f"{name} has {len(values)} numbers; joint '{request.joint_name}' has one axis: "
                "give one number"
            )
        if values:
            properties[name] = values[0]
    if properties.get("vel", 0.0) != 0.0:
        raise SimError(f"vel is {properties['vel']}, must be 0; move the joint with a controller")
    values = {JOINT_FIELDS[name]: properties[name] for name in properties if name in JOINT_FIELDS}
    model, joint = entities.find_joint(simulation, request.joint_name)
    changed = change_joint(model.description, joint, **values)
    if values:
        simulation.world.change_model(model.name, changed)
    text = "SetJointProperties: properties set"
    ignored = [name for name in properties if name not in JOINT_FIELDS and name != "vel"]
    if ignored:
        text += f"; these properties are ignored, because only ODE has them: {', '.join(ignored)}"
    return {"status_message": text}
