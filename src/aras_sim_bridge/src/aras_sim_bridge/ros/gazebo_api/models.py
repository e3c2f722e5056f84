"""Model services: spawn, delete, state, properties, configuration."""

from __future__ import annotations

from dataclasses import replace

import rospy
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import (
    DeleteModel,
    DeleteModelResponse,
    GetModelProperties,
    GetModelPropertiesResponse,
    GetModelState,
    GetModelStateResponse,
    SetModelConfiguration,
    SetModelConfigurationResponse,
    SetModelState,
    SetModelStateResponse,
    SpawnModel,
    SpawnModelResponse,
)

from aras_sim_bridge.description import Light, packages
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.poses import Pose, Twist, rotate, rpy_from_quaternion
from aras_sim_bridge.ros import conversions
from aras_sim_bridge.ros.camera import settings
from aras_sim_bridge.ros.control.manager_services import robot_parameters
from aras_sim_bridge.ros.gazebo_api import descriptions, entities
from aras_sim_bridge.ros.gazebo_api.forces import ForceServices
from aras_sim_bridge.ros.runtime.graph import OnGraph
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.world import Model

SPAWN_TIMEOUT = 60.0  # seconds of wall time: a large mesh takes its time

LONGEST_NAME = 256  # characters


class ModelServices:
    """Services about whole models."""

    def __init__(
        self,
        table: ServiceTable,
        thread: SimulationThread,
        forces: ForceServices,
        on_graph: OnGraph,
    ) -> None:
        """Add the services to `table`; `forces` and `on_graph` hear of models that come and go."""
        self._thread = thread
        self._forces = forces
        self._on_graph = on_graph
        self._calls: dict[str, int] = {}
        for name, service, handler, outside in (
            ("spawn_urdf_model", SpawnModel, self._spawn_urdf, True),
            ("spawn_sdf_model", SpawnModel, self._spawn_sdf, True),
            ("delete_model", DeleteModel, self._delete, True),
            ("get_model_state", GetModelState, self._get_state, False),
            ("set_model_state", SetModelState, self._set_state, False),
            ("get_model_properties", GetModelProperties, self._get_properties, False),
            ("set_model_configuration", SetModelConfiguration, self._set_configuration, False),
        ):
            table.add(name, service, handler, outside)

    def _spawn_urdf(self, request: SpawnModel) -> SpawnModelResponse:
        text = descriptions.without_prolog(request.model_xml)
        root = descriptions.root_tag(text)
        if root != "robot":
            found = f"<{root}>" if root else "no element"
            self._refuse(f"the model's root is {found}, not <robot>; is it URDF?")
        for package in descriptions.named_packages(text):
            try:
                packages.find(package)
            except SimError as error:
                self._refuse(str(error))
        return self._spawn(request, text)

    def _spawn_sdf(self, request: SpawnModel) -> SpawnModelResponse:
        return self._spawn(request, descriptions.without_prolog(request.model_xml))

    @staticmethod
    def _refuse(why: str) -> None:
        """Make the call itself fail, as upstream does for text that is no URDF."""
        rospy.logerr("spawn_urdf_model: %s", why)
        raise rospy.ServiceException(f"SpawnModel: {why}")

    def _spawn(self, request: SpawnModel, text: str) -> SpawnModelResponse:
        name = request.model_name
        if not name:
            raise SimError("model_name is empty; give the model a name")
        if "::" in name or len(name) > LONGEST_NAME:
            raise SimError(
                f"model_name '{name[:60]}' cannot be: no '::', at most {LONGEST_NAME} characters"
            )
        pose = conversions.from_pose(request.initial_pose, f"initial_pose of '{name}'")
        description = descriptions.parse(text)
        if isinstance(description, Light):
            return self._spawn_light(request, description, pose)
        pose = pose @ Pose.from_rpy(*description.initial_pose)
        for warning in description.warnings:
            rospy.logwarn("model '%s': %s", name, warning)
        namespace = descriptions.robot_namespace(description, request.robot_namespace)
        parameters = robot_parameters(namespace)
        presets = settings.read()

        def job() -> None:
            simulation = self._thread.simulation
            frame, _ = entities.frame(simulation, request.reference_frame)
            simulation.spawn(
                description,
                name,
                pose=frame @ pose,
                namespace=namespace,
                parameters=parameters,
                cameras=presets,
            )

        self._thread.call(job, SPAWN_TIMEOUT)
        settings.warn_of_unused(presets, self._thread, description)
        self._on_graph.sync()
        return SpawnModelResponse(True, f"SpawnModel: Successfully spawned entity '{name}'")

    def _spawn_light(self, request: SpawnModel, light: Light, pose: Pose) -> SpawnModelResponse:
        name = request.model_name
        placed = pose @ Pose.from_rpy(light.origin_xyz, light.origin_rpy)

        def job() -> None:
            simulation = self._thread.simulation
            frame, _ = entities.frame(simulation, request.reference_frame)
            at = frame @ placed
            if name in simulation.lights:
                raise SimError(f"a light named '{name}' exists already; delete it first")
            rpy = rpy_from_quaternion(at.quat)
            simulation.set_light(replace(light, name=name, origin_xyz=at.xyz, origin_rpy=rpy))

        self._thread.call(job)
        text = f"SpawnModel: Successfully spawned entity '{name}'"
        if light.kind != "directional":
            text += f"; a {light.kind} light is kept, but pictures are drawn by the sun alone"
        return SpawnModelResponse(True, text)

    def _delete(self, request: DeleteModel) -> DeleteModelResponse:
        def job() -> None:
            model = entities.model(self._thread.simulation, request.model_name)
            self._forces.forget(model)
            self._thread.simulation.delete(request.model_name)

        self._thread.call(job)
        self._on_graph.sync()
        return DeleteModelResponse(True, f"DeleteModel: deleted '{request.model_name}'")

    def _get_state(self, request: GetModelState) -> GetModelStateResponse:
        simulation = self._thread.simulation
        model = entities.model(simulation, request.model_name)
        root = model.description.root
        frame, frame_twist = entities.frame(simulation, request.relative_entity_name)
        pose, twist = entities.relative(*model.link_state(root), frame, frame_twist)
        response = GetModelStateResponse(
            pose=conversions.to_pose(pose), twist=conversions.to_twist(twist), success=True
        )
        response.status_message = "GetModelState: got properties"
        calls = self._calls[request.model_name] = self._calls.get(request.model_name, 0) + 1
        response.header.seq = calls
        response.header.stamp = conversions.to_time(simulation.time_ns)
        response.header.frame_id = request.relative_entity_name
        return response

    def _set_state(self, request: SetModelState) -> SetModelStateResponse:
        self.put(request.model_state)
        return SetModelStateResponse(True, "SetModelState: set model state done")

    def put(self, state: ModelState) -> None:
        """Move a whole model, in the simulation's thread; raises SimError naming what is wrong."""
        pose = conversions.from_pose(state.pose, f"pose of '{state.model_name}'")
        twist = conversions.from_twist(state.twist, f"twist of '{state.model_name}'")
        simulation = self._thread.simulation
        model = entities.model(simulation, state.model_name)
        frame, _ = entities.frame(simulation, state.reference_frame)
        model.set_pose(frame @ pose)
        model.set_twist(Twist(rotate(frame.quat, twist.linear), rotate(frame.quat, twist.angular)))

    def _get_properties(self, request: GetModelProperties) -> GetModelPropertiesResponse:
        description = entities.model(self._thread.simulation, request.model_name).description
        links = description.links.values()
        return GetModelPropertiesResponse(
            body_names=[link.name for link in links],
            geom_names=[
                collision.name or f"{link.name}_collision"
                for link in links
                for collision in link.collisions
            ],
            joint_names=list(description.joints),
            is_static=description.static,
            success=True,
            status_message="GetModelProperties: got properties",
        )

    def _set_configuration(self, request: SetModelConfiguration) -> SetModelConfigurationResponse:
        names, positions = request.joint_names, request.joint_positions
        if len(names) != len(positions):
            raise SimError(
                f"{len(names)} joint_names but {len(positions)} joint_positions; give as many"
            )
        conversions.bounded(tuple(positions), "joint_positions")
        model = entities.model(self._thread.simulation, request.model_name)
        plain = [name.rpartition("::")[2] for name in names]
        wanted = zip(plain, positions, strict=True)
        model.set_joint_positions(
            {n: within_limits(model, n, q) for n, q in wanted if n in model.joint_names}
        )
        return SetModelConfigurationResponse(True, "SetModelConfiguration: success")


def within_limits(model: Model, joint: str, position: float) -> float:
    """Return the position moved into the joint's limits, as Gazebo's SetPosition does."""
    limits = model.description.joints[joint].limits
    if limits is None or limits.lower is None or position != position:
        return position
    return min(max(position, limits.lower), limits.upper)
