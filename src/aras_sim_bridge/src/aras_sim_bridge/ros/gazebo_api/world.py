"""World services: pause, unpause, the two resets, get_world_properties, step_world."""

from __future__ import annotations

from collections.abc import Callable

from gazebo_msgs.srv import GetWorldProperties
from std_srvs.srv import Empty

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.conversions import to_time
from aras_sim_bridge.ros.runtime.services import Fields, serves
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.srv import StepWorld

STEP_LIMIT = 1_000_000  # steps in one call of step_world
STEP_TIMEOUT = 600.0  # seconds of wall time for one call


@serves(Empty, outside=True, call_fails=True)
def pause_physics(thread: SimulationThread, _request: Empty) -> Fields:
    """Let simulated time stand still."""
    thread.pause()


@serves(Empty, outside=True, call_fails=True)
def unpause_physics(thread: SimulationThread, _request: Empty) -> Fields:
    """Let simulated time run on."""
    thread.unpause()


@serves(Empty, call_fails=True)
def reset_world(simulation: Simulation, _request: Empty) -> Fields:
    """Models back to their spawn poses."""
    simulation.reset_world()


@serves(GetWorldProperties, "got properties")
def get_world_properties(simulation: Simulation, _request: GetWorldProperties) -> Fields:
    """Time and models."""
    return {
        "sim_time": simulation.time_ns / 1e9,
        "model_names": list(simulation.world.models),
        "rendering_enabled": True,
    }


@serves(StepWorld, outside=True)
def step_world(thread: SimulationThread, request: StepWorld) -> Fields:
    """Make steps while paused."""
    if not thread.paused:
        raise SimError("simulated time is running; call /gazebo/pause_physics first")
    if not 1 <= request.steps <= STEP_LIMIT:
        raise SimError(f"steps is {request.steps}; give 1 to {STEP_LIMIT}")
    time_ns = thread.step(request.steps, STEP_TIMEOUT)
    return {"status_message": f"made {request.steps} steps", "sim_time": to_time(time_ns)}


class TimeReset:
    """The reset of everything, time included."""

    def __init__(self, on_time_reset: Callable[[], None]) -> None:
        """`on_time_reset` is called in the simulation's thread when time was set to zero."""
        self._on_time_reset = on_time_reset

    @serves(Empty, outside=True, call_fails=True)
    def reset_simulation(self, thread: SimulationThread, _request: Empty) -> Fields:
        """Everything as spawned, at time 0."""

        def job() -> None:
            thread.simulation.reset_simulation()
            thread.pacer.restart(thread.simulation.time_ns)
            self._on_time_reset()

        thread.call(job)
