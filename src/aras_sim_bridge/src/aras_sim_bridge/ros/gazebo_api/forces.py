"""apply_body_wrench, apply_joint_effort and their clears: jobs that act during simulated time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gazebo_msgs.srv import ApplyBodyWrench, ApplyJointEffort, BodyRequest, JointRequest

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros.conversions import bounded, from_time, from_vector
from aras_sim_bridge.ros.gazebo_api import entities
from aras_sim_bridge.ros.runtime.services import Fields, serves
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Model
from aras_visual_servo_base.poses import add, cross, rotate, subtract


@dataclass(frozen=True)
class _Job:
    """Something that acts on a model from start to end [ns of simulated time]; end None: for ever.

    `target` is model::link of a wrench, the plain joint name of an effort.
    """

    model: Model
    target: str
    start_ns: int
    end_ns: int | None


@dataclass(frozen=True)
class _Wrench(_Job):
    link: str
    force: tuple[float, float, float]
    torque: tuple[float, float, float]

    def act(self) -> None:
        """Force at the centre of mass and torque, world axes, for one step."""
        inertial = self.model.description.links[self.link].inertial
        centre = self.model.link_pose(self.link).apply(inertial.origin_xyz)
        self.model.apply_force(self.link, self.force, centre, self.torque)


@dataclass(frozen=True)
class _Effort(_Job):
    effort: float

    def act(self) -> None:
        """Effort on the joint for one step, on top of what the controllers give."""
        self.model.apply_effort(self.target, self.effort)


class Forces:
    """What pushes at present, and the services that say so."""

    def __init__(self, thread: SimulationThread) -> None:
        """Nothing pushes yet."""
        self._thread = thread
        self._jobs: list[_Job] = []

    def forget(self, model: Model) -> None:
        """Drop the jobs of a model that goes; called in the simulation's thread."""
        self._keep(lambda job: job.model.whole is not model)

    @serves(ApplyBodyWrench)
    def apply_body_wrench(self, simulation: Simulation, request: ApplyBodyWrench) -> Fields:
        """Push a body at a point of the reference frame for a while."""
        force = from_vector(request.wrench.force, "force")
        point = from_vector(request.reference_point, "reference_point")
        torque = add(from_vector(request.wrench.torque, "torque"), cross(point, force))
        model, link = entities.link(simulation, request.body_name)
        if model.description.links[link].inertial is None:
            raise WorldError(f"link '{request.body_name}' has no mass; nothing can push it")
        if not entities.is_world(simulation, request.reference_frame):
            frame, _ = entities.frame(simulation, request.reference_frame)
            lever = subtract(frame.xyz, model.link_pose(link).xyz)
            force = rotate(frame.quat, force)
            torque = add(rotate(frame.quat, torque), cross(lever, force))
        start_end = _span(simulation, request)
        target = model.scoped(link)
        self._set([*self._jobs, _Wrench(model, target, *start_end, link, force, torque)])
        return None

    @serves(ApplyJointEffort, "effort set")
    def apply_joint_effort(self, simulation: Simulation, request: ApplyJointEffort) -> Fields:
        """Push a joint for a while."""
        bounded((request.effort,), f"effort on '{request.joint_name}'")
        model, joint = entities.joint(simulation, request.joint_name)
        if joint not in model.joint_names:
            raise WorldError(f"joint '{request.joint_name}' does not move")
        span = _span(simulation, request)
        self._set([*self._jobs, _Effort(model, joint, *span, request.effort)])
        return None

    @serves(BodyRequest)
    def clear_body_wrenches(self, _simulation: Simulation, request: BodyRequest) -> Fields:
        """Push a body no longer."""
        self._keep(lambda job: not isinstance(job, _Wrench) or job.target != request.body_name)
        return None

    @serves(JointRequest)
    def clear_joint_forces(self, _simulation: Simulation, request: JointRequest) -> Fields:
        """Push a joint no longer."""
        self._keep(lambda job: not isinstance(job, _Effort) or job.target != request.joint_name)
        return None

    def _keep(self, stays: Callable[[_Job], bool]) -> None:
        self._set([job for job in self._jobs if stays(job)])

    def _set(self, jobs: list[_Job]) -> None:
        self._jobs = jobs
        self._thread.before_step = self._act if jobs else None

    def _act(self, time_ns: int) -> None:
        """Apply what is active in the step that ends at time_ns; called before it."""
        over = False
        for job in self._jobs:
            if job.end_ns is not None and time_ns > job.end_ns:
                over = True
            elif time_ns >= job.start_ns:
                job.act()
        if over:
            self._keep(lambda job: job.end_ns is None or time_ns <= job.end_ns)


def _span(
    simulation: Simulation, request: ApplyBodyWrench | ApplyJointEffort
) -> tuple[int, int | None]:
    start_ns = max(from_time(request.start_time), simulation.time_ns)
    length = from_time(request.duration)
    return start_ns, None if length < 0 else start_ns + length
