"""Link and joint services, and the topics that set states."""

from __future__ import annotations

from collections.abc import Callable

import rospy
from gazebo_msgs.msg import LinkState, ModelState
from gazebo_msgs.srv import (
    GetJointProperties,
    GetJointPropertiesResponse,
    GetLinkProperties,
    GetLinkPropertiesResponse,
    GetLinkState,
    GetLinkStateResponse,
    SetJointProperties,
    SetJointPropertiesResponse,
    SetLinkProperties,
    SetLinkPropertiesResponse,
    SetLinkState,
    SetLinkStateResponse,
)
from genpy import Message
from geometry_msgs.msg import Point, Pose, Quaternion

from aras_sim_bridge.errors import SimError, WorldError
from aras_sim_bridge.poses import Twist, subtract
from aras_sim_bridge.ros import conversions
from aras_sim_bridge.ros.gazebo_api import entities
from aras_sim_bridge.ros.gazebo_api.models import ModelServices
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.world.changes import with_joint, with_link

JOINT_TYPES = {
    "revolute": GetJointPropertiesResponse.REVOLUTE,
    "continuous": GetJointPropertiesResponse.CONTINUOUS,
    "prismatic": GetJointPropertiesResponse.PRISMATIC,
    "fixed": GetJointPropertiesResponse.FIXED,
}
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# ODE's names of what Bullet's joints have; its motor at rest is Coulomb friction.
JOINT_FIELDS = {"damping": "damping", "hiStop": "upper", "loStop": "lower", "fmax": "friction"}


class LinkServices:
    """Services about the parts of models, and the topics that set states."""

    def __init__(
        self, table: ServiceTable, namespace: str, thread: SimulationThread, models: ModelServices
    ) -> None:
        """Add the services to `table`, and the topics below `namespace`."""
        self._thread = thread
        for name, service, handler in (
            ("get_link_state", GetLinkState, self._get_state),
            ("set_link_state", SetLinkState, self._set_state),
            ("get_link_properties", GetLinkProperties, self._get_link_properties),
            ("set_link_properties", SetLinkProperties, self._set_link_properties),
            ("get_joint_properties", GetJointProperties, self._get_joint_properties),
            ("set_joint_properties", SetJointProperties, self._set_joint_properties),
        ):
            table.add(name, service, handler)
        for topic, message, put in (
            ("set_model_state", ModelState, models.put),
            ("set_link_state", LinkState, self._put),
        ):
            callback = _in_order(thread, topic, put)
            rospy.Subscriber(f"{namespace}/{topic}", message, callback, queue_size=10)

    def _get_state(self, request: GetLinkState) -> GetLinkStateResponse:
        simulation = self._thread.simulation
        model, link = entities.link(simulation, request.link_name)
        frame, frame_twist = entities.frame(simulation, request.reference_frame)
        pose, twist = entities.relative(*model.link_state(link), frame, frame_twist)
        state = LinkState(
            request.link_name,
            conversions.to_pose(pose),
            conversions.to_twist(twist),
            request.reference_frame,
        )
        return GetLinkStateResponse(state, True, "GetLinkState: got state")

    def _set_state(self, request: SetLinkState) -> SetLinkStateResponse:
        self._put(request.link_state)
        return SetLinkStateResponse(True, "SetLinkState: success")

    def _put(self, state: LinkState) -> None:
        """Move a model by its root link; raises SimError naming what is wrong."""
        what = f"'{state.link_name}'"
        pose = conversions.from_pose(state.pose, f"pose of {what}")
        twist = conversions.from_twist(state.twist, f"twist of {what}")
        simulation = self._thread.simulation
        model, link = entities.link(simulation, state.link_name)
        if link != model.description.root:
            raise WorldError(
                f"link {what} hangs on a joint of '{model.name}'; only the root link "
                f"'{model.description.root}' can be put somewhere, joints are set with "
                "set_model_configuration"
            )
        frame, frame_twist = entities.frame(simulation, state.reference_frame)
        model.set_pose(frame @ pose)
        model.set_twist(
            Twist(
                subtract(twist.linear, frame_twist.linear),
                subtract(twist.angular, frame_twist.angular),
            )
        )

    def _get_link_properties(self, request: GetLinkProperties) -> GetLinkPropertiesResponse:
        model, name = entities.link(self._thread.simulation, request.link_name)
        link = model.description.links[name]
        response = GetLinkPropertiesResponse(
            gravity_mode=link.gravity,
            success=True,
            status_message="GetLinkProperties: got properties",
        )
        response.com = Pose(Point(), Quaternion(0.0, 0.0, 0.0, 1.0))
        if link.inertial is not None:
            inertial = link.inertial
            response.com.position = Point(*inertial.origin_xyz)
            response.mass = inertial.mass
            for name, value in zip(INERTIA, inertial.inertia, strict=True):
                setattr(response, name, value)
        return response

    def _get_joint_properties(self, request: GetJointProperties) -> GetJointPropertiesResponse:
        model, name = entities.joint(self._thread.simulation, request.joint_name)
        joint = model.description.joints[name]
        position = rate = 0.0
        if name in model.joint_names:
            positions, velocities, _ = model.read_joints()
            index = model.joint_names.index(name)
            position, rate = positions[index], velocities[index]
        moves = joint.kind in ("revolute", "continuous", "prismatic")
        return GetJointPropertiesResponse(
            type=JOINT_TYPES.get(joint.kind, GetJointPropertiesResponse.BALL),
            damping=[joint.damping] if moves else [],
            position=[position] if moves else [],
            rate=[rate] if moves else [],
            success=True,
            status_message="GetJointProperties: got properties",
        )

    def _set_link_properties(self, request: SetLinkProperties) -> SetLinkPropertiesResponse:
        com = conversions.from_vector(request.com.position, f"com of '{request.link_name}'")
        inertia = tuple(getattr(request, name) for name in INERTIA)
        conversions.bounded((request.mass, *inertia), f"mass and inertia of '{request.link_name}'")

        simulation = self._thread.simulation
        model, link = entities.link(simulation, request.link_name)
        changed = with_link(
            model.description, link, request.mass, com, inertia, request.gravity_mode
        )
        simulation.change(model.name, changed)
        return SetLinkPropertiesResponse(True, "SetLinkProperties: properties set")

    def _set_joint_properties(self, request: SetJointProperties) -> SetJointPropertiesResponse:
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

        simulation = self._thread.simulation
        model, joint = entities.joint(simulation, request.joint_name)
        changed = with_joint(model.description, joint, **values)
        if values:
            simulation.change(model.name, changed)
        text = "SetJointProperties: properties set"
        idle = [name for name in given if name not in JOINT_FIELDS and name != "vel"]
        if idle:
            text += f"; {', '.join(idle)} of ODE have no counterpart and do nothing"
        return SetJointPropertiesResponse(True, text)


def _in_order(
    thread: SimulationThread, topic: str, put: Callable[[Message], None]
) -> Callable[[Message], None]:
    """Return a subscriber's callback that waits until its message was put, and logs a refusal."""

    def on_message(message: Message) -> None:
        try:
            thread.call(lambda: put(message))
        except SimError as error:
            rospy.logerr_throttle(1.0, f"/gazebo/{topic}: {error}")

    return on_message
