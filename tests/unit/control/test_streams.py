"""Streams of commands through the simulation's thread, on a wall clock that the test turns.

Waiting turns the clock, and so do steps; messages arrive at their times in real sockets.
"""

from __future__ import annotations

import bisect
import random
import socket
import struct
import threading

import pytest

from aras_sim_bridge.ros.runtime.inbox import Inbox, Stream
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread

STEP_COST = 60e-6  # s of wall time
LATE = 80e-6  # s that a waiting thread wakes after its time


class Wall:
    now = 100.0

    def __call__(self) -> float:
        return self.now


class Simulation:
    """Steps cost wall time; `made` lists when each was made."""

    def __init__(self, wall: Wall, step_ns: int) -> None:
        self.wall = wall
        self.time_ns = 0
        self.step_ns = step_ns
        self.made: list[float] = []

    def step(self) -> None:
        self.made.append(self.wall.now)
        self.time_ns += self.step_ns
        self.wall.now += STEP_COST

    def next_picture_ns(self) -> None:
        return None

    def close(self) -> None:
        pass


class Script(Inbox):
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
        self._far, near = socket.socketpair()
        self._near = near
        self.add(Stream(near, self._act, lambda: None))

    def _act(self, body: bytes) -> None:
        number = int(body)
        self.order.append(number)
        self.acted[number] = self.wall.now

    def _deliver(self) -> None:
        here = bisect.bisect_right(self.arrivals, self.wall.now)
        bodies = [str(n).encode() for n in range(self.sent, here)]
        self._far.sendall(b"".join(struct.pack("<I", len(b)) + b for b in bodies))
        self.sent = here

    def take(self, time_ns: int, backlog: int) -> bool:
        self._deliver()
        self._look_for_the_end()
        return super().take(time_ns, backlog)

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
    arrivals: list[float], end: float, factor: float = 1.0, step_ns: int = 1_000_000
) -> tuple[Script, Simulation]:
    """The thread at `factor` while messages 0, 1, ... arrive after so many seconds."""
    wall = Wall()
    script = Script(wall, arrivals, end)
    thread = SimulationThread(
        lambda: Simulation(wall, step_ns), Pacer(factor, wall), inbox=script
    )
    thread.start()
    assert script.over.wait(60.0)
    thread.stop()
    return script, thread.simulation


def delays(script: Script) -> list[float]:
    return [time - script.arrivals[number] for number, time in script.acted.items()]


@pytest.mark.parametrize("rate", [1000.0, 700.0, 250.0, 30.0])
def test_a_stream_in_real_time_acts_in_order_within_two_milliseconds(rate):
    jitter = random.Random(1)
    arrivals = [k / rate + jitter.uniform(0.0, 0.3e-3) for k in range(int(2 * rate))]
    script, simulation = run(arrivals, 2.1)
    assert len(script.acted) >= 0.99 * len(arrivals)
    assert script.order == sorted(script.order)
    late = [delay for delay in delays(script) if delay > 2e-3]
    assert len(late) <= 0.01 * len(arrivals)
    assert simulation.time_ns == pytest.approx(2.1e9, abs=5e6)  # time did not stand behind


def test_a_stream_survives_a_pause_of_the_thread(rate=1000.0):
    """Ten milliseconds in which nothing ran are made good: a step for each message of them."""
    arrivals = [k / rate for k in range(1000)]
    wall = Wall()
    script = Script(wall, arrivals, 1.1)
    stalled = []

    def stall(time_ns: int) -> None:
        if time_ns == 500_000_000 and not stalled:
            stalled.append(wall.now)
            wall.now += 0.010

    thread = SimulationThread(
        lambda: Simulation(wall, 1_000_000), Pacer(1.0, wall), after_step=stall, inbox=script
    )
    thread.start()
    assert script.over.wait(60.0)
    thread.stop()
    assert stalled
    assert len(script.acted) >= 990
    assert script.order == sorted(script.order)


def test_a_flood_costs_a_message_a_step_and_the_last_one_acts():
    arrivals = [k / 6000.0 for k in range(6000)]
    script, simulation = run(arrivals, 1.2)
    assert len(script.acted) <= 1010
    assert script.order == sorted(script.order)
    assert script.order[-1] == 5999
    assert max(delays(script)) <= 2e-3
    assert simulation.time_ns == pytest.approx(1.2e9, abs=5e6)


def test_without_commands_the_thread_wakes_for_groups_of_steps():
    script, _ = run([], 1.0)
    assert script.waits <= 260


def test_after_a_stream_the_thread_goes_back_to_groups():
    script, _ = run([k / 1000.0 for k in range(100)], 1.1)
    assert script.waits <= 110 + 260


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_other_paces_hold_while_commands_stream(factor):
    script, simulation = run([k / 500.0 for k in range(500)], 1.0, factor)
    assert simulation.time_ns == pytest.approx(factor * 1e9, abs=10e6)
    assert len(script.acted) >= 495
    assert script.order == sorted(script.order)


def test_longer_steps_hold_real_time_and_take_a_command_each():
    script, simulation = run([k / 500.0 for k in range(500)], 1.1, step_ns=2_000_000)
    assert simulation.time_ns == pytest.approx(1.1e9, abs=6e6)
    assert len(script.acted) >= 495
    # A command waits for its step, and one more where two came between two steps.
    assert max(delays(script)) <= 4.1e-3


def test_at_full_speed_what_arrived_before_a_step_acts_in_it():
    script, simulation = run([k / 1000.0 for k in range(1000)], 0.05, factor=0.0)
    assert simulation.time_ns > 0.4e9
    assert len(script.acted) >= 49
    assert max(delays(script)) <= 1.01 * STEP_COST
