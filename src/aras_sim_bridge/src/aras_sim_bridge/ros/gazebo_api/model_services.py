"""Services that spawn and delete models, and read and set their states and properties."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from xml.etree.ElementTree import Element

import rospy
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import (
    DeleteModel,
    GetModelProperties,
    GetModelState,
    SetModelConfiguration,
    SetModelState,
    SpawnModel,
)
from std_msgs.msg import Header

from aras_sim_bridge.description import Light, packages, shape_meshes
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros import conversions
from aras_sim_bridge.ros.camera import settings
from aras_sim_bridge.ros.gazebo_api import entities, spawn_requests
from aras_sim_bridge.ros.gazebo_api.forces import AppliedForces
from aras_sim_bridge.ros.runtime.device_interfaces import DeviceInterfaces
from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Model
from aras_visual_servo_base.poses import Pose, Twist, rotate
from aras_visual_servo_ros.parameters import get_namespace

SPAWN_TIMEOUT = 60.0  # timeout of a spawn, s of wall time; large meshes take long to load
LONGEST_NAME = 256  # largest length of a model's name, characters


class ModelServices:
    """Services that spawn, delete and read models."""

    def __init__(self, forces: AppliedForces, device_interfaces: DeviceInterfaces) -> None:
        """Create the service handlers.

        Args:
            forces: the handlers remove the forces on a deleted model from it.
            device_interfaces: opens the ROS interfaces of a spawned model and closes those of a
                deleted model.
        """
        self._forces = forces
        self._device_interfaces = device_interfaces
        self._call_counts: Counter[str] = Counter()

    @service_handler(SpawnModel, in_caller_thread=True)
    def spawn_urdf_model(self, thread: SimulationThread, request: SpawnModel) -> Fields:
        """Spawn a model from URDF."""
        root = spawn_requests.parse_root(request.model_xml)
        if root.tag != "robot":
            raise SimError(
                f"the model's root is {spawn_requests.describe_root(root)}, not <robot>; give a "
                "URDF, or use spawn_sdf_model for SDF"
            )
        for package in spawn_requests.find_packages(root):
            packages.find_package(package)
        return self._spawn(thread, request, root, "spawn_urdf_model")

    @service_handler(SpawnModel, in_caller_thread=True)
    def spawn_sdf_model(self, thread: SimulationThread, request: SpawnModel) -> Fields:
        """Spawn a model or a light from SDF or URDF."""
        root = spawn_requests.parse_root(request.model_xml)
        return self._spawn(thread, request, root, "spawn_sdf_model")

    def _spawn(
        self, thread: SimulationThread, request: SpawnModel, root: Element, service: str
    ) -> Fields:
        name = request.model_name
        if not name:
            raise SimError("model_name is empty; give the model a name")
        if "::" in name or len(name) > LONGEST_NAME:
            raise SimError(
                f"model_name '{name[:60]}' is invalid: it must not contain '::' nor exceed "
                f"{LONGEST_NAME} characters"
            )
        pose = conversions.from_pose(request.initial_pose, f"initial_pose of '{name}'")
        spawn_requests.set_namespace(root, request.robot_namespace)
        description = spawn_requests.parse(root)
        success_text = f"SpawnModel: Successfully spawned entity '{name}'"
        if isinstance(description, Light):
            thread.call(lambda: _add_light(thread.simulation, request, description, pose))
            return {"status_message": success_text}
        pose = pose @ Pose.from_rpy(*description.initial_pose)
        for warning in description.warnings:
            rospy.logwarn("model '%s': %s", name, warning)
        # Read the mesh files in this thread, so that the simulation thread does not wait for them.
        shape_meshes.read_mesh_files(description, name)
        namespace = spawn_requests.find_namespace(description, request.robot_namespace)
        parameters = get_namespace(namespace or "/")
        presets = settings.read_cameras()

        def job() -> None:
            frame, _ = entities.find_frame(thread.simulation, request.reference_frame)
            thread.simulation.spawn(
                description, name, frame @ pose, namespace, parameters, cameras=presets
            )

        thread.call(job, SPAWN_TIMEOUT)
        settings.check_unused_names(presets, thread, description)
        self._device_interfaces.sync()
        self._device_interfaces.restart_record.add_model(service, request)
        return {"status_message": success_text}

    @service_handler(DeleteModel, in_caller_thread=True)
    def delete_model(self, thread: SimulationThread, request: DeleteModel) -> Fields:
        """Delete a model together with its topics and services."""

        def job() -> None:
            model = thread.simulation.world.model(request.model_name)
            self._forces.forget(model)
            thread.simulation.delete(request.model_name)

        thread.call(job)
        self._device_interfaces.sync()
        self._device_interfaces.restart_record.remove_model(request.model_name)
        return {"status_message": f"DeleteModel: deleted '{request.model_name}'"}

    @service_handler(GetModelState, "got properties")
    def get_model_state(self, simulation: Simulation, request: GetModelState) -> Fields:
        """Return pose and twist of a model's root link relative to a model, link or the world."""
        model = simulation.world.model(request.model_name)
        root = model.description.root
        frame, frame_twist = entities.find_frame(simulation, request.relative_entity_name)
        pose, twist = entities.express_in_frame(*model.link_state(root), frame, frame_twist)
        self._call_counts[request.model_name] += 1
        stamp = conversions.to_time(simulation.time_ns)
        return {
            "header": Header(
                self._call_counts[request.model_name], stamp, request.relative_entity_name
            ),
            "pose": conversions.to_pose(pose),
            "twist": conversions.to_twist(twist),
        }


