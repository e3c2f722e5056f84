"""Where chunks are carried out: in this process, or by workers of Dask distributed."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import os
import tempfile
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from types import TracebackType
from typing import Any

from aras_visual_servo_base.settings import describe_unknown_key
from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import StudyError, make_missing_library_error, read_first_line
from . import rows, versions, work
from .work import StudyTask

ANSWER_TIMEOUT = 10.0  # s that a scheduler may take to answer
# s until a worker must be there, of a cluster or after the last one has gone
WORKER_TIMEOUT = 300.0
COUNT_PERIOD = 2.0  # s between two counts of the workers: a cluster's come and go
# s between two looks for a chunk that is done; every worker has another to go on with
POLL_PERIOD = 0.02
CHUNKS_BEFORE_RESTART = 500  # chunks of a worker after which all are made anew
STARTING_STATES = ("init", "starting", "running", "undefined")  # of a nanny
# that a process of this machine may take to connect, whatever else runs on it
CONNECT_TIMEOUT = "600s"
TICK_PERIOD = "10s"  # between two looks of a worker, or the scheduler, at itself
MAX_DEATHS = 5  # of workers over one chunk, guarded or not, after which the cluster is to blame


FinishedChunk = tuple[StudyTask, rows.Rows | None]  # a chunk and its rows; None: its worker died


class Pool(ABC):
    """Carries out chunks, some at a time, and gives them back in any order."""

    workers: int = 1

    @property
    @abstractmethod
    def has_room(self) -> bool:
        """Whether it wants another chunk now."""

    @abstractmethod
    def submit(self, task: StudyTask) -> None:
        """Take a chunk."""

    @abstractmethod
    def wait_for_chunk(self) -> FinishedChunk:
        """Wait for a chunk; StudyError where none can come any more."""

    def close(self) -> None:
        """End what it began; safe to call twice."""

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self.close()


class InProcessPool(Pool):
    """One chunk after the other, here: for small studies, and to look into a fault."""

    def __init__(self) -> None:
        self._task: deque[StudyTask] = deque()

    @property
    def has_room(self) -> bool:
        """Whether the one before is done."""
        return not self._task

    def submit(self, task: StudyTask) -> None:
        """Keep it until it is asked for."""
        self._task.append(task)

    def wait_for_chunk(self) -> FinishedChunk:
        """Carry it out."""
        task = self._task.popleft()
        return task, work.carry_out(task)


class DaskPool(Pool):
    """Workers of Dask distributed: of this machine, of a scheduler, or of a named cluster class.

    Attributes:
        cluster: Dask's, None where a scheduler runs already. client: Dask's, None once closed.
    """

    def __init__(
        self,
        workers: int = 0,
        scheduler: str = "",
        cluster: str = "",
        chunks_before_restart: int = CHUNKS_BEFORE_RESTART,
    ) -> None:
        """Have workers.

        Args:
            workers: processes on this machine; 0: one a core.
            scheduler: address of one that runs already. cluster: file that names a class.
            renew: chunks of a worker after which all workers are made anew.

        Raises:
            StudyError: no scheduler answers, no worker comes, or one has another version.
        """
        self._distributed = _configure_dask()
        self._chunks_before_restart = chunks_before_restart
        self._max_workers, self._is_local = 0, not (scheduler or cluster)
        self.cluster: Any = None
        self._scratch = tempfile.TemporaryDirectory(prefix="bench-")
        self.client: Any = None
        try:
            if scheduler:
                address: Any = scheduler
            elif cluster:
                self.cluster, self._max_workers = _create_cluster(cluster)
                address = self.cluster
            else:
                address = self.cluster = self._start_local_cluster(workers or os.cpu_count() or 1)
            self.client = self._connect(address)
            self._check_versions()
            self._check_time = self._alive_time = time.monotonic()
        except BaseException:
            self.close()
            raise
        self._tasks: dict[Any, StudyTask] = {}
        self._deaths: dict[int, int] = {}
        self._chunks_since_restart = 0
        self._finished = self._distributed.as_completed(
            loop=self.client.loop, raise_errors=False
        )

    @property
    def has_room(self) -> bool:
        """Two chunks a worker: one under way, one that waits; none while workers are due.

        As many for workers that a cluster may still begin: it does so for chunks that wait.
        """
        self._check_workers()
        if (
            self._chunks_since_restart + len(self._tasks)
            >= self._chunks_before_restart * self.workers
        ):
            if self._tasks:
                return False
            self._restart_workers()
            self._chunks_since_restart = 0
        return len(self._tasks) < 2 * max(self.workers, self._max_workers)

    def submit(self, task: StudyTask) -> None:
        """Send it to a worker."""
        tries = self._deaths.get(task.chunk, 0)
        try:
            future = self.client.submit(
                work.carry_out, replace(task, is_isolated=tries > 0 or task.is_isolated),
                key=f"chunk-{task.chunk}-{tries}",
            )  # fmt: skip
        except Exception as error:
            raise self._make_lost_error(error) from error
        self._tasks[future.key] = task
        self._finished.add(future)

    def wait_for_chunk(self) -> FinishedChunk:
        """Wait for the next that is done."""
        try:
            while not self._finished.has_ready() and not self._finished.is_empty():
                self._check_workers()
                time.sleep(POLL_PERIOD)
            future = next(self._finished)
            task = self._tasks.pop(future.key)
            if future.status == "finished":
                done = future.result(timeout=60)
                self._chunks_since_restart += 1
                self._deaths.pop(task.chunk, None)
                return task, done
            error = future.exception(timeout=60) if future.status == "error" else None
        except StopIteration:
            raise StudyError("the workers have nothing left to do") from None
        except StudyError:
            raise
        except Exception as fault:
            raise self._make_lost_error(fault) from fault
        if isinstance(error, self._distributed.KilledWorker):
            deaths = self._deaths[task.chunk] = self._deaths.get(task.chunk, 0) + 1
            if deaths > MAX_DEATHS:
                raise StudyError(
                    f"{deaths} workers died over chunk {task.chunk}, even with its runs in "
                    "processes of their own: look at the machine's memory and the workers' logs"
                )
            return task, None
        if error is None:
            raise self._make_lost_error(None)
        if isinstance(error, StudyError):
            raise error
        raise StudyError(f"chunk {task.chunk} failed: {type(error).__name__}: {error}") from error

    def close(self) -> None:
        """End client and cluster."""
        for part in (self.client, self.cluster):
            if part is not None:
                with contextlib.suppress(Exception):
                    part.close(timeout=10)
        self.client = self.cluster = None
        self._scratch.cleanup()

    # -- making ----------------------------------------------------------------------------

    def _start_local_cluster(self, workers: int) -> Any:
        self.workers = workers
        return self._distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0",
            memory_limit=0, local_directory=self._scratch.name, silence_logs=50,
        )  # fmt: skip

    def _connect(self, address: Any) -> Any:
        try:
            if self.cluster is None:
                asyncio.run(_check_scheduler(address))
            client = self._distributed.Client(address, timeout=ANSWER_TIMEOUT, set_as_default=False)
        except (OSError, ValueError) as error:  # a timeout is the former
            told = read_first_line(error)
            raise StudyError(f"no scheduler answers at {address}: {told}") from None
        try:
            client.wait_for_workers(
                1, timeout=ANSWER_TIMEOUT if self.cluster is None else WORKER_TIMEOUT
            )
        except TimeoutError:
            client.close(timeout=5)
            raise StudyError(f"the scheduler at {address} has no workers") from None
        return client

    def _check_versions(self) -> None:
        """StudyError where a worker's code is not this one's."""
        try:
            there = self.client.run(versions.read_versions)
        except Exception as error:
            raise StudyError(
                f"the workers cannot load this package ({read_first_line(error)}): install it "
                "there, "
                "or set their PYTHONPATH"
            ) from None
        for worker, found in there.items():
            told = versions.describe_difference(versions.read_versions(), found)
            if told:
                raise StudyError(f"the worker at {worker} has another version: {told}")
        self._count_workers()

    def _count_workers(self) -> int:
        """Workers that are there now; StudyError where one has several threads."""
        threads = self.client.nthreads()
        if max(threads.values(), default=1) > 1:
            raise StudyError(
                "the workers have several threads each: start them with --nthreads 1, for a world "
                "belongs to one thread"
            )
        self.workers = len(threads) or self.workers
        return len(threads)

    def _check_workers(self) -> None:
        """Count the workers now and then; StudyError where the last has been gone for long."""
        now = time.monotonic()
        if now - self._check_time < COUNT_PERIOD:
            return
        self._check_time = now
        try:
            there = self._count_workers()
        except StudyError:
            raise
        except Exception as error:
            raise self._make_lost_error(error) from error
        if there:
            self._alive_time = now
        elif now - self._alive_time > WORKER_TIMEOUT and not self._has_live_nanny():
            raise StudyError(
                f"no worker has been there for {WORKER_TIMEOUT:g} s: look at the workers' logs, "
                "start some"
            )

    def _has_live_nanny(self) -> bool:
        """Whether a nanny of this process still watches a worker: it is slow, and not gone."""
        nannies = self.cluster.workers.values() if self._is_local else ()
        return any(nanny.status.name in STARTING_STATES for nanny in nannies)

    def _restart_workers(self) -> None:
        """End the workers that a nanny begins again; the others nobody would."""
        try:
            there = self.client.scheduler_info(n_workers=-1)["workers"]
            watched = [address for address, told in there.items() if told["nanny"]]
            if watched:
                self.client.restart_workers(watched, timeout=60, raise_for_error=False)
        except TimeoutError:
            pass  # some are slow to come back: what is there goes on
        except Exception as error:
            raise self._make_lost_error(error) from error

    def _make_lost_error(self, error: BaseException | None) -> StudyError:
        told = f" ({read_first_line(error)})" if error is not None else ""
        return StudyError(f"the scheduler is gone{told}")


def _configure_dask() -> Any:
    """distributed, told to keep little and to watch little."""
    try:
        import dask
        import distributed  # first, for it lays its own defaults over what is set before
    except ModuleNotFoundError as error:
        raise make_missing_library_error(error.name, "studies") from None

    dask.config.set({
        "distributed.nanny.pre-spawn-environ": work.ONE_THREAD,
        "distributed.scheduler.allowed-failures": 0,
        "distributed.scheduler.work-stealing": False,
        "distributed.scheduler.worker-saturation": 1.0,
        "distributed.worker.profile.enabled": False,
        "distributed.worker.memory.target": False,
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
        "distributed.worker.memory.terminate": False,
        "distributed.worker.daemon": True,
        "distributed.admin.log-length": 100,
        "distributed.admin.low-level-log-length": 100,
        # Every 20 ms each event loop would time itself: a twentieth of a core for the client.
        "distributed.admin.tick.interval": TICK_PERIOD,
        "distributed.admin.tick.cycle": "60s",
        "distributed.admin.tick.limit": "1h",
        "distributed.admin.system-monitor.interval": TICK_PERIOD,
        # A machine with twenty times the load that it can bear is slow, and not dead: a worker
        # that says nothing for minutes stays, and one that begins is waited for.
        "distributed.scheduler.worker-ttl": None,
        "distributed.comm.timeouts.connect": CONNECT_TIMEOUT,
        "distributed.comm.timeouts.tcp": CONNECT_TIMEOUT,
    })
    return distributed


async def _check_scheduler(address: str) -> None:
    """Return if a scheduler answers there; whatever Dask raises if not.

    Asked first, for a Client that was never connected waits for 20 s at the end, and says so.
    """
    from distributed.core import connect

    (await connect(address, timeout=ANSWER_TIMEOUT)).abort()


def _create_cluster(path: str) -> tuple[Any, int]:
    """The cluster that a file names, and the most workers that it is to have, 0 if not told."""
    told = read_yaml(path, StudyError)
    keys = ("class", "arguments", "workers")
    if not isinstance(told, Mapping) or "class" not in told:
        raise StudyError(f"{path} names no cluster: give class, arguments and workers")
    for key in told:
        if key not in keys:
            raise StudyError(describe_unknown_key(f"{path}: ", key, keys))
    least, most = _parse_worker_range(path, told.get("workers", 0))
    module, _, name = str(told["class"]).rpartition(".")
    try:
        cluster = getattr(importlib.import_module(module), name)(**dict(told.get("arguments", {})))
        if least < most:
            cluster.adapt(minimum=least, maximum=most)
        elif most:
            cluster.scale(most)
    except Exception as error:  # whatever a cluster's own code may raise
        raise StudyError(f"{path}: {told['class']}: {read_first_line(error)}") from None
    return cluster, most


def _parse_worker_range(path: str, value: Any) -> tuple[int, int]:
    """Least and most; 0 and 0 where nothing is said."""
    both = value if isinstance(value, list) else [value, value]
    whole = all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in both)
    if not (whole and len(both) == 2 and both[0] <= both[1] and (both[1] or value == 0)):
        raise StudyError(f"{path}: workers is {value!r}, must be a number, or [least, most]")
    return both[0], both[1]
