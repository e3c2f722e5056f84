"""Command streams through the simulation's thread, on a wall clock that the test sets.

Waiting turns the clock, and so do steps; messages arrive at their times in real sockets.
"""

from __future__ import annotations

import bisect
import random
import socket
import struct
import threading

import pytest

from aras_sim_bridge.ros.runtime.lockstep import Lockstep
from aras_sim_bridge.ros.runtime.message_receiver import MessageReceiver, MessageStream
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_ros.send_queue import QueueFlusher

STEP_COST = 60e-6  # s of wall time
LATE = 80e-6  # s that a waiting thread wakes after its time


class Wall:
    now = 100.0

    def __call__(self) -> float:
        return self.now


class CostlySimulation(Simulation):
    """Steps cost wall time; `made` lists when each was made."""

    def __init__(self, wall: Wall) -> None:
        super().__init__(SimulationConfig(ground_plane=False))
        self.wall = wall
        self.made: list[float] = []

    def step(self, until_ns: int = 0) -> None:
        self.made.append(self.wall.now)
        super().step(until_ns)
        self.wall.now += STEP_COST


class Script(MessageReceiver):
    """Messages that arrive at given times; the end of the script ends the thread."""

    def __init__(self, wall: Wall, arrivals: list[float], end: float) -> None:
        super().__init__()
        self.wall = wall
        self.arrivals = [wall.now + time for time in arrivals]
        self.end = wall.now + end
        self.sent = 0
        self.waits = 0
        self.acted: dict[int, float] = {}
        self.order: list[int] = []
        self.over = threading.Event()
        self.after_message = lambda: None
        self._far, self._near = socket.socketpair()
        self.add(MessageStream(self._near, self._act, lambda: None))

    def _act(self, body: bytes) -> None:
        number = int(body)
        self.order.append(number)
        self.acted[number] = self.wall.now
        self.after_message()

    def _deliver(self) -> None:
        here = bisect.bisect_right(self.arrivals, self.wall.now)
        bodies = [str(n).encode() for n in range(self.sent, here)]
        self._far.sendall(b"".join(struct.pack("<I", len(b)) + b for b in bodies))
        self.sent = here

    def deliver(self, time_ns: int, backlog: int) -> bool:
        self._deliver()
        self._look_for_the_end()
        return super().deliver(time_ns, backlog)

    def wait(self, seconds: float | None, commands: bool = True) -> bool:
        self.waits += 1
        end = self.end if seconds is None else self.wall.now + seconds
        came = commands and self.sent < len(self.arrivals) and self.arrivals[self.sent] < end
        self.wall.now = LATE + (self.arrivals[self.sent] if came else end)
        self._deliver()
        self._look_for_the_end()
        return came

    def _look_for_the_end(self) -> None:
        if self.wall.now >= self.end:
            self.over.set()
            super().wait(None)  # for the bell


def run(
    arrivals: list[float], end: float, factor: float = 1.0, **options
) -> tuple[Script, Simulation]:
    """The thread at `factor` while messages 0, 1, ... arrive after so many seconds.

    Whatever arrives, no step is made before its time has come.
    """
    wall = Wall()
    script = Script(wall, arrivals, end)
    pacer = Pacer(factor, wall)
    simulation = CostlySimulation(wall)
    thread = SimulationThread(lambda: simulation, pacer, receiver=script, **options)
    begin = wall.now
    thread.start()
    assert script.over.wait(60.0)
    thread.stop()
    if factor and not options:
        for number, made in enumerate(simulation.made, 1):
            assert (made - begin) * factor >= number * 1e-3 - 1e-9
    return script, simulation


def delays(script: Script) -> list[float]:
    return [time - script.arrivals[number] for number, time in script.acted.items()]


@pytest.mark.parametrize("rate", [1000.0, 700.0, 30.0])
def test_a_stream_in_real_time_acts_in_order_within_two_milliseconds(rate):
    jitter = random.Random(1)
    arrivals = [k / rate + jitter.uniform(0.0, 0.3e-3) for k in range(int(2 * rate))]
    script, simulation = run(arrivals, 2.1)
    assert len(script.acted) >= 0.99 * len(arrivals)
    assert script.order == sorted(script.order)
    late = [delay for delay in delays(script) if delay > 2e-3]
    assert len(late) <= 0.01 * len(arrivals)
    assert simulation.time_ns == pytest.approx(2.1e9, abs=5e6)  # time did not stand behind


def test_after_a_reset_of_time_the_stream_before_does_not_count():
    wall = Wall()
    script = Script(wall, [k / 1000.0 for k in range(500)], 1.0)
    pacer = Pacer(1.0, wall)
    simulation = CostlySimulation(wall)
    resets = []

    def reset() -> None:
        resets.append(script.waits)
        simulation.time_ns = 0
        pacer.restart(0)

    def after_step(time_ns: int) -> None:
        if time_ns == 500_000_000 and not resets:
            thread.post(reset)

    thread = SimulationThread(lambda: simulation, pacer, after_step=after_step, receiver=script)
    thread.start()
    assert script.over.wait(60.0)
    thread.stop()
    assert script.waits - resets[0] <= 140


@pytest.mark.parametrize("at_once", [1, 8])
def test_in_lockstep_each_command_acts_in_a_step_of_its_own(at_once):
    """A gate closes after each step, until a message acts."""
    wall = Wall()
    script = Script(wall, [k // at_once / 100.0 for k in range(80)], 1.0)
    simulation = CostlySimulation(wall)
    acted: list[list[int]] = []

    def after_step(_time_ns: int) -> None:
        gate.start_round()
        acted.append(script.order[sum(map(len, acted)):])

    thread = SimulationThread(
        lambda: simulation, Pacer(0.0, wall), after_step=after_step, receiver=script
    )
    thread.lockstep = gate = Lockstep(["/c"], 60.0, thread.receiver.wake, flusher=QueueFlusher())
    gate.claim("/c")
    script.after_message = lambda: gate.note_message("/c")
    thread.start()
    assert script.over.wait(60.0)
    thread.stop()
    assert acted[:80] == [[number] for number in range(80)]


def test_a_flood_costs_a_message_a_step_and_the_last_one_acts():
    arrivals = [k / 6000.0 for k in range(6000)]
    script, simulation = run(arrivals, 1.2)
    assert len(script.acted) <= 1010
    assert script.order == sorted(script.order)
    assert script.order[-1] == 5999
    # A group of steps takes the newest; only the very last may wait for the next group.
    assert sorted(delays(script))[-5] <= 2e-3 and max(delays(script)) <= 4.5e-3
    assert simulation.time_ns == pytest.approx(1.2e9, abs=5e6)
    assert script.waits <= 500  # one a group of steps: the flood wakes nobody


def test_after_a_stream_the_thread_goes_back_to_groups():
    script, _ = run([k / 1000.0 for k in range(100)], 1.1)
    assert script.waits <= 110 + 260


def test_at_full_speed_what_arrived_before_a_step_acts_in_it():
    script, simulation = run([k / 50_000.0 for k in range(2500)], 0.05, factor=0.0)
    assert simulation.time_ns > 0.4e9
    assert len(script.acted) >= 0.9 * 0.05 / STEP_COST
    assert script.order == sorted(script.order)
    assert max(delays(script)) <= 1.01 * STEP_COST


def test_while_time_stands_still_the_newest_is_heard_and_a_flood_wakes_now_and_then():
    script, simulation = run([k / 6000.0 for k in range(600)], 0.2, paused=True)
    assert simulation.made == []
    assert script.order[-1] == 599
    assert max(delays(script)) <= 0.005
    assert 20 <= script.waits <= 60
