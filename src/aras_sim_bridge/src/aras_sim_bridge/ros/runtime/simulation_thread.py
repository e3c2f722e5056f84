"""The one thread that owns the simulation: it steps, paces and runs everybody's jobs in between.

Services and topics live on rospy's threads. They never touch the simulation; they hand a function
to `SimulationThread.call`, which runs it between two steps (also while paused) and brings back its
result or exception. So no lock is needed below, and no client can see half a step. Commands do not
even come by other threads: the simulation's own reads their sockets before each step (see inbox).
"""

from __future__ import annotations

import collections
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import TypeVar

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.lockstep import Lockstep
from aras_sim_bridge.ros.runtime.message_receiver import MessageReceiver
from aras_sim_bridge.ros.runtime.pacing import BATCH_NS, Pacer
from aras_sim_bridge.simulation import Simulation

T = TypeVar("T")
log = logging.getLogger(__name__)

SHUTTING_DOWN = "the simulator is shutting down"
JOBS_BUDGET = 0.002  # seconds of wall time for jobs before time goes on: a flood must not stop it
STREAM_NS = 5_000_000  # so long after a command steps are made one by one, each when it is due
FLOOD = 3  # messages passed over a step by one connection: steps are not made one by one for it
PAUSED_PERIOD = 0.004  # seconds of wall time from one look at commands to the next, paused
LOCKSTEP_BACKLOG = 8  # commands of one connection that may wait for their steps in lockstep
STALL = 0.05  # seconds of wall time of one job (a spawn) that simulated time does not make good


class SimulationBusyError(SimError):
    """The simulation did not come round to a job in time, or has ended."""


