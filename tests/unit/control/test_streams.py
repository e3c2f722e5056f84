"""Command streams through the simulation's thread, on a wall clock that the test sets.

Waiting turns the clock, and so do steps; messages arrive at their times in real sockets.
"""

from __future__ import annotations

import bisect
import itertools
import random
import socket
import struct
import threading

import pytest

from aras_sim_bridge.ros.runtime.message_receiver import MessageReceiver, MessageStream
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

    def next_image_ns(self) -> None:
        return None

    def close(self) -> None:
        pass


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
        self._far, near = socket.socketpair()
        self._near = near
        self.add(MessageStream(near, self._act, lambda: None))

    def _act(self, body: bytes) -> None:
        number = int(body)
        self.order.append(number)
        self.acted[number] = self.wall.now

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
    arrivals: list[float], end: float, factor: float = 1.0, step_ns: int = 1_000_000, **options
) -> tuple[Script, Simulation]:
    """The thread at `factor` while messages 0, 1, ... arrive after so many seconds.

    Whatever arrives, no step is made before its time has come.
    """
    wall = Wall()
    script = Script(wall, arrivals, end)
    pacer = Pacer(factor, wall)
    simulation = Simulation(wall, step_ns)
    thread = SimulationThread(lambda: simulation, pacer, receiver=script, **options)
    begin = wall.now
    thread.start()
    assert script.over.wait(60.0)
    thread.stop()
    if factor and not options:
        for number, made in enumerate(simulation.made, 1):
            assert (made - begin) * factor >= number * step_ns / 1e9 - 1e-9
    return script, simulation


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


def test_a_stream_survives_a_pause_of_the_thread():
    """Ten milliseconds in which nothing ran are made good: a step for each message of them."""
    wall = Wall()
    script = Script(wall, [k / 1000.0 for k in range(1000)], 1.1)
    simulation = Simulation(wall, 1_000_000)

    def stall(time_ns: int) -> None:
        if time_ns == 500_000_000:
            wall.now += 0.010

    thread = SimulationThread(
        lambda: simulation, Pacer(1.0, wall), after_step=stall, receiver=script
    )
    thread.start()
    assert script.over.wait(60.0)
    thread.stop()
    assert max(b - a for a, b in itertools.pairwise(simulation.made)) > 0.010
    assert len(script.acted) >= 990
    assert script.order == sorted(script.order)


def test_after_a_reset_of_time_the_stream_before_does_not_count():
    wall = Wall()
    script = Script(wall, [k / 1000.0 for k in range(500)], 1.0)
    pacer = Pacer(1.0, wall)
    simulation = Simulation(wall, 1_000_000)
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


class Answers:
    """A gate that closes after each step, until a message acts."""

    is_closed = True

    def __init__(self, script: Script) -> None:
        self._script = script
        self._heard = 0

    def compute_remaining(self) -> float | None:
        if self._script.over.is_set() or len(self._script.order) > self._heard:
            self._heard = len(self._script.order)
            self.is_closed = False
            return None
        return 1.0

    def end_round(self) -> None:
        pass


@pytest.mark.parametrize("at_once", [1, 2, 4, 8])
def test_in_lockstep_each_command_acts_in_a_step_of_its_own(at_once):
    wall = Wall()
    script = Script(wall, [k // at_once / 100.0 for k in range(80)], 1.0)
    simulation = Simulation(wall, 1_000_000)
    gate = Answers(script)
    acted: list[list[int]] = []

    def after_step(_time_ns: int) -> None:
        gate.is_closed = True
        acted.append(script.order[sum(map(len, acted)):])

    thread = SimulationThread(
        lambda: simulation, Pacer(0.0, wall), after_step=after_step, receiver=script
    )
    thread.lockstep = gate
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


def test_a_stream_after_a_flood_is_taken_step_by_step_again():
    flood = [k / 6000.0 for k in range(3000)]
    stream = [0.6 + k / 1000.0 for k in range(500)]
    script, _ = run(flood + stream, 1.2)
    acted = [number for number in script.order if number >= 3000]
    assert len(acted) >= 495
    late = [script.acted[n] - script.arrivals[n] for n in acted]
    assert sum(delay > 2e-3 for delay in late) <= 5


def test_a_stream_in_small_bursts_is_no_flood():
    """Three at once every 3 ms, of which one a time is passed over: steps go on one by one."""
    script, _ = run([3e-3 * (k // 3) for k in range(600)], 0.7)
    assert len(script.acted) >= 390
    assert max(delays(script)) <= 2.1e-3


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