@service_handler(SetModelState, "set model state done")
def set_model_state(simulation: Simulation, request: SetModelState) -> Fields:
    """Set pose and twist of a model."""
    move_model(simulation, request.model_state)


def move_model(simulation: Simulation, state: ModelState) -> None:
    """Set pose and twist of a model.

    Raises:
        SimError: a name or a number is invalid.
    """
    pose = conversions.from_pose(state.pose, f"pose of '{state.model_name}'")
    twist = conversions.from_twist(state.twist, f"twist of '{state.model_name}'")
    model = simulation.world.model(state.model_name)
    frame, _ = entities.find_frame(simulation, state.reference_frame)
    model.set_pose(frame @ pose)
    model.set_twist(Twist(rotate(frame.quat, twist.linear), rotate(frame.quat, twist.angular)))


@service_handler(GetModelProperties, "got properties")
def get_model_properties(simulation: Simulation, request: GetModelProperties) -> Fields:
    """Return the names of a model's links, collisions and joints."""
    bodies = [body.description for body in simulation.world.model(request.model_name).bodies]
    links = [link for body in bodies for link in body.links.values()]
    return {
        "body_names": [link.name for link in links],
        "geom_names": [
            collision.name or f"{link.name}_collision"
            for link in links
            for collision in link.collisions
        ],
        "joint_names": [name for body in bodies
                        for name in (*body.joints, *(loop.joint.name for loop in body.loops))],
        "is_static": bodies[0].static,
    }


@service_handler(SetModelConfiguration)
def set_model_configuration(simulation: Simulation, request: SetModelConfiguration) -> Fields:
    """Set joint positions of a model; unknown joint names are ignored, as in Gazebo."""
    names, positions = request.joint_names, request.joint_positions
    if len(names) != len(positions):
        raise SimError(
            f"the request has {len(names)} joint_names but {len(positions)} joint_positions; give "
            "one position for each name"
        )
    model = simulation.world.model(request.model_name)
    plain = [name.rpartition("::")[2] for name in names]
    for name, position in zip(plain, positions, strict=True):
        where = f"joint_positions: joint '{name}' of '{model.name}'"
        conversions.check_bounds((position,), where, conversions.FARTHEST)
    desired, reached = dict(zip(plain, positions, strict=True)), {}
    for body in model.bodies:
        clamped = {
            n: clamp_to_limits(body, n, q) for n, q in desired.items() if n in body.joint_names
        }
        simulation.set_joint_positions(body.name, clamped)
        reached.update(clamped)
    text = "SetModelConfiguration: success"
    for name, position in reached.items():
        if position != desired[name]:
            text += (f"; {name} is set to its limit {position:g}, because {desired[name]:g} is "
                     "beyond it")
    return {"status_message": text}


def clamp_to_limits(model: Model, joint: str, position: float) -> float:
    """Return the position clamped to the joint limits, as Gazebo's SetPosition does."""
    limits = model.description.joints[joint].limits
    if limits is None or limits.lower is None:
        return position
    return min(max(position, limits.lower), limits.upper)


def _add_light(simulation: Simulation, request: SpawnModel, light: Light, pose: Pose) -> None:
    name = request.model_name
    frame, _ = entities.find_frame(simulation, request.reference_frame)
    world_pose = frame @ pose @ light.pose
    if name in simulation.lights:
        raise SimError(f"a light named '{name}' exists already; delete it first")
    simulation.set_light(
        replace(light, name=name, origin_xyz=world_pose.xyz, origin_rpy=world_pose.rpy)
    )
