"""Pool of Dask's workers, on this machine, of a running scheduler, or of a cluster."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from aras_visual_servo_base.setting_values import describe_unknown_key
from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import StudyError, make_missing_library_error, read_first_line
from . import chunk_execution, versions
from .chunk_execution import StudyChunk
from .cli_defaults import CHUNKS_BEFORE_RESTART
from .pools import FinishedChunk, Pool

ANSWER_TIMEOUT = 10.0  # longest time within which a scheduler has to answer, s
# time without any worker, at the start or later, after which a study fails, s
WORKER_TIMEOUT = 300.0
# time between two counts of the workers, s; in a cluster, their number can change
COUNT_PERIOD = 2.0
# Time between two checks whether a chunk is finished, s. No worker waits for the check, because
# each worker already has a second chunk.
POLL_PERIOD = 0.02
# States of a nanny (Dask's process that starts and supervises a worker) with a living worker.
STARTING_STATES = ("init", "starting", "running", "undefined")
# Longest time for a connection between processes of Dask. An overloaded machine can be slow.
CONNECT_TIMEOUT = "600s"
NEVER = "1000 days"  # longer than any study
TICK_PERIOD = "10s"  # time between two self-checks of a worker or of the scheduler
# number of workers that may die while they run the same chunk before the study fails
MAX_DEATHS = 5
LOST_CONNECTION = "the connection to the scheduler is lost"


class DaskPool(Pool):
    """Pool of Dask workers: on this machine, of a running scheduler, or of a cluster class.

    Attributes:
        cluster: Dask cluster; None if a running scheduler is used.
        client: Dask client; None after `close`.
    """

    def __init__(
        self,
        workers: int = 0,
        scheduler: str = "",
        cluster: str = "",
        chunks_before_restart: int = CHUNKS_BEFORE_RESTART,
    ) -> None:
        """Start the workers, or connect to them.

        Args:
            workers: number of processes on this machine; 0: one per core.
            scheduler: address of a running scheduler; '': none.
            cluster: path of a YAML file with the class and arguments of a Dask cluster; '': none.
            chunks_before_restart: all workers are restarted after this number of chunks per worker.

        Raises:
            StudyError: the scheduler does not answer, it has no worker, or a worker has different
                versions of the code or libraries.
        """
        self._chunks_before_restart = chunks_before_restart
        self._max_workers, self._is_local = 0, not (scheduler or cluster)
        self._distributed = _configure_dask(self._is_local)
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
                self.workers = workers or os.cpu_count() or 1
                address = self.cluster = self._distributed.LocalCluster(
                    n_workers=self.workers, threads_per_worker=1, processes=True,
                    dashboard_address=":0", memory_limit=0, local_directory=self._scratch.name,
                    silence_logs=50,
                )  # fmt: skip
            self.client = self._connect(address)
            self._check_versions()
            self._check_time = self._alive_time = time.monotonic()
        except BaseException:
            self.close()
            raise
        self._tasks: dict[Any, StudyChunk] = {}
        self._deaths: dict[int, int] = {}
        self._chunks_since_restart = 0
        self._finished = self._distributed.as_completed(
            loop=self.client.loop, raise_errors=False
        )

    @property
    def has_room(self) -> bool:
        """True if another chunk can be submitted: there are fewer than two chunks per worker.

        Workers that an adaptive cluster has not started yet are counted, too, because the cluster
        starts them when chunks wait. Shortly before a restart of the workers, the value is False.
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

    def submit(self, task: StudyChunk) -> None:
        """Send a chunk of runs to a worker."""
        tries = self._deaths.get(task.chunk, 0)
        with _catch_lost_connection():
            future = self.client.submit(
                chunk_execution.carry_out, replace(task, is_isolated=tries > 0 or task.is_isolated),
                key=f"chunk-{task.chunk}-{tries}",
            )  # fmt: skip
        self._tasks[future.key] = task
        self._finished.add(future)

    def wait_for_chunk(self) -> FinishedChunk:
        """Wait until a chunk of runs is finished, and return it; see Pool.wait_for_chunk."""
        with _catch_lost_connection():
            while not self._finished.has_ready():
                self._check_workers()
                if not self._tasks:
                    raise StudyError("the workers have no chunk: submit a chunk first")
                time.sleep(POLL_PERIOD)
            future = next(self._finished)
            task = self._tasks.pop(future.key)
            if future.status == "finished":
                chunk_rows = future.result(timeout=60)
                self._chunks_since_restart += 1
                self._deaths.pop(task.chunk, None)
                return task, chunk_rows
            error = future.exception(timeout=60) if future.status == "error" else None
        if isinstance(error, self._distributed.KilledWorker):
            deaths = self._deaths[task.chunk] = self._deaths.get(task.chunk, 0) + 1
            if deaths > MAX_DEATHS:
                raise StudyError(
                    f"{deaths} workers died while they ran chunk {task.chunk}, even with one "
                    "process per run: check the machine's memory and the workers' logs"
                )
            return task, None
        if error is None:
            raise StudyError(LOST_CONNECTION)
        if isinstance(error, StudyError):
            raise error
        raise StudyError(f"chunk {task.chunk} failed: {type(error).__name__}: {error}") from error

    def close(self) -> None:
        """Close the client and the cluster."""
        for part in (self.client, self.cluster):
            if part is not None:
                with contextlib.suppress(Exception):
                    part.close(timeout=10)
        self.client = self.cluster = None
        self._scratch.cleanup()

    def _connect(self, address: Any) -> Any:
        try:
            if self.cluster is None:
                asyncio.run(_check_scheduler(address))
            client = self._distributed.Client(address, timeout=ANSWER_TIMEOUT, set_as_default=False)
        except (OSError, ValueError) as error:  # a timeout of the connection is also an OSError
            reason = read_first_line(error)
            raise StudyError(
                f"no scheduler answers at {address} ({reason}): start one, or correct the address"
            ) from None
        try:
            client.wait_for_workers(
                1, timeout=ANSWER_TIMEOUT if self.cluster is None else WORKER_TIMEOUT
            )
        except TimeoutError:
            client.close(timeout=5)
            raise StudyError(f"the scheduler at {address} has no workers: start workers") from None
        return client

    def _check_versions(self) -> None:
        """Check that all workers have the same versions of code and libraries as this process.

        Raises:
            StudyError: a worker has different versions.
        """
        try:
            by_worker = self.client.run(versions.read_versions)
        except Exception as error:
            raise StudyError(
                f"the workers cannot load this package ({read_first_line(error)}): install it "
                "there, or set their PYTHONPATH"
            ) from None
        for worker, worker_versions in by_worker.items():
            difference = versions.describe_difference(versions.read_versions(), worker_versions)
            if difference:
                raise StudyError(
                    f"the worker at {worker} has other versions: {difference}; install the same "
                    "versions there"
                )
        self._count_workers()

    def _count_workers(self) -> int:
        """Count the connected workers.

        Raises:
            StudyError: a worker has several threads.
        """
        threads = self.client.nthreads()
        if max(threads.values(), default=1) > 1:
            raise StudyError(
                "the workers have several threads each, and a simulation needs a single one: start "
                "them with --nthreads 1"
            )
        self.workers = len(threads) or self.workers
        return len(threads)

    def _check_workers(self) -> None:
        """Count the workers if the last count was at least COUNT_PERIOD ago.

        Raises:
            StudyError: there has been no worker for the time WORKER_TIMEOUT.
        """
        now = time.monotonic()
        if now - self._check_time < COUNT_PERIOD:
            return
        self._check_time = now
        with _catch_lost_connection():
            count = self._count_workers()
        if count:
            self._alive_time = now
        elif now - self._alive_time > WORKER_TIMEOUT and not self._has_live_nanny():
            raise StudyError(
                f"no worker has been connected for {WORKER_TIMEOUT:g} s: check the workers' logs, "
                "and start workers"
            )

    def _has_live_nanny(self) -> bool:
        """Return True if a worker on this machine is alive, as reported by its supervising process.
        """
        nannies = self.cluster.workers.values() if self._is_local else ()
        return any(nanny.status.name in STARTING_STATES for nanny in nannies)

    def _restart_workers(self) -> None:
        """Restart the workers that have a nanny, the process of Dask that can start a worker again.
        """
        # a slow worker restarts later, while the other workers continue
        with _catch_lost_connection(), contextlib.suppress(TimeoutError):
            workers = self.client.scheduler_info(n_workers=-1)["workers"]
            with_nanny = [address for address, info in workers.items() if info["nanny"]]
            if with_nanny:
                self.client.restart_workers(with_nanny, timeout=60, raise_for_error=False)


