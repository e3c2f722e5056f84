"""Link, joint and light services."""

from __future__ import annotations

from typing import Any

import rospy
from gazebo_msgs.msg import LinkState, ModelState
from gazebo_msgs.srv import (
    DeleteLight,
    DeleteLightResponse,
    GetJointProperties,
    GetJointPropertiesResponse,
    GetLightProperties,
    GetLightPropertiesResponse,
    GetLinkProperties,
    GetLinkPropertiesResponse,
    GetLinkState,
    GetLinkStateResponse,
    SetJointProperties,
    SetJointPropertiesResponse,
    SetLightProperties,
    SetLightPropertiesResponse,
    SetLinkProperties,
    SetLinkPropertiesResponse,
    SetLinkState,
    SetLinkStateResponse,
)
from geometry_msgs.msg import Point, Pose, Quaternion

from aras_sim_bridge.errors import SimError, WorldError
from aras_sim_bridge.ros import conversions
from aras_sim_bridge.ros.gazebo_api import entities
from aras_sim_bridge.ros.services import ServiceTable
from aras_sim_bridge.world.poses import Twist, conjugate, rotate, subtract

JOINT_TYPES = {
    "revolute": GetJointPropertiesResponse.REVOLUTE,
    "continuous": GetJointPropertiesResponse.CONTINUOUS,
    "prismatic": GetJointPropertiesResponse.PRISMATIC,
    "fixed": GetJointPropertiesResponse.FIXED,
}


class LinkServices:
    """Services about the parts of models, and the topics that set states."""

    def __init__(self, table: ServiceTable, namespace: str, node: Any, models: Any) -> None:
        """Add the services to `table`; `node` is the GazeboNode, `models` its ModelServices."""
        self._thread = node.thread
        self._models = models
        for name, service, handler, response in (
            ("get_link_state", GetLinkState, self._get_state, GetLinkStateResponse),
            ("set_link_state", SetLinkState, self._set_state, SetLinkStateResponse),
            (
                "get_link_properties",
                GetLinkProperties,
                self._get_link_properties,
                GetLinkPropertiesResponse,
            ),
            (
                "set_link_properties",
                SetLinkProperties,
                self._refuse_link,
                SetLinkPropertiesResponse,
            ),
            (
                "get_joint_properties",
                GetJointProperties,
                self._get_joint_properties,
                GetJointPropertiesResponse,
            ),
            (
                "set_joint_properties",
                SetJointProperties,
                self._refuse_joint,
                SetJointPropertiesResponse,
            ),
            ("delete_light", DeleteLight, _no_light, DeleteLightResponse),
            ("get_light_properties", GetLightProperties, _no_light, GetLightPropertiesResponse),
            ("set_light_properties", SetLightProperties, _no_light, SetLightPropertiesResponse),
        ):
            table.add(
                name,
                service,
                handler,
                lambda text, make=response: make(success=False, status_message=text),
            )
        for topic, message, handler in (
            ("set_model_state", ModelState, models.set_state),
            ("set_link_state", LinkState, self.set_state),
        ):
            callback = _quietly(topic, handler)
            rospy.Subscriber(f"{namespace}/{topic}", message, callback, queue_size=10)

    def _get_state(self, request: GetLinkState) -> GetLinkStateResponse:
        def job() -> tuple[Any, Twist]:
            simulation = self._thread.simulation
            model, link = entities.link(simulation, request.link_name)
            pose, twist = model.link_state(link)
            frame, frame_twist = entities.frame(simulation, request.reference_frame)
            back = conjugate(frame.quat)
            linear = rotate(back, subtract(twist.linear, frame_twist.linear))
            angular = rotate(back, subtract(twist.angular, frame_twist.angular))
            return frame.inverse() @ pose, Twist(linear, angular)

        pose, twist = self._thread.call(job)
        state = LinkState(
            request.link_name,
            conversions.to_pose(pose),
            conversions.to_twist(twist),
            request.reference_frame,
        )
        return GetLinkStateResponse(state, True, "GetLinkState: got state")

    def _set_state(self, request: SetLinkState) -> SetLinkStateResponse:
        self.set_state(request.link_state)
        return SetLinkStateResponse(True, "SetLinkState: success")

    def set_state(self, state: LinkState) -> None:
        """Move a model by its root link; raises SimError naming what is wrong."""
        what = f"'{state.link_name}'"
        pose = conversions.from_pose(state.pose, f"pose of {what}")
        twist = conversions.from_twist(state.twist, f"twist of {what}")

        def job() -> None:
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

        self._thread.call(job)

    def _get_link_properties(self, request: GetLinkProperties) -> GetLinkPropertiesResponse:
        def job() -> Any:
            model, link = entities.link(self._thread.simulation, request.link_name)
            return model.description.links[link]

        link = self._thread.call(job)
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
            names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            for name, value in zip(names, inertial.inertia, strict=True):
                setattr(response, name, value)
        return response

    def _get_joint_properties(self, request: GetJointProperties) -> GetJointPropertiesResponse:
        def job() -> tuple[Any, float, float]:
            model, name = entities.joint(self._thread.simulation, request.joint_name)
            joint = model.description.joints[name]
            if name not in model.joint_names:
                return joint, 0.0, 0.0
            positions, velocities, _ = model.read_joints()
            index = model.joint_names.index(name)
            return joint, positions[index], velocities[index]

        joint, position, rate = self._thread.call(job)
        moves = joint.kind in ("revolute", "continuous", "prismatic")
        return GetJointPropertiesResponse(
            type=JOINT_TYPES.get(joint.kind, GetJointPropertiesResponse.BALL),
            damping=[joint.damping] if moves else [],
            position=[position] if moves else [],
            rate=[rate] if moves else [],
            success=True,
            status_message="GetJointProperties: got properties",
        )

    def _refuse_link(self, request: SetLinkProperties) -> None:
        self._thread.call(lambda: entities.link(self._thread.simulation, request.link_name))
        raise SimError("changing a link's inertia at run time is not supported; spawn it anew")

    def _refuse_joint(self, request: SetJointProperties) -> None:
        self._thread.call(lambda: entities.joint(self._thread.simulation, request.joint_name))
        raise SimError("changing a joint at run time is not supported; spawn the model anew")


def _no_light(request: Any) -> None:
    raise SimError(f"light '{request.light_name}' does not exist")


def _quietly(topic: str, handler: Any) -> Any:
    """Return a subscriber's callback that logs what the handler refuses."""

    def on_message(message: Any) -> None:
        try:
            handler(message)
        except SimError as error:
            rospy.logerr_throttle(1.0, f"/gazebo/{topic}: {error}")

    return on_message
