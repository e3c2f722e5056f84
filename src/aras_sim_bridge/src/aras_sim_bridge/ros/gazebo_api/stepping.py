"""Service step_world, which makes single steps while simulated time is paused.

gazebo_ros has no such service.
"""

from __future__ import annotations

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.conversions import to_time
from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.srv import StepWorld

STEP_LIMIT = 1_000_000  # largest number of steps in one call of the service step_world
STEP_TIMEOUT = 600.0  # timeout of one call of the service step_world, s of wall time


@service_handler(StepWorld, in_caller_thread=True)
def step_world(thread: SimulationThread, request: StepWorld) -> Fields:
    """Make the requested number of steps while simulated time is paused."""
    if not thread.paused:
        raise SimError("simulated time is running; call /gazebo/pause_physics first")
    if not 1 <= request.steps <= STEP_LIMIT:
        raise SimError(f"steps is {request.steps}; give 1 to {STEP_LIMIT}")
    time_ns = thread.step(request.steps, STEP_TIMEOUT)
    return {"status_message": f"made {request.steps} steps", "sim_time": to_time(time_ns)}
