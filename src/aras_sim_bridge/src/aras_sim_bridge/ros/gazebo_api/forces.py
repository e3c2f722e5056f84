"""apply_body_wrench, apply_joint_effort and their clears: jobs that act during simulated time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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
from aras_sim_bridge.ros.conversions import bounded, from_time, from_vector
from aras_sim_bridge.ros.gazebo_api import entities
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.world.poses import add, cross, rotate, subtract


@dataclass(frozen=True)
class _Job:
    """Something that acts on a model from start to end [ns of simulated time]; end None: for ever.

    `target` is model::link of a wrench, the plain joint name of an effort.
    """

    model: Any
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

    def __init__(self, table: ServiceTable, node: Any) -> None:
        """Add the services to `table`; `node` is the GazeboNode."""
        self._thread = node.thread
        self._jobs: list[_Job] = []
        table.add(
            "apply_body_wrench",
            ApplyBodyWrench,
            self._apply_wrench,
            lambda text: ApplyBodyWrenchResponse(False, text),
        )
        table.add(
            "apply_joint_effort",
            ApplyJointEffort,
            self._apply_effort,
            lambda text: ApplyJointEffortResponse(False, text),
        )
        table.add(
            "clear_body_wrenches",
            BodyRequest,
            lambda request: self._clear(_Wrench, request.body_name) or BodyRequestResponse(),
            lambda _text: BodyRequestResponse(),
        )
        table.add(
            "clear_joint_forces",
            JointRequest,
            lambda request: self._clear(_Effort, request.joint_name) or JointRequestResponse(),
            lambda _text: JointRequestResponse(),
        )

    def forget(self, model: Any) -> None:
        """Drop the jobs of a model that goes; called in the simulation's thread."""
        self._set([job for job in self._jobs if job.model is not model])

    def _apply_wrench(self, request: ApplyBodyWrench) -> ApplyBodyWrenchResponse:
        force = from_vector(request.wrench.force, "force")
        point = from_vector(request.reference_point, "reference_point")
        torque = add(from_vector(request.wrench.torque, "torque"), cross(point, force))

        def job() -> None:
            simulation = self._thread.simulation
            model, link = entities.link(simulation, request.body_name)
            if model.description.links[link].inertial is None:
                raise WorldError(f"link '{request.body_name}' has no mass; nothing can push it")
            world_force, world_torque = force, torque
            if not entities.is_world(simulation, request.reference_frame):
                frame, _ = entities.frame(simulation, request.reference_frame)
                lever = subtract(frame.xyz, model.link_pose(link).xyz)
                world_force = rotate(frame.quat, force)
                world_torque = add(rotate(frame.quat, torque), cross(lever, world_force))
            span = self._span(request.start_time, request.duration)
            target = f"{model.name}::{link}"
            self._set([*self._jobs, _Wrench(model, target, *span, link, world_force, world_torque)])

        self._thread.call(job)
        return ApplyBodyWrenchResponse(True, "")

    def _apply_effort(self, request: ApplyJointEffort) -> ApplyJointEffortResponse:
        bounded((request.effort,), f"effort on '{request.joint_name}'")

        def job() -> None:
            model, joint = entities.joint(self._thread.simulation, request.joint_name)
            if joint not in model.joint_names:
                raise WorldError(f"joint '{request.joint_name}' does not move")
            span = self._span(request.start_time, request.duration)
            self._set([*self._jobs, _Effort(model, joint, *span, request.effort)])

        self._thread.call(job)
        return ApplyJointEffortResponse(True, "ApplyJointEffort: effort set")

    def _clear(self, kind: type[_Job], target: str) -> None:
        def job() -> None:
            self._set(
                [j for j in self._jobs if not (isinstance(j, kind) and j.target == target)]
            )

        self._thread.call(job)

    def _span(self, start: Any, duration: Any) -> tuple[int, int | None]:
        start_ns = max(from_time(start), self._thread.simulation.time_ns)
        length = from_time(duration)
        return start_ns, None if length < 0 else start_ns + length

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
            self._set([j for j in self._jobs if j.end_ns is None or time_ns <= j.end_ns])
