"""Services that apply wrenches to links and efforts to joints for a period of simulated time."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from gazebo_msgs.srv import ApplyBodyWrench, ApplyJointEffort, BodyRequest, JointRequest

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros.conversions import check_bounds, from_time, from_vector
from aras_sim_bridge.ros.gazebo_api import entities
from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Model
from aras_visual_servo_base.poses import add, cross, rotate, subtract


@dataclass(frozen=True)
class _TimedForce:
    """Wrench or effort on a model from `start_ns` to `end_ns`, ns of simulated time.

    If `end_ns` is inf, the force acts until it is cleared. `target` is model::link for a wrench,
    and the name of the joint, without the model, for an effort.
    """

    model: Model
    target: str
    start_ns: int
    end_ns: float


@dataclass(frozen=True)
class _Wrench(_TimedForce):
    link: str
    force: tuple[float, float, float]
    torque: tuple[float, float, float]

    def apply(self) -> None:
        """Apply the force (at the centre of mass) and the torque of the wrench for one step."""
        inertial = self.model.description.links[self.link].inertial
        centre = self.model.link_pose(self.link).apply(inertial.origin_xyz)
        self.model.apply_force(self.link, self.force, centre, self.torque)


@dataclass(frozen=True)
class _Effort(_TimedForce):
    effort: float

    def apply(self) -> None:
        """Apply the effort for one step, in addition to that of the controllers."""
        self.model.apply_effort(self.target, self.effort)


class AppliedForces:
    """Wrenches and efforts that currently act, and the services that set and clear them."""

    def __init__(self, thread: SimulationThread) -> None:
        """Create an empty set of forces."""
        self._thread = thread
        self._forces: list[_TimedForce] = []

    def forget(self, model: Model) -> None:
        """Remove the forces on a model that is deleted. Call this in the simulation thread."""
        self._set_forces([force for force in self._forces if force.model.main_model is not model])

    @service_handler(ApplyBodyWrench)
    def apply_body_wrench(self, simulation: Simulation, request: ApplyBodyWrench) -> Fields:
        """Apply a wrench to a link for a period of time, at a point given in a reference frame."""
        force = from_vector(request.wrench.force, "force")
        point = from_vector(request.reference_point, "reference_point")
        torque = add(from_vector(request.wrench.torque, "torque"), cross(point, force))
        model, link = entities.find_link(simulation, request.body_name)
        if model.description.links[link].inertial is None:
            raise WorldError(
                f"link '{request.body_name}' has no mass; apply the wrench to another link"
            )
        if not entities.is_world(simulation, request.reference_frame):
            frame, _ = entities.find_frame(simulation, request.reference_frame)
            lever = subtract(frame.xyz, model.link_pose(link).xyz)
            force = rotate(frame.quat, force)
            torque = add(rotate(frame.quat, torque), cross(lever, force))
        start_end = _read_interval(simulation, request)
        target = model.get_scoped_name(link)
        self._set_forces([*self._forces, _Wrench(model, target, *start_end, link, force, torque)])

    @service_handler(ApplyJointEffort, "effort set")
    def apply_joint_effort(self, simulation: Simulation, request: ApplyJointEffort) -> Fields:
        """Apply an effort to a joint for a period of time."""
        check_bounds((request.effort,), f"effort on '{request.joint_name}'")
        model, joint = entities.find_joint(simulation, request.joint_name)
        if joint not in model.joint_names:
            raise WorldError(
                f"joint '{request.joint_name}' does not move; give the name of a movable joint"
            )
        start_end = _read_interval(simulation, request)
        self._set_forces([*self._forces, _Effort(model, joint, *start_end, request.effort)])

    @service_handler(BodyRequest)
    def clear_body_wrenches(self, _simulation: Simulation, request: BodyRequest) -> Fields:
        """Remove all wrenches on a link."""
        self._clear(_Wrench, request.body_name)

    @service_handler(JointRequest)
    def clear_joint_forces(self, _simulation: Simulation, request: JointRequest) -> Fields:
        """Remove all efforts on a joint."""
        self._clear(_Effort, request.joint_name)

    def _clear(self, kind: type[_TimedForce], target: str) -> None:
        remaining = [f for f in self._forces if not isinstance(f, kind) or f.target != target]
        self._set_forces(remaining)

    def _set_forces(self, forces: list[_TimedForce]) -> None:
        self._forces = forces
        self._thread.before_step = self._apply_forces if forces else None

    def _apply_forces(self, time_ns: int) -> None:
        """Apply all forces that act during the step that ends at `time_ns` (simulated time, ns)."""
        self._set_forces([force for force in self._forces if time_ns <= force.end_ns])
        for force in self._forces:
            if time_ns >= force.start_ns:
                force.apply()


def _read_interval(
    simulation: Simulation, request: ApplyBodyWrench | ApplyJointEffort
) -> tuple[int, float]:
    start_ns = max(from_time(request.start_time), simulation.time_ns)
    length = from_time(request.duration)
    return start_ns, inf if length < 0 else start_ns + length
