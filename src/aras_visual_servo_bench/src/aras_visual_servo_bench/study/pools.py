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

from aras_visual_servo_base.settings import unknown_key
from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import StudyError, first_line, not_installed
from . import rows, versions, work
from .work import StudyTask

ANSWER = 10.0  # s that a scheduler may take to answer
APPEAR = 300.0  # s until a worker must be there, of a cluster or after the last one has gone
LOOK = 2.0  # s between two counts of the workers: a cluster's come and go
POLL = 0.02  # s between two looks for a chunk that is done; every worker has another to go on with
RENEWED = 500  # chunks of a worker after which all are made anew
BEGINNING = ("init", "starting", "running", "undefined")  # of a nanny
SLOW = "600s"  # that a process of this machine may take to connect, whatever else runs on it
TICK = "10s"  # between two looks of a worker, or the scheduler, at itself
DEATHS = 5  # of workers over one chunk, guarded or not, after which the cluster is to blame


Done = tuple[StudyTask, rows.Rows | None]  # a chunk and its rows; None: its worker died


class Pool(ABC):
    """Carries out chunks, some at a time, and gives them back in any order."""

    workers: int = 1

    @property
    @abstractmethod
    def room(self) -> bool:
        """Whether it wants another chunk now."""

    @abstractmethod
    def submit(self, task: StudyTask) -> None:
        """Take a chunk."""

    @abstractmethod
    def next(self) -> Done:
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


class ThisProcess(Pool):
    """One chunk after the other, here: for small studies, and to look into a fault."""

    def __init__(self) -> None:
        self._waiting: deque[StudyTask] = deque()

    @property
    def room(self) -> bool:
        """Whether the one before is done."""
        return not self._waiting

    def submit(self, task: StudyTask) -> None:
        """Keep it until it is asked for."""
        self._waiting.append(task)

    def next(self) -> Done:
        """Carry it out."""
        task = self._waiting.popleft()
        return task, work.carry_out(task)


class DaskPool(Pool):
    """Workers of Dask distributed: of this machine, of a scheduler, or of a named cluster class.

    Attributes:
        cluster: Dask's, None where a scheduler runs already. client: Dask's, None once closed.
    """

    def __init__(
        self, workers: int = 0, scheduler: str = "", cluster: str = "", renew: int = RENEWED
    ) -> None:
        """Have workers.

        Args:
            workers: processes on this machine; 0: one a core.
            scheduler: address of one that runs already. cluster: file that names a class.
            renew: chunks of a worker after which all workers are made anew.

        Raises:
            StudyError: no scheduler answers, no worker comes, or one has another version.
        """
        self._distributed = _configured()
        self._renew = renew
        self._most, self._here = 0, not (scheduler or cluster)
        self.cluster: Any = None
        self._scratch = tempfile.TemporaryDirectory(prefix="bench-")
        self.client: Any = None
        try:
            if scheduler:
                address: Any = scheduler
            elif cluster:
                self.cluster, self._most = _named_cluster(cluster)
                address = self.cluster
            else:
                address = self.cluster = self._local(workers or os.cpu_count() or 1)
            self.client = self._connected(address)
            self._agree()
            self._looked = self._seen = time.monotonic()
        except BaseException:
            self.close()
            raise
        self._tasks: dict[Any, StudyTask] = {}
        self._deaths: dict[int, int] = {}
        self._since = 0
        self._finished = self._distributed.as_completed(
            loop=self.client.loop, raise_errors=False
        )

    @property
    def room(self) -> bool:
        """Two chunks a worker: one under way, one that waits; none while workers are due.

        As many for workers that a cluster may still begin: it does so for chunks that wait.
        """
        self._look()
        if self._since + len(self._tasks) >= self._renew * self.workers:
            if self._tasks:
                return False
            self._make_anew()
            self._since = 0
        return len(self._tasks) < 2 * max(self.workers, self._most)

    def submit(self, task: StudyTask) -> None:
        """Send it to a worker."""
        tries = self._deaths.get(task.chunk, 0)
        try:
            future = self.client.submit(
                work.carry_out, replace(task, guarded=tries > 0 or task.guarded),
                key=f"chunk-{task.chunk}-{tries}",
            )  # fmt: skip
        except Exception as error:
            raise self._lost(error) from error
        self._tasks[future.key] = task
        self._finished.add(future)

    def next(self) -> Done:
        """Wait for the next that is done."""
        try:
            while not self._finished.has_ready() and not self._finished.is_empty():
                self._look()
                time.sleep(POLL)
            future = next(self._finished)
            task = self._tasks.pop(future.key)
            if future.status == "finished":
                done = future.result(timeout=60)
                self._since += 1
                self._deaths.pop(task.chunk, None)
                return task, done
            error = future.exception(timeout=60) if future.status == "error" else None
        except StopIteration:
            raise StudyError("the workers have nothing left to do") from None
        except StudyError:
            raise
        except Exception as fault:
            raise self._lost(fault) from fault
        if isinstance(error, self._distributed.KilledWorker):
            deaths = self._deaths[task.chunk] = self._deaths.get(task.chunk, 0) + 1
            if deaths > DEATHS:
                raise StudyError(
                    f"{deaths} workers died over chunk {task.chunk}, even with its runs in "
                    "processes of their own: look at the machine's memory and the workers' logs"
                )
            return task, None
        if error is None:
            raise self._lost(None)
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

    def _local(self, workers: int) -> Any:
        self.workers = workers
        return self._distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0",
            memory_limit=0, local_directory=self._scratch.name, silence_logs=50,
        )  # fmt: skip

    def _connected(self, address: Any) -> Any:
        try:
            if self.cluster is None:
                asyncio.run(_answering(address))
            client = self._distributed.Client(address, timeout=ANSWER, set_as_default=False)
        except (OSError, ValueError) as error:  # a timeout is the former
            told = first_line(error)
            raise StudyError(f"no scheduler answers at {address}: {told}") from None
        try:
            client.wait_for_workers(1, timeout=ANSWER if self.cluster is None else APPEAR)
        except TimeoutError:
            client.close(timeout=5)
            raise StudyError(f"the scheduler at {address} has no workers") from None
        return client

    def _agree(self) -> None:
        """StudyError where a worker's code is not this one's."""
        try:
            there = self.client.run(versions.versions)
        except Exception as error:
            raise StudyError(
                f"the workers cannot load this package ({first_line(error)}): install it there, "
                "or set their PYTHONPATH"
            ) from None
        for worker, found in there.items():
            told = versions.difference(versions.versions(), found)
            if told:
                raise StudyError(f"the worker at {worker} has another version: {told}")
        self._count()

    def _count(self) -> int:
        """Workers that are there now; StudyError where one has several threads."""
        threads = self.client.nthreads()
        if max(threads.values(), default=1) > 1:
            raise StudyError(
                "the workers have several threads each: start them with --nthreads 1, for a world "
                "belongs to one thread"
            )
        self.workers = len(threads) or self.workers
        return len(threads)

    def _look(self) -> None:
        """Count the workers now and then; StudyError where the last has been gone for long."""
        now = time.monotonic()
        if now - self._looked < LOOK:
            return
        self._looked = now
        try:
            there = self._count()
        except StudyError:
            raise
        except Exception as error:
            raise self._lost(error) from error
        if there:
            self._seen = now
        elif now - self._seen > APPEAR and not self._watched():
            raise StudyError(
                f"no worker has been there for {APPEAR:g} s: look at the workers' logs, start some"
            )

    def _watched(self) -> bool:
        """Whether a nanny of this process still watches a worker: it is slow, and not gone."""
        nannies = self.cluster.workers.values() if self._here else ()
        return any(nanny.status.name in BEGINNING for nanny in nannies)

    def _make_anew(self) -> None:
        """End the workers that a nanny begins again; the others nobody would."""
        try:
            there = self.client.scheduler_info(n_workers=-1)["workers"]
            watched = [address for address, told in there.items() if told["nanny"]]
            if watched:
                self.client.restart_workers(watched, timeout=60, raise_for_error=False)
        except TimeoutError:
            pass  # some are slow to come back: what is there goes on
        except Exception as error:
            raise self._lost(error) from error

    def _lost(self, error: BaseException | None) -> StudyError:
        told = f" ({first_line(error)})" if error is not None else ""
        return StudyError(f"the scheduler is gone{told}")


