"""A diverging simulation is paused; the node continues, and a reset repairs it."""

import time

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread


class Diverging:
    """Steps until `bad` is true."""

    time_ns = 0
    step_ns = 1_000_000
    bad = False

    def step(self) -> None:
        if self.bad:
            raise WorldError("the simulation diverged")
        self.time_ns += self.step_ns

    def next_image_ns(self) -> None:
        return None

    def close(self) -> None:
        pass


def test_divergence_pauses_and_the_thread_goes_on():
    simulation, faults = Diverging(), []
    thread = SimulationThread(lambda: simulation, Pacer(0.0), on_fault=faults.append)
    thread.start()
    try:
        thread.call(lambda: setattr(simulation, "bad", True))
        end = time.monotonic() + 10.0
        while not thread.paused and time.monotonic() < end:
            time.sleep(0.002)
        assert thread.paused
        assert thread.call(lambda: "alive") == "alive"
        thread.call(lambda: setattr(simulation, "bad", False))
        before = thread.now_ns()
        thread.unpause()
        while thread.now_ns() == before and time.monotonic() < end:
            time.sleep(0.002)
        assert thread.now_ns() > before
        assert not faults
    finally:
        thread.stop()
