"""A diverging simulation is paused; the node continues, and a reset repairs it."""

import time

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation, SimulationConfig


def test_divergence_pauses_and_the_thread_goes_on(make):
    faults = []
    thread = SimulationThread(lambda: Simulation(SimulationConfig(ground_plane=False)), Pacer(0.0),
                              on_fault=faults.append)
    thread.start()
    try:
        model = thread.call(lambda: thread.simulation.spawn(parse_urdf(make.rotor()), "m"))
        thread.call(lambda: model.apply_effort("spin", 1e30))
        end = time.monotonic() + 10.0
        while not thread.paused and time.monotonic() < end:
            time.sleep(0.002)
        assert thread.paused
        assert thread.call(lambda: "alive") == "alive"
        thread.call(thread.simulation.reset_simulation)
        before = thread.now_ns()
        thread.unpause()
        while thread.now_ns() == before and time.monotonic() < end:
            time.sleep(0.002)
        assert thread.now_ns() > before
        assert not faults
    finally:
        thread.stop()
