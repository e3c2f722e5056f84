"""World services: pause, unpause, the two resets, get_world_properties, step_world."""

from __future__ import annotations

from collections.abc import Callable

import rospy
from gazebo_msgs.srv import GetWorldProperties, GetWorldPropertiesResponse
from std_srvs.srv import Empty, EmptyResponse

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.conversions import to_time
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.srv import StepWorld, StepWorldResponse

STEP_LIMIT = 1_000_000  # steps in one call of step_world
STEP_TIMEOUT = 600.0  # seconds of wall time for one call


class WorldServices:
    """Services about the world as a whole."""

    def __init__(
        self, table: ServiceTable, thread: SimulationThread, on_time_reset: Callable[[], None]
    ) -> None:
        """Add the services to `table`; `on_time_reset` is called when time was set to zero."""
        self._thread = thread
        self._on_time_reset = on_time_reset
        for name, action in (
            ("pause_physics", thread.pause),
            ("unpause_physics", thread.unpause),
            ("reset_world", self._reset_world),
            ("reset_simulation", self._reset_simulation),
        ):
            table.add(name, Empty, _empty(action), call_fails=True)
        table.add("get_world_properties", GetWorldProperties, self._get_properties)
        table.add("step_world", StepWorld, self._step, outside=True)

    def _reset_world(self) -> None:
        self._thread.simulation.reset_world()

    def _reset_simulation(self) -> None:
        simulation = self._thread.simulation
        simulation.reset_simulation()
        self._thread.pacer.restart(simulation.time_ns)
        self._on_time_reset()

    def _get_properties(self, _request: GetWorldProperties) -> GetWorldPropertiesResponse:
        simulation = self._thread.simulation
        return GetWorldPropertiesResponse(
            sim_time=simulation.time_ns / 1e9,
            model_names=list(simulation.world.models),
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


def _empty(action: Callable[[], None]) -> Callable[[Empty], EmptyResponse]:
    def serve(_request: Empty) -> EmptyResponse:
        action()
        rospy.logdebug("%s done", action.__name__)
        return EmptyResponse()

    return serve