@contextlib.contextmanager
def _catch_lost_connection() -> Iterator[None]:
    """Convert an exception of Dask in the `with` block into a StudyError."""
    try:
        yield
    except StudyError:
        raise
    except Exception as error:
        raise StudyError(f"{LOST_CONNECTION} ({read_first_line(error)})") from error


def _configure_dask(is_local: bool) -> Any:
    """Set options of Dask that reduce its history and self-checks; return its module `distributed`.

    Args:
        is_local: whether the workers are processes on this machine that Dask's nannies start.
    """
    try:
        import dask
        import distributed  # this import sets defaults, so it must precede dask.config.set
    except ModuleNotFoundError as error:
        raise make_missing_library_error(error.name, "studies") from None

    dask.config.set({
        "distributed.nanny.pre-spawn-environ": chunk_execution.ONE_THREAD,
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
        # By default, each event loop checks itself every 20 ms, which takes 5 % of a core.
        "distributed.admin.tick.interval": TICK_PERIOD,
        "distributed.admin.tick.cycle": "60s",
        "distributed.admin.tick.limit": "1h",
        "distributed.admin.system-monitor.interval": TICK_PERIOD,
        # On an overloaded machine, a worker may start slowly, or may not answer for minutes. These
        # timeouts are long or switched off, so that Dask does not regard such a worker as lost.
        "distributed.scheduler.worker-ttl": None,
        "distributed.comm.timeouts.connect": CONNECT_TIMEOUT,
        "distributed.comm.timeouts.tcp": CONNECT_TIMEOUT,
    })
    if is_local:
        # By default, Dask removes a worker that is not connected 15 s after its last process has
        # ended, even if its nanny is just starting the next one: the study would lose the worker.
        dask.config.set({"distributed.deploy.lost-worker-timeout": NEVER})
    return distributed


