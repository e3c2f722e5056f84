"""Thread of the simulation: requests, stalls, floods of jobs, termination."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

import pytest

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros.runtime.lockstep import Lockstep
from aras_sim_bridge.ros.runtime.message_receiver import MessageReceiver
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationBusyError, SimulationThread
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_ros.send_queue import QueueFlusher

MS = 1_000_000


class Empty(Simulation):
    """A simulation of nothing; `is_closed` says that it has ended."""

    is_closed = False

    def __init__(self) -> None:
        super().__init__(SimulationConfig(ground_plane=False))

    def close(self) -> None:
        time.sleep(0.005)
        super().close()
        self.is_closed = True


def gate_of(thread: SimulationThread) -> Lockstep:
    gate = Lockstep(["/c"], 60.0, thread.receiver.wake, flusher=QueueFlusher())
    gate.claim("/c")
    return gate


@pytest.fixture
def started():
    threads = []

    def start(factor: float, gated: bool = False, **options) -> SimulationThread:
        thread = SimulationThread(Empty, Pacer(factor), **options)
        thread.lockstep = gate_of(thread) if gated else None
        threads.append(thread)
        thread.start()
        return thread

    yield start
    for thread in threads:
        thread.stop()


def refuse() -> None:
    raise ValueError("not so")


def until(predicate) -> None:
    end = time.monotonic() + 10.0
    while not predicate():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_no_step_is_made_behind_a_closed_gate_but_jobs_are_run(started):
    def close(time_ns: int) -> None:
        if time_ns == 10 * MS:
            thread.lockstep.start_round()

    thread = started(0.0, True, paused=True, after_step=close)
    thread.unpause()
    until(lambda: thread.is_time_stopped)
    assert thread.call(lambda: thread.simulation.time_ns) == 10 * MS
    time.sleep(0.02)
    assert thread.call(lambda: thread.simulation.time_ns) == 10 * MS
    thread.lockstep.note_message("/c")
    until(lambda: thread.now_ns() > 20 * MS)


def test_unpausing_clears_the_gate_that_steps_closed(started):
    thread = started(0.0, True, paused=True, after_step=lambda _: thread.lockstep.start_round())
    assert thread.step(5, 5.0) == 5 * MS  # steps asked for are made
    thread.unpause()
    until(lambda: thread.now_ns() == 6 * MS)


class Commands(MessageReceiver):
    """Receiver: `comes` decides whether a command acts before a step; a group skips `flood`."""

    def __init__(self, comes: Callable[[int], bool], flood: int = 0) -> None:
        super().__init__()
        self.comes, self.flood, self.delivered, self.waits = comes, flood, [], []

    def deliver(self, time_ns: int, backlog: int) -> bool:
        self.delivered.append((time_ns // MS, backlog))
        return self.comes(time_ns)

    def take_skipped_count(self) -> int:
        return self.flood

    def wait(self, seconds: float | None, commands: bool = True) -> bool:
        self.waits.append((seconds, commands))
        return super().wait(seconds, commands)


@pytest.mark.parametrize("gated", [False, True])
def test_while_time_stands_still_the_thread_waits_and_does_not_spin(started, gated):
    inbox = Commands(lambda _: False)
    thread = started(1.0, gated, paused=True, receiver=inbox)
    if gated:
        thread.unpause()
        thread.call(thread.lockstep.start_round)
    thread.call(lambda: None)
    time.sleep(0.01)
    rounds = len(inbox.delivered)
    time.sleep(0.03)
    assert len(inbox.delivered) <= rounds + 2


class Plan(Pacer):
    def __init__(self, *steps: float, factor: float = 1.0) -> None:
        super().__init__(factor)
        self.steps, self.groups, self.over = iter(steps), [], threading.Event()

    def find_due_time(self, time_ns: int, event_ns: int | None, group_ns: int) -> int:
        self.groups.append(group_ns // MS)
        count = next(self.steps, None)
        if count is None:
            self.over.set()
        return time_ns + round(MS * (count or 0))

    def compute_wait(self, time_ns: int, event_ns: int | None, group_ns: int) -> float:
        return 60.0 if self.over.is_set() else 0.0


def run(plan: Plan, inbox: MessageReceiver, gated: bool = False, build=Empty) -> None:
    thread = SimulationThread(build, plan, receiver=inbox)
    thread.lockstep = gate_of(thread) if gated else None
    thread.start()
    assert plan.over.wait(20.0)
    thread.stop()
    assert thread.simulation.is_closed  # it has ended


@pytest.mark.parametrize(("flood", "groups"), [
    (2, [4, 1, 1, 1]), (3, [4, 4, 1, 1]), (5, [4, 4, 1, 1]), (6, [4, 4, 4, 1]), (12, [4, 4, 4, 4])])
def test_steps_are_made_one_by_one_for_commands_unless_these_are_a_flood(flood, groups):
    plan = Plan(1, 2, 4)
    run(plan, Commands(lambda _: True, flood))
    assert plan.groups == groups


def test_steps_after_a_command_and_a_clock_set_back():
    plan = Plan(*7 * [1])
    run(plan, Commands(lambda time_ns: time_ns == 0))
    assert plan.groups == [4, 1, 1, 1, 1, 4, 4, 4]
    made = Empty()
    made.time_ns = 100 * MS

    class Reset(Plan):
        def find_due_time(self, time_ns: int, event_ns: int | None, group_ns: int) -> int:
            if len(self.groups) == 1:
                made.time_ns = time_ns = 0
            return super().find_due_time(time_ns, event_ns, group_ns)

    plan = Reset(1, 1, 1)
    run(plan, Commands(lambda time_ns: time_ns > 50 * MS), build=lambda: made)
    assert plan.groups == [4, 1, 4, 4]


@pytest.mark.parametrize(("factor", "gated", "backlogs"), [
    (1.0, False, [3, 2, 1, 2, 1]), (1.0, True, [3, 2, 1, 2, 1]), (0.0, False, 5 * [0]),
    (0.0, True, 5 * [8])])
def test_of_the_commands_of_a_topic_one_may_wait_for_each_step_that_is_due(factor, gated, backlogs):
    """What arrived before a step acts in it."""
    inbox = Commands(lambda _: False)
    run(Plan(2.5, 2, factor=factor), inbox, gated)
    assert inbox.delivered == list(enumerate(backlogs))
    assert inbox.waits == [(60.0, True)]  # what is due at once is not waited for


def test_while_time_stands_still_the_newest_command_acts_and_a_flood_wakes_now_and_then(started):
    left = [True, True, False]
    inbox = Commands(lambda _: left.pop(0) if left else False)
    started(1.0, paused=True, receiver=inbox)
    until(lambda: len(inbox.waits) == 3)
    assert inbox.waits == [(0.004, False), (0.004, False), (None, True)]
    assert inbox.delivered == 3 * [(0, 0)]


def test_a_pause_is_not_made_good():
    wall = [0.0]
    thread = SimulationThread(Empty, Pacer(1.0, lambda: wall[0]), paused=True)
    thread.start()
    wall[0] = 0.15
    thread.unpause()
    wall[0] = 0.16
    until(lambda: thread.now_ns() >= 8 * MS)
    thread.stop()
    assert thread.now_ns() == 8 * MS


def test_a_stall_is_not_made_good_and_not_complained_of(started, caplog):
    thread = started(1.0)
    with caplog.at_level(logging.WARNING):
        before = thread.call(lambda: thread.simulation.time_ns)
        thread.call(lambda: time.sleep(2.1))  # a spawn with large meshes
        after = thread.call(lambda: thread.simulation.time_ns)
        until(lambda: thread.now_ns() > after + 50_000_000)
    assert after - before < 200_000_000
    assert "the simulation is too slow" not in caplog.text


def test_a_fault_comes_to_who_asked_and_costs_nobody_else(started, caplog):
    thread = started(1.0, paused=True)
    with pytest.raises(ValueError, match="not so"):
        thread.call(refuse)
    thread.post(refuse)
    assert thread.call(lambda: 7) == 7
    until(lambda: "ValueError: not so" in caplog.text)


def test_a_world_that_diverges_is_paused_and_the_thread_goes_on(started):
    thread, faults = started(0.0, paused=True), iter([WorldError("diverged")])

    def step(_time_ns: int) -> None:
        for fault in faults:
            raise fault

    thread.call(lambda: setattr(thread, "before_step", step))
    thread.unpause()
    until(lambda: thread.paused)
    thread.unpause()
    until(lambda: thread.now_ns() > 5 * MS)


def test_a_fault_between_steps_ends_the_thread_and_is_told(started):
    told: list[BaseException] = []
    thread = started(0.0, paused=True, on_fault=told.append, after_step=lambda _: refuse())
    thread.unpause()
    until(lambda: thread.is_stopping)
    assert str(told[0]) == "not so"
    with pytest.raises(SimulationBusyError, match="shutting down"):
        thread.call(lambda: None)


def test_what_cannot_be_built_ends_the_thread_without_another_fault(started, monkeypatch):
    others, told = [], []
    monkeypatch.setattr(threading, "excepthook", others.append)
    thread = SimulationThread(refuse, Pacer(1.0), on_fault=told.append)
    with pytest.raises(ValueError, match="not so"):
        thread.start()
    thread.stop()
    assert not others + told and thread.simulation is None


def test_a_flood_of_jobs_does_not_stop_time(started):
    thread, done = started(1.0), []
    begin = thread.now_ns()
    for _ in range(2000):
        thread.post(lambda: done.append(time.sleep(0.0005)))
    until(lambda: thread.now_ns() > begin + 50 * MS)
    assert len(done) < 2000


def test_no_step_is_made_after_the_end(started):
    thread = started(0.0, paused=True,
                     after_step=lambda time_ns: thread.stop() if time_ns == 3 * MS else None)
    with pytest.raises(SimulationBusyError, match="shutting down"):
        thread.step(50, 60.0)
    assert thread.simulation.time_ns == 3 * MS


def test_who_waits_too_long_is_told_and_what_he_asked_for_is_not_done(started):
    thread = started(1.0, paused=True)
    go_on, begun, done = threading.Event(), threading.Event(), []
    thread.post(lambda: (begun.set(), go_on.wait(20.0)))
    assert begun.wait(20.0)
    with pytest.raises(SimulationBusyError, match="did not answer within 0.01 s; try again"):
        thread.call(lambda: done.append(1), 0.01)
    go_on.set()
    assert thread.call(lambda: 8) == 8 and not done
    # A job that has begun is waited for whatever it takes.
    assert thread.call(lambda: time.sleep(0.6) or 7, 0.5) == 7


def test_a_job_does_not_wait_for_the_rest_of_the_steps_that_are_due():
    plan, seen = Plan(4), []
    thread = SimulationThread(
        Empty, plan, lambda time_ns: time_ns == MS and thread.post(
            lambda: seen.append(thread.simulation.time_ns)), receiver=Commands(lambda _: False))
    thread.start()
    assert plan.over.wait(20.0)
    thread.stop()
    assert seen == [MS]