class SimulationThread:
    """Runs a simulation; every public method may be called from any thread."""

    def __init__(
        self,
        build: Callable[[], Simulation],
        pacer: Pacer,
        after_step: Callable[[int], None] = lambda time_ns: None,
        after_batch: Callable[[int], None] = lambda time_ns: None,
        on_fault: Callable[[BaseException], None] = lambda error: None,
        paused: bool = False,
        receiver: MessageReceiver | None = None,
    ) -> None:
        """Prepare; nothing runs before `start`.

        Args:
            build: makes the simulation, called in the thread (an OpenGL context is bound to it).
            pacer: says which steps are due.
            after_step: called with the simulated time after every step.
            after_batch: called after each group of steps that were due together.
            on_fault: called once with an exception that ended the thread.
            inbox: where commands come in, and the thread waits; tests hand in their own.
        """
        self._build = build
        self._pacer = pacer
        self._after_step = after_step
        self._after_batch = after_batch
        self._on_fault = on_fault
        self._paused = paused
        self._jobs: collections.deque[tuple[Callable[[], object], Future]] = collections.deque()
        self._receiver = receiver or MessageReceiver()
        self._stream_until_ns = 0
        self._is_flooded = False
        self._now_ns = 0
        self._is_stopping = False
        self._ready: Future = Future()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)
        self.simulation: Simulation | None = None  # None before `start`
        # Called with the time that the coming step ends at; to be set in the simulation's thread.
        self.before_step: Callable[[int], None] | None = None
        # Holds simulated time back while it runs; to be set before `start`. step() ignores it.
        self.lockstep: Lockstep | None = None

    def start(self, timeout: float = 60.0) -> None:
        """Build the simulation in the thread and begin.

        Raises:
            SimError: what went wrong while building.
        """
        self._thread.start()
        self._ready.result(timeout)

    @property
    def paused(self) -> bool:
        """Whether simulated time stands still."""
        return self._paused

    @property
    def real_time_factor(self) -> float:
        """Simulated over wall time of the last seconds; 0 while paused."""
        return 0.0 if self._paused else self._pacer.real_time_factor

    @property
    def is_time_stopped(self) -> bool:
        """Whether no step will come by itself: paused, or a gate is closed."""
        return self._paused or (self.lockstep is not None and self.lockstep.is_closed)

    @property
    def is_stopping(self) -> bool:
        """Whether the thread is told to end."""
        return self._is_stopping

    def wake(self) -> None:
        """Let the thread look again whether there is something to do; from any thread."""
        self._receiver.wake()

    @property
    def receiver(self) -> MessageReceiver:
        """The streams of commands; for jobs only."""
        return self._receiver

    def now_ns(self) -> int:
        """Simulated time [ns] after the last step or job; from any thread, without waiting."""
        return self._now_ns

    @property
    def pacer(self) -> Pacer:
        """The pacer in use."""
        return self._pacer

    def call(self, job: Callable[[], T], timeout: float = 10.0) -> T:
        """Run job between two steps and return what it returns; its exceptions come through.

        Raises:
            SimulationBusyError: when it was not run within timeout [s of wall time].
        """
        if threading.current_thread() is self._thread:
            return job()
        future: Future = Future()
        self._jobs.append((job, future))
        self._receiver.wake()
        if self._is_stopping:  # it runs no jobs any more, even where it still closes the simulation
            self._cancel_jobs()
        try:
            return future.result(timeout)
        except FutureTimeoutError:
            if future.cancel():
                raise SimulationBusyError(
                    f"the simulation did not answer within {timeout:g} s; is the machine busy?"
                ) from None
            return future.result()  # it began just now; it is short

    def post(self, job: Callable[[], None]) -> None:
        """Run job between two steps without waiting; an exception of it is logged."""
        future: Future = Future()
        future.add_done_callback(_log_fault)
        self._jobs.append((job, future))
        self._receiver.wake()

    def pause(self) -> None:
        """Let simulated time stand still; when this returns no step is under way."""

        def job() -> None:
            self._paused = True

        self.call(job)

    def unpause(self) -> None:
        """Let simulated time run on from where it stands."""

        def job() -> None:
            if self._paused:
                self._paused = False
                if self.lockstep is not None:
                    self.lockstep.end_round()  # what step() closed holds for step() only
                self._pacer.restart(self.simulation.time_ns)

        self.call(job)

    def step(self, count: int, timeout: float) -> int:
        """Advance a paused simulation by count steps; returns the simulated time [ns] after them.

        Raises:
            SimulationBusyError: when timeout [s of wall time] is over; the steps done stay done.
        """
        deadline = time.monotonic() + timeout
        done = 0
        while done < count:
            chunk = min(count - done, 100)  # short jobs, so that others get their turn
            self.call(lambda n=chunk: self._advance(n), max(deadline - time.monotonic(), 0.1))
            done += chunk
            if time.monotonic() > deadline and done < count:
                raise SimulationBusyError(
                    f"{done} of {count} steps were done within {timeout:g} s; ask for fewer"
                )
        return self.call(lambda: self.simulation.time_ns)

    def stop(self, timeout: float = 5.0) -> None:
        """End the thread and close the simulation; waiting callers get an exception."""
        self._is_stopping = True
        self._receiver.wake()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout)
        self._cancel_jobs()

    def _advance(self, count: int) -> None:
        for _ in range(count):
            if self._is_stopping:
                raise SimulationBusyError(SHUTTING_DOWN)
            self._step(0)
        self._after_batch(self.simulation.time_ns)

    def _step(self, backlog: int) -> None:
        simulation = self.simulation
        self._deliver_commands(backlog)
        if self.before_step is not None:
            self.before_step(simulation.time_ns + simulation.step_ns)
        simulation.step()
        self._now_ns = simulation.time_ns
        self._after_step(simulation.time_ns)

    def _deliver_commands(self, backlog: int) -> bool:
        """Let the commands act that came; `backlog`: how many of a topic may wait for theirs."""
        time_ns = self.simulation.time_ns
        if not self._receiver.deliver(time_ns, backlog):
            return False
        self._stream_until_ns = time_ns + STREAM_NS
        return True

    def _run(self) -> None:
        try:
            self.simulation = self._build()
        except BaseException as error:
            self._ready.set_exception(error)
            return
        self._now_ns = self.simulation.time_ns
        self._pacer.restart(self._now_ns)
        self._ready.set_result(None)
        try:
            self._loop()
        except BaseException as error:
            self._on_fault(error)
        finally:
            self._is_stopping = True
            self._cancel_jobs()
            self._receiver.close()
            self.simulation.close()

    def _loop(self) -> None:
        inbox, jobs, pacer, simulation, gate = (
            self._receiver, self._jobs, self._pacer, self.simulation, self.lockstep
        )  # fmt: skip
        while True:
            inbox.clear_wake()
            if self._is_stopping:  # looked at after the quiet, or a stop in between would be lost
                return
            if jobs:
                self._run_jobs()
            if self._paused:
                came = self._deliver_commands(0)
                if not jobs:
                    inbox.wait(PAUSED_PERIOD if came else None, commands=not came)
                continue
            if gate is not None and gate.is_closed:
                self._deliver_commands(LOCKSTEP_BACKLOG)
                if (left := gate.compute_remaining()) is not None:
                    if not jobs:
                        inbox.wait(left)
                    continue
            event_ns = simulation.next_image_ns()
            end = pacer.find_due_time(simulation.time_ns, event_ns, self._compute_group_ns())
            if simulation.time_ns < end:
                self._make_steps(end)
            streaming = self._is_streaming
            delay = pacer.compute_wait(
                simulation.time_ns, simulation.next_image_ns(), self._compute_group_ns()
            )
            if delay > 0.0 and not jobs and inbox.wait(delay, commands=not streaming):
                self._stream_until_ns = simulation.time_ns + STREAM_NS

    def _make_steps(self, end_ns: int) -> None:
        """Make the steps that are due until `end_ns`, fewer where something is to come between."""
        simulation, gate, jobs = self.simulation, self.lockstep, self._jobs
        begin_ns = simulation.time_ns
        while simulation.time_ns < end_ns and not (gate is not None and gate.is_closed):
            try:
                self._step(self._compute_backlog(end_ns))
            except SimError as error:  # it diverged: whoever is there may reset it
                self._paused = True
                log.error("simulated time stands still: %s", error)
            if jobs or self._paused:
                break
        made = max((simulation.time_ns - begin_ns) // simulation.step_ns, 1)
        self._is_flooded = self._receiver.take_skipped_count() >= FLOOD * made
        self._after_batch(simulation.time_ns)

    def _compute_backlog(self, end_ns: int) -> int:
        """How many commands of a topic may wait for the steps after the coming one.

        In real time one for each step that is due, and one more: of a stream as fast as the steps
        two may come between two of them, and none before the next. As fast as it goes, none.
        """
        if self._pacer.factor > 0.0:
            return -((self.simulation.time_ns - end_ns) // self.simulation.step_ns)
        return 0 if self.lockstep is None else LOCKSTEP_BACKLOG

    @property
    def _is_streaming(self) -> bool:
        # Beyond it lies what was set before a reset of time.
        return 0 < self._stream_until_ns - self.simulation.time_ns <= STREAM_NS

    def _compute_group_ns(self) -> int:
        """Simulated time of the steps that are made together: few wake-ups, unless commands come
        that shall not wait for their step. Of a flood each step has a newer one in any case."""
        one_by_one = self._is_streaming and not self._is_flooded
        return self.simulation.step_ns if one_by_one else BATCH_NS

    def _run_jobs(self) -> None:
        """Run what has been asked for, for a while; at least one job, so that none is left."""
        jobs = self._jobs
        begin = time.monotonic()
        while jobs and not self._is_stopping:
            self._run_job(*jobs.popleft())
            self._now_ns = self.simulation.time_ns
            now = time.monotonic()
            if now - begin > STALL:
                self._pacer.restart(self.simulation.time_ns)
            if now - begin > JOBS_BUDGET:
                return

    @staticmethod
    def _run_job(job: Callable[[], object], future: Future) -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            result = job()
        except BaseException as error:
            future.set_exception(error)
        else:
            future.set_result(result)

    def _cancel_jobs(self) -> None:
        while True:
            try:
                _, future = self._jobs.popleft()
            except IndexError:  # none is left, or another thread took it
                return
            if future.set_running_or_notify_cancel():
                future.set_exception(SimulationBusyError(SHUTTING_DOWN))


def _log_fault(future: Future) -> None:
    if future.cancelled() or (error := future.exception()) is None:
        return
    if not isinstance(error, SimulationBusyError):  # it ends, and with it what was to be done
        log.error("%s: %s", type(error).__name__, error)