async def _check_scheduler(address: str) -> None:
    """Connect to a scheduler; if it does not answer, raise the error of Dask.

    This check is made before a Client is created, because closing a Client that could not connect
    takes 20 s.
    """
    from distributed.core import connect

    (await connect(address, timeout=ANSWER_TIMEOUT)).abort()


def _create_cluster(path: str) -> tuple[Any, int]:
    """Create the cluster that a YAML file describes.

    Returns:
        The cluster, and its maximum number of workers; the number is 0 if the file does not give
        it.
    """
    content = read_yaml(path, StudyError)
    keys = ("class", "arguments", "workers")
    if not isinstance(content, Mapping) or "class" not in content:
        raise StudyError(f"{path} has no key 'class': give class, arguments and workers")
    for key in content:
        if key not in keys:
            raise StudyError(describe_unknown_key(f"{path}: ", key, keys))
    least, most = _parse_worker_range(path, content.get("workers", 0))
    module, _, name = str(content["class"]).rpartition(".")
    arguments = dict(content.get("arguments", {}))
    try:
        cluster = getattr(importlib.import_module(module), name)(**arguments)
        if least < most:
            cluster.adapt(minimum=least, maximum=most)
        elif most:
            cluster.scale(most)
    except Exception as error:  # a user's cluster class may raise any exception
        raise StudyError(f"{path}: {content['class']}: {read_first_line(error)}") from None
    return cluster, most


def _parse_worker_range(path: str, value: Any) -> tuple[int, int]:
    """Return the minimum and maximum number of workers in a cluster file; both 0 if not given."""
    both = value if isinstance(value, list) else [value, value]
    are_counts = all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in both)
    if not (are_counts and len(both) == 2 and both[0] <= both[1] and (both[1] or value == 0)):
        raise StudyError(f"{path}: workers is {value!r}, must be a number, or [minimum, maximum]")
    return both[0], both[1]
