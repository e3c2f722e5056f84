"""Thread of the simulation, which makes the steps at the right time and runs jobs between them.

Services and topics run in rospy's threads and never access the simulation directly. They pass a
function (a job) to `SimulationThread.call`, which runs it between two steps and returns its result
or raises its exception. Jobs also run while simulated time is paused. Therefore the simulation
needs no locks, and no client observes an unfinished step. The simulation thread reads the sockets
of command topics itself before each step (see message_receiver.py).
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
JOBS_BUDGET = 0.002  # Time for which jobs may run between two groups of steps, s of wall time.
# Simulated time after a command during which the thread wakes up for each single step, ns.
# Otherwise, it wakes up once for a group of steps.
STREAM_NS = 5_000_000
# If a connection skips at least this number of commands per step, steps are made in groups although
# commands arrive.
FLOOD = 3
# interval between two reads of the command topics while time is paused, s of wall time
PAUSED_PERIOD = 0.004
# In lockstep mode, largest number of commands of one connection that wait for later steps.
LOCKSTEP_BACKLOG = 8
# If jobs, such as a spawn, take longer than this, s of wall time, simulated time does not catch up
# with real time afterwards.
STALL = 0.05


class SimulationBusyError(SimError):
    """The simulation did not run a job within its timeout or has ended."""


class SimulationThread:
    """Thread that runs a simulation; every public method may be called from any thread.

    Attributes:
        simulation: simulation, which `start` builds; only jobs may use it.
        pacer: pacer of simulated time.
        receiver: receiver of commands and wake-ups; except for `wake`, only jobs may use it.
        paused: whether simulated time is paused.
        is_stopping: whether the thread has been requested to end.
        before_step: function that is called before each step, with the simulated time (ns) at the
            end of this step, or None. Only jobs may set it.
        on_time_reset: function that is called after a reset of simulated time, by the job that
            resets it. Set it before `start`.
        lockstep: object of lockstep mode, or None. No step is made while lockstep.is_closed, except
            by `step`. It must be set before `start`.
    """

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
        """Create the thread without starting it; see `start`.

        Args:
            build: function that creates the simulation; the new thread calls it.
            pacer: object that determines which steps are due.
            after_step: function that is called with the simulated time, ns, after every step.
            after_batch: function that is called with the simulated time, ns, after each group of
                steps.
            on_fault: function that is called if an exception ends the thread. Its argument is this
                exception.
            paused: whether simulated time is paused at the start.
            receiver: receiver of commands and wake-ups; tests replace it.
        """
        self._build = build
        self.pacer = pacer
        self._after_step = after_step
        self._after_batch = after_batch
        self._on_fault = on_fault
        self.paused = paused
        self._jobs: collections.deque[tuple[Callable[[], object], Future]] = collections.deque()
        self.receiver = receiver or MessageReceiver()
        self._stream_until_ns = 0
        self._is_flooded = False
        self._now_ns = 0
        self.is_stopping = False
        self._ready: Future = Future()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)
        self.simulation: Simulation | None = None
        self.before_step: Callable[[int], None] | None = None
        self.on_time_reset: Callable[[], None] = lambda: None
        self.lockstep: Lockstep | None = None

    def start(self, timeout: float = 60.0) -> None:
        """Start the thread and wait until the simulation is built.

        Raises:
            SimError: the simulation cannot be built.
        """
        self._thread.start()
        self._ready.result(timeout)

    @property
    def real_time_factor(self) -> float:
        """Simulated time divided by wall time in the last seconds; 0 while paused."""
        return 0.0 if self.paused else self.pacer.real_time_factor

    @property
    def is_time_stopped(self) -> bool:
        """Whether no steps are made, because time is paused or lockstep mode waits for messages."""
        return self.paused or (self.lockstep is not None and self.lockstep.is_closed)

    def now_ns(self) -> int:
        """Return the simulated time, ns, after the last step or job, without waiting."""
        return self._now_ns

    def call(self, job: Callable[[], T], timeout: float = 10.0) -> T:
        """Run `job` between two steps; return its result or raise its exception.

        Raises:
            SimulationBusyError: the job did not start within `timeout`, s of wall time.
        """
        if threading.current_thread() is self._thread:
            return job()
        future: Future = Future()
        self._jobs.append((job, future))
        self.receiver.wake()
        # A stopping thread runs no jobs, even if the thread is still alive.
        if self.is_stopping:
            self._cancel_jobs()
        try:
            return future.result(timeout)
        except FutureTimeoutError:
            if future.cancel():
                raise SimulationBusyError(
                    f"the simulation did not answer within {timeout:g} s; try again when the "
                    "processor is less busy"
                ) from None
            # The job started just before the timeout. Jobs are short, so wait until it has ended.
            return future.result()

    def post(self, job: Callable[[], None]) -> None:
        """Run `job` between two steps without waiting for it; its exceptions are logged."""
        future: Future = Future()
        future.add_done_callback(_log_fault)
        self._jobs.append((job, future))
        self.receiver.wake()

    def pause(self) -> None:
        """Pause simulated time; no step is in progress when this returns."""

        def job() -> None:
            self.paused = True

        self.call(job)

    def unpause(self) -> None:
        """Resume simulated time."""

        def job() -> None:
            if self.paused:
                self.paused = False
                if self.lockstep is not None:
                    # Cancel a wait for messages that single steps have started, so that it does not
                    # stop simulated time now.
                    self.lockstep.end_round()
                self.pacer.restart(self.simulation.time_ns)

        self.call(job)

    def step(self, count: int, timeout: float) -> int:
        """Advance a paused simulation by `count` steps and return the simulated time, ns.

        Raises:
            SimulationBusyError: the steps are not finished within `timeout`, s of wall time; the
                steps that have been made are not undone.
        """
        deadline = time.monotonic() + timeout
        done = 0
        while done < count:
            # make at most 100 steps per job, so that other jobs can run in between
            chunk = min(count - done, 100)
            self.call(lambda n=chunk: self._advance(n), max(deadline - time.monotonic(), 0.1))
            done += chunk
            if time.monotonic() > deadline and done < count:
                raise SimulationBusyError(
                    f"{done} of {count} steps were done within {timeout:g} s; request fewer steps"
                )
        return self.call(lambda: self.simulation.time_ns)

    def stop(self, timeout: float = 5.0) -> None:
        """End the thread and close the simulation; pending jobs raise SimulationBusyError."""
        self.is_stopping = True
        self.receiver.wake()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout)
        self._cancel_jobs()

    def _advance(self, count: int) -> None:
        for _ in range(count):
            if self.is_stopping:
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
        """Apply the commands that have arrived and return whether there was one.

        backlog: number of commands of each connection that may wait for later steps.
        """
        time_ns = self.simulation.time_ns
        if not self.receiver.deliver(time_ns, backlog):
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
        self.pacer.restart(self._now_ns)
        self._ready.set_result(None)
        try:
            self._loop()
        except BaseException as error:
            self._on_fault(error)
        finally:
            self.is_stopping = True
            self._cancel_jobs()
            self.receiver.close()
            self.simulation.close()

    def _loop(self) -> None:
        receiver, jobs, pacer, simulation, gate = (
            self.receiver, self._jobs, self.pacer, self.simulation, self.lockstep
        )  # fmt: skip
        while True:
            receiver.clear_wake()
            # Read the flag only after clear_wake: if a stop is requested after this line, its
            # wake-up is still pending.
            if self.is_stopping:
                return
            if jobs:
                self._run_jobs()
            if self.paused:
                has_command = self._deliver_commands(0)
                if not jobs:
                    receiver.wait(PAUSED_PERIOD if has_command else None, commands=not has_command)
                continue
            if gate is not None and gate.is_closed:
                self._deliver_commands(LOCKSTEP_BACKLOG)
                if (remaining := gate.compute_remaining()) is not None:
                    if not jobs:
                        receiver.wait(remaining)
                    continue
            event_ns = simulation.next_image_ns()
            end = pacer.find_due_time(simulation.time_ns, event_ns, self._compute_group_ns())
            if simulation.time_ns < end:
                self._make_steps(end)
            is_streaming = self._is_streaming
            delay = pacer.compute_wait(
                simulation.time_ns, simulation.next_image_ns(), self._compute_group_ns()
            )
            if delay > 0.0 and not jobs and receiver.wait(delay, commands=not is_streaming):
                self._stream_until_ns = simulation.time_ns + STREAM_NS

    def _make_steps(self, end_ns: int) -> None:
        """Make all steps until the simulated time reaches `end_ns`, ns.

        Stop early if a job is pending, time is paused, or lockstep mode waits for messages.
        """
        simulation, gate, jobs = self.simulation, self.lockstep, self._jobs
        start_ns = simulation.time_ns
        while simulation.time_ns < end_ns and not (gate is not None and gate.is_closed):
            try:
                self._step(self._compute_backlog(end_ns))
            # Pause, for example after the physics diverged, so that a client can reset the
            # simulation.
            except SimError as error:
                self.paused = True
                log.error("simulated time is paused: %s", error)
            if jobs or self.paused:
                break
        made = max((simulation.time_ns - start_ns) // simulation.step_ns, 1)
        self._is_flooded = self.receiver.take_skipped_count() >= FLOOD * made
        self._after_batch(simulation.time_ns)

    def _compute_backlog(self, end_ns: int) -> int:
        """Return how many commands of a connection may wait for the steps after the next one.

        In real-time mode, this is the number of steps that are due now. A client that sends one
        command per step then loses none, even if two commands arrive between two steps. In the mode
        `max`, no command waits. In lockstep mode, the number is LOCKSTEP_BACKLOG.
        """
        if self.pacer.factor > 0.0:
            return -((self.simulation.time_ns - end_ns) // self.simulation.step_ns)
        return 0 if self.lockstep is None else LOCKSTEP_BACKLOG

    @property
    def _is_streaming(self) -> bool:
        # The difference exceeds STREAM_NS only if simulated time was reset after the last command.
        return 0 < self._stream_until_ns - self.simulation.time_ns <= STREAM_NS

    def _compute_group_ns(self) -> int:
        """Return the simulated time, ns, of the steps that are made after one wake-up.

        Usually this is a group of steps, which saves wake-ups. While commands arrive, it is a
        single step, so that no command waits for the end of a group. If commands arrive faster than
        steps are made, it is a group again, because each step finds a new command anyway.
        """
        is_single = self._is_streaming and not self._is_flooded
        return self.simulation.step_ns if is_single else BATCH_NS

    def _run_jobs(self) -> None:
        """Run pending jobs until JOBS_BUDGET is over, but at least one job."""
        jobs = self._jobs
        start = time.monotonic()
        while jobs and not self.is_stopping:
            job, future = jobs.popleft()
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(job())
                except BaseException as error:
                    future.set_exception(error)
            self._now_ns = self.simulation.time_ns
            now = time.monotonic()
            if now - start > STALL:
                self.pacer.restart(self.simulation.time_ns)
            if now - start > JOBS_BUDGET:
                return

    def _cancel_jobs(self) -> None:
        while True:
            try:
                _, future = self._jobs.popleft()
            except IndexError:  # no job is left; another thread may have taken the last one
                return
            if future.set_running_or_notify_cancel():
                future.set_exception(SimulationBusyError(SHUTTING_DOWN))


def _log_fault(future: Future) -> None:
    if future.cancelled() or (error := future.exception()) is None:
        return
    # Jobs that are cancelled at shutdown are not reported.
    if not isinstance(error, SimulationBusyError):
        log.error("%s: %s", type(error).__name__, error)
