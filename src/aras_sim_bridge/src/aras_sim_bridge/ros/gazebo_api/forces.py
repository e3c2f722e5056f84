"""apply_body_wrench, apply_joint_effort and their clears: jobs that act during simulated time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import genpy
from gazebo_msgs.srv import (
    ApplyBodyWrench,
    ApplyBodyWrenchResponse,
    ApplyJointEffort,
    ApplyJointEffortResponse,
    BodyRequest,
    BodyRequestResponse,
    JointRequest,
    JointRequestResponse,
)

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.poses import add, cross, rotate, subtract
from aras_sim_bridge.ros.conversions import bounded, from_time, from_vector
from aras_sim_bridge.ros.gazebo_api import entities
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.world import Model


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


class ForceServices:
    """Services that push."""

    def __init__(self, table: ServiceTable, thread: SimulationThread) -> None:
        """Add the services to `table`."""
        self._thread = thread
        self._jobs: list[_Job] = []
        table.add("apply_body_wrench", ApplyBodyWrench, self._apply_wrench)
        table.add("apply_joint_effort", ApplyJointEffort, self._apply_effort)
        table.add("clear_body_wrenches", BodyRequest, self._clear_wrenches)
        table.add("clear_joint_forces", JointRequest, self._clear_efforts)

    def forget(self, model: Model) -> None:
        """Drop the jobs of a model that goes; called in the simulation's thread."""
        self._keep(lambda job: job.model is not model)

    def _apply_wrench(self, request: ApplyBodyWrench) -> ApplyBodyWrenchResponse:
        force = from_vector(request.wrench.force, "force")
        point = from_vector(request.reference_point, "reference_point")
        torque = add(from_vector(request.wrench.torque, "torque"), cross(point, force))
        simulation = self._thread.simulation
        model, link = entities.link(simulation, request.body_name)
        if model.description.links[link].inertial is None:
            raise WorldError(f"link '{request.body_name}' has no mass; nothing can push it")
        if not entities.is_world(simulation, request.reference_frame):
            frame, _ = entities.frame(simulation, request.reference_frame)
            lever = subtract(frame.xyz, model.link_pose(link).xyz)
            force = rotate(frame.quat, force)
            torque = add(rotate(frame.quat, torque), cross(lever, force))
        span = self._span(request.start_time, request.duration)
        target = f"{model.name}::{link}"
        self._set([*self._jobs, _Wrench(model, target, *span, link, force, torque)])
        return ApplyBodyWrenchResponse(True, "")

    def _apply_effort(self, request: ApplyJointEffort) -> ApplyJointEffortResponse:
        bounded((request.effort,), f"effort on '{request.joint_name}'")
        model, joint = entities.joint(self._thread.simulation, request.joint_name)
        if joint not in model.joint_names:
            raise WorldError(f"joint '{request.joint_name}' does not move")
        span = self._span(request.start_time, request.duration)
        self._set([*self._jobs, _Effort(model, joint, *span, request.effort)])
        return ApplyJointEffortResponse(True, "ApplyJointEffort: effort set")

    def _clear_wrenches(self, request: BodyRequest) -> BodyRequestResponse:
        self._keep(lambda job: not isinstance(job, _Wrench) or job.target != request.body_name)
        return BodyRequestResponse()

    def _clear_efforts(self, request: JointRequest) -> JointRequestResponse:
        self._keep(lambda job: not isinstance(job, _Effort) or job.target != request.joint_name)
        return JointRequestResponse()

    def _span(self, start: genpy.Time, duration: genpy.Duration) -> tuple[int, int | None]:
        start_ns = max(from_time(start), self._thread.simulation.time_ns)
        length = from_time(duration)
        return start_ns, None if length < 0 else start_ns + length

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
