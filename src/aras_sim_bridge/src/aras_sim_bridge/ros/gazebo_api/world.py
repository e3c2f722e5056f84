"""Services that pause, resume and reset the world, and get_world_properties."""

from __future__ import annotations

from gazebo_msgs.srv import GetWorldProperties
from std_srvs.srv import Empty

from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation


@service_handler(Empty, in_caller_thread=True, call_fails=True)
def pause_physics(thread: SimulationThread, _request: Empty) -> Fields:
    """Pause simulated time."""
    thread.pause()


@service_handler(Empty, in_caller_thread=True, call_fails=True)
def unpause_physics(thread: SimulationThread, _request: Empty) -> Fields:
    """Resume simulated time."""
    thread.unpause()


@service_handler(Empty, call_fails=True)
def reset_world(simulation: Simulation, _request: Empty) -> Fields:
    """Move all models back to their initial poses."""
    simulation.reset_world()


@service_handler(GetWorldProperties, "got properties")
def get_world_properties(simulation: Simulation, _request: GetWorldProperties) -> Fields:
    """Return the simulated time and the names of all models."""
    return {
        "sim_time": simulation.time_ns / 1e9,
        "model_names": list(simulation.world.main_models),
        "rendering_enabled": True,
    }


@service_handler(Empty, in_caller_thread=True, call_fails=True)
def reset_simulation(thread: SimulationThread, _request: Empty) -> Fields:
    """Reset models, joints, controllers and time to their initial state."""

    def job() -> None:
        thread.simulation.reset_simulation()
        thread.pacer.restart(thread.simulation.time_ns)
        thread.on_time_reset()

    thread.call(job)
