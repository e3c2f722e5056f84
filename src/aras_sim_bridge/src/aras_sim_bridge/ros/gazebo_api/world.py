"""World services: pause, unpause, the two resets and get_world_properties."""

from __future__ import annotations

from collections.abc import Callable

from gazebo_msgs.srv import GetWorldProperties
from std_srvs.srv import Empty

from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation


@service_handler(Empty, in_caller_thread=True, call_fails=True)
def pause_physics(thread: SimulationThread, _request: Empty) -> Fields:
    """Let simulated time stand still."""
    thread.pause()


@service_handler(Empty, in_caller_thread=True, call_fails=True)
def unpause_physics(thread: SimulationThread, _request: Empty) -> Fields:
    """Let simulated time run on."""
    thread.unpause()


@service_handler(Empty, call_fails=True)
def reset_world(simulation: Simulation, _request: Empty) -> Fields:
    """Models back to their spawn poses."""
    simulation.reset_world()


@service_handler(GetWorldProperties, "got properties")
def get_world_properties(simulation: Simulation, _request: GetWorldProperties) -> Fields:
    """Time and models."""
    return {
        "sim_time": simulation.time_ns / 1e9,
        "model_names": list(simulation.world.main_models),
        "rendering_enabled": True,
    }


class TimeReset:
    """The reset of everything, time included."""

    def __init__(self, on_time_reset: Callable[[], None]) -> None:
        """`on_time_reset` is called in the simulation's thread when time was set to zero."""
        self._on_time_reset = on_time_reset

    @service_handler(Empty, in_caller_thread=True, call_fails=True)
    def reset_simulation(self, thread: SimulationThread, _request: Empty) -> Fields:
        """Everything as spawned, at time 0."""

        def job() -> None:
            thread.simulation.reset_simulation()
            thread.pacer.restart(thread.simulation.time_ns)
            self._on_time_reset()

        thread.call(job)