def _configured() -> Any:
    """distributed, told to keep little and to watch little."""
    try:
        import dask
        import distributed  # first, for it lays its own defaults over what is set before
    except ModuleNotFoundError as error:
        raise not_installed(error.name, "studies") from None

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
        "distributed.admin.tick.interval": TICK,
        "distributed.admin.tick.cycle": "60s",
        "distributed.admin.tick.limit": "1h",
        "distributed.admin.system-monitor.interval": TICK,
        # A machine with twenty times the load that it can bear is slow, and not dead: a worker
        # that says nothing for minutes stays, and one that begins is waited for.
        "distributed.scheduler.worker-ttl": None,
        "distributed.comm.timeouts.connect": SLOW,
        "distributed.comm.timeouts.tcp": SLOW,
    })
    return distributed


async def _answering(address: str) -> None:
    """Return if a scheduler answers there; whatever Dask raises if not.

    Asked first, for a Client that was never connected waits for 20 s at the end, and says so.
    """
    from distributed.core import connect

    (await connect(address, timeout=ANSWER)).abort()


def _named_cluster(path: str) -> tuple[Any, int]:
    """The cluster that a file names, and the most workers that it is to have, 0 if not told."""
    told = read_yaml(path, StudyError)
    keys = ("class", "arguments", "workers")
    if not isinstance(told, Mapping) or "class" not in told:
        raise StudyError(f"{path} names no cluster: give class, arguments and workers")
    for key in told:
        if key not in keys:
            raise StudyError(unknown_key(f"{path}: ", key, keys))
    least, most = _asked_workers(path, told.get("workers", 0))
    module, _, name = str(told["class"]).rpartition(".")
    try:
        cluster = getattr(importlib.import_module(module), name)(**dict(told.get("arguments", {})))
        if least < most:
            cluster.adapt(minimum=least, maximum=most)
        elif most:
            cluster.scale(most)
    except Exception as error:  # whatever a cluster's own code may raise
        raise StudyError(f"{path}: {told['class']}: {first_line(error)}") from None
    return cluster, most


def _asked_workers(path: str, told: Any) -> tuple[int, int]:
    """Least and most; 0 and 0 where nothing is said."""
    both = told if isinstance(told, list) else [told, told]
    whole = all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in both)
    if not (whole and len(both) == 2 and both[0] <= both[1] and (both[1] or told == 0)):
        raise StudyError(f"{path}: workers is {told!r}, must be a number, or [least, most]")
    return both[0], both[1]
