"""World services: pause, unpause, the two resets, get_world_properties, step_world."""

from __future__ import annotations

from typing import Any

import rospy
from gazebo_msgs.srv import GetWorldProperties, GetWorldPropertiesResponse
from std_srvs.srv import Empty, EmptyResponse

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.conversions import to_time
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.srv import StepWorld, StepWorldResponse

STEP_LIMIT = 1_000_000  # steps in one call of step_world
STEP_TIMEOUT = 600.0  # seconds of wall time for one call


class WorldServices:
    """Services about the world as a whole."""

    def __init__(self, table: ServiceTable, node: Any) -> None:
        """Add the services to `table`; `node` is the GazeboNode."""
        self._thread = node.thread
        self._node = node
        for name, action in (
            ("pause_physics", self._thread.pause),
            ("unpause_physics", self._thread.unpause),
            ("reset_world", self._reset_world),
            ("reset_simulation", self._reset_simulation),
        ):
            table.add(name, Empty, _empty(action), lambda _text: EmptyResponse(), call_fails=True)
        table.add(
            "get_world_properties",
            GetWorldProperties,
            self._get_properties,
            lambda text: GetWorldPropertiesResponse(success=False, status_message=text),
        )
        table.add(
            "step_world",
            StepWorld,
            self._step,
            lambda text: StepWorldResponse(success=False, status_message=text),
        )

    def _reset_world(self) -> None:
        self._thread.call(self._thread.simulation.reset_world)

    def _reset_simulation(self) -> None:
        def job() -> None:
            self._thread.simulation.reset_simulation()
            self._thread.pacer.restart(self._thread.simulation.time_ns)
            self._node.on_time_reset()

        self._thread.call(job)

    def _get_properties(self, _request: GetWorldProperties) -> GetWorldPropertiesResponse:
        def job() -> tuple[int, list[str]]:
            simulation = self._thread.simulation
            return simulation.time_ns, list(simulation.world.models)

        time_ns, names = self._thread.call(job)
        return GetWorldPropertiesResponse(
            sim_time=time_ns / 1e9,
            model_names=names,
            rendering_enabled=True,
            success=True,
            status_message="GetWorldProperties: got properties",
        )

    def _step(self, request: StepWorld) -> StepWorldResponse:
        if not self._thread.paused:
            raise SimError("simulated time is running; call /gazebo/pause_physics first")
        if not 1 <= request.steps <= STEP_LIMIT:
            raise SimError(f"steps is {request.steps}; give 1 to {STEP_LIMIT}")
        time_ns = self._thread.step(request.steps, STEP_TIMEOUT)
        return StepWorldResponse(True, f"made {request.steps} steps", to_time(time_ns))


def _empty(action: Any) -> Any:
    def serve(_request: Empty) -> EmptyResponse:
        action()
        rospy.logdebug("%s done", action.__name__)
        return EmptyResponse()

    return serve
