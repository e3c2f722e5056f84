"""Pool of Dask workers after failures of chunks and workers, without a real worker."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import pytest

from aras_visual_servo_bench.errors import BenchError, StudyError
from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.studies import versions
from aras_visual_servo_bench.studies.chunk_execution import StudyChunk
from aras_visual_servo_bench.studies.dask_pool import MAX_DEATHS, DaskPool

DONE, CANCELLED = rows.RunRows([{"run": 1}]), "cancelled"


class KilledError(Exception):
    """Error with the name of distributed.KilledWorker."""


def end_of(key, status, end):
    """distributed.Future that has ended."""
    def result(timeout):
        assert timeout == 60
        return end

    return SimpleNamespace(key=key, status=status, result=result, exception=result)


def nanny(status):
    """distributed.Nanny, whose status has a name."""
    return SimpleNamespace(status=SimpleNamespace(name=status))


class Dask:
    """distributed's names that a pool uses. ends: of the chunks in the order in which they are sent
    what becomes of each, Rows that are done as long as nothing else is said."""

    KilledWorker = KilledError

    def __init__(self, workers=1):
        self.ends, self.sent, self.log, self.ready = deque(), [], [], deque()
        self.loop, self.workers, self.nannies, self.looks, self.asked = None, workers, {}, 0, 0

    def LocalCluster(self, n_workers, silence_logs, **keys):
        assert n_workers == self.workers and silence_logs == logging.CRITICAL
        assert keys["processes"] and keys["threads_per_worker"] == 1 and not keys["memory_limit"]
        self.scratch = Path(keys["local_directory"])
        return SimpleNamespace(
            workers=self.nannies, close=lambda timeout: self.log.append("cluster"))

    async def connect(self, address, timeout):
        return SimpleNamespace(abort=lambda: None)

    def Client(self, cluster, timeout, set_as_default):
        return self

    def as_completed(self, loop, raise_errors):
        assert not raise_errors
        return self

    def wait_for_workers(self, count, timeout):
        assert count == 1

    def run(self, function):
        return {f"tcp://{n}": versions.read_versions() for n in range(self.workers)}

    def nthreads(self):
        self.looks += 1
        return dict.fromkeys(range(self.workers), 1)

    def submit(self, function, task, key):
        end = self.ends.popleft() if self.ends else DONE
        self.sent.append((key, task.is_isolated))
        status = "finished" if end is DONE else CANCELLED if end is CANCELLED else "error"
        return end_of(key, status, end)

    def add(self, future):
        self.ready.append(future)

    def has_ready(self):
        self.asked += 1
        assert self.asked < 100  # one would wait for ever
        return bool(self.ready)

    def __next__(self):
        self.asked = 0
        if not self.ready:
            raise StopIteration
        return self.ready.popleft()

    def scheduler_info(self, n_workers):
        there = {"one": "tcp://n", "two": None, "three": "tcp://m"}
        count = len(there) if n_workers == -1 else n_workers
        return {"workers": {name: {"nanny": nanny} for name, nanny in [*there.items()][:count]}}

    def restart_workers(self, addresses, timeout, raise_for_error):
        assert timeout <= 60 and not raise_for_error
        self.log.append((addresses, len(self.sent), len(self.ready)))
        if len(self.log) == 2:
            raise TimeoutError("some are slow")

    def close(self, timeout):
        assert timeout <= 10
        self.log.append("client")


@pytest.fixture
def pool_of(monkeypatch):
    """Makes a Dask and a pool of it."""
    made = []

    def make(workers=1, **keys):
        dask = Dask(workers)
        monkeypatch.setitem(sys.modules, "distributed", dask)
        monkeypatch.setitem(sys.modules, "distributed.core", dask)
        made.append(DaskPool(workers, **keys))
        return dask, made[-1]

    yield make
    for pool in made:
        pool.close()


@pytest.mark.parametrize(("cores", "workers"), [(7, 7), (None, 1)])
def test_without_a_number_there_is_a_worker_a_core(monkeypatch, cores, workers):
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    monkeypatch.setitem(sys.modules, "distributed", Dask(workers))
    monkeypatch.setitem(sys.modules, "distributed.core", sys.modules["distributed"])
    DaskPool().close()


def test_every_worker_has_one_chunk_waiting_and_is_made_anew_after_so_many(pool_of):
    dask, pool = pool_of(3, chunks_before_restart=4)
    done, most = [], 0
    while len(done) < 30:
        while pool.has_room:
            pool.submit(StudyChunk("", len(dask.sent)))
        most = max(most, len(dask.sent) - len(done))
        task, found = pool.wait_for_chunk()
        assert found is DONE
        done.append(task.chunk)
    assert done == list(range(30)) and most == 6
    # Those that a nanny begins again, and only while nothing is under way.
    assert dask.log == [(["one", "three"], 12, 0), (["one", "three"], 24, 0)]
    with pool:
        assert len(dask.log) == 2 and dask.scratch.is_dir()
    pool.close()
    assert not dask.scratch.exists()
    assert dask.log[2:] == ["client", "cluster"]


def test_a_chunk_whose_worker_died_is_sent_again_with_its_runs_guarded(pool_of):
    dask, pool = pool_of()
    task = StudyChunk("", 7)
    for tries in range(2 * MAX_DEATHS):
        # Once it was done its deaths are forgotten.
        dask.ends.append(DONE if tries == MAX_DEATHS else KilledError())
        pool.submit(task)
        assert pool.wait_for_chunk() == (task, DONE if tries == MAX_DEATHS else None)
    dask.ends += [KilledError(), KilledError()]
    pool.submit(task)
    pool.wait_for_chunk()
    pool.submit(task)
    told = f"^{MAX_DEATHS + 1} workers died while they ran chunk 7, even with one process per run"
    with pytest.raises(StudyError, match=told):
        pool.wait_for_chunk()
    assert dask.sent == 2 * [(f"chunk-7-{n}", n > 0) for n in range(MAX_DEATHS + 1)]


@pytest.mark.parametrize(("end", "told"), [
    (StudyError("a worker has other versions: numpy"), "^a worker has other versions: numpy$"),
    (ValueError("of three"), "^chunk 0 failed: ValueError: of three$"),
    (CANCELLED, "^the connection to the scheduler is lost$"),
])  # fmt: skip
def test_what_went_wrong_with_a_chunk_is_told(pool_of, end, told):
    dask, pool = pool_of()
    with pytest.raises(StudyError, match="^the workers have no chunk: submit a chunk first$"):
        pool.wait_for_chunk()
    dask.ends.append(end)
    pool.submit(StudyChunk("", 0))
    with pytest.raises(StudyError, match=told):
        pool.wait_for_chunk()


@pytest.mark.parametrize("keys", [{}, {"scheduler": "tcp://there"}])
def test_the_last_worker_may_be_gone_for_five_minutes_or_as_long_as_a_nanny_begins_it(
    pool_of, monkeypatch, keys
):  # fmt: skip
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    dask, pool = pool_of(**keys)

    def after(seconds, workers):
        now[0], dask.workers = now[0] + seconds, workers
        return pool.has_room and pool.workers

    assert after(1.5, 2) == 1 and dask.looks == 1  # it looks every two seconds
    assert after(0.5, 2) == 2 and after(1.5, 3) == 2 and dask.looks == 2
    assert [after(seconds, 0) for seconds in (2.0, 296.0)] == [2, 2]
    assert after(2.0, 1) == 1  # and is there again
    assert after(300.0, 0) == 1
    if not keys:
        dask.nannies["one"] = nanny("starting")
        assert after(600.0, 0) == 1
        dask.nannies["one"] = nanny("failed")
    for ask in (lambda: pool.has_room, pool.wait_for_chunk):
        now[0] += 2.0
        with pytest.raises(StudyError, match="^no worker has been connected for 300 s: check the"):
            ask()
    dask.workers = 1
    monkeypatch.setattr(dask, "nthreads", lambda: {"one": 1, "two": 2})
    now[0] += 2.0
    with pytest.raises(StudyError, match="^the workers have several threads each"):
        pool.wait_for_chunk()


def test_workers_that_cannot_load_the_package_and_dask_that_is_not_there_are_told(
    pool_of, monkeypatch
):  # fmt: skip
    def alien(dask, function):
        raise ModuleNotFoundError("No module named 'mine'")

    monkeypatch.setattr(Dask, "run", alien)
    told = "^the workers cannot load this package .No module named 'mine'.: install it there, or"
    with pytest.raises(StudyError, match=told):
        pool_of()
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BenchError, match="^distributed is not installed: "):
        DaskPool(1)


@pytest.mark.parametrize(("keys", "patience", "left"), [
    ({}, 300.0, ["client", "cluster"]), ({"scheduler": "tcp://there"}, 10.0, ["client"]),
])  # fmt: skip
def test_a_pool_to_which_no_worker_comes_is_none_and_leaves_nothing(
    pool_of, monkeypatch, keys, patience, left
):
    asked = []

    def none(dask, count, timeout):
        asked.append(dask)
        assert timeout == patience
        raise TimeoutError(f"not within {timeout:g} s")

    monkeypatch.setattr(Dask, "wait_for_workers", none)
    with pytest.raises(StudyError, match="^the scheduler at .* has no workers: start workers$"):
        pool_of(**keys)
    assert asked[0].log == left


@pytest.mark.parametrize("call", ["submit", "nthreads", "__next__", "scheduler_info"])
def test_a_scheduler_that_is_gone_is_told_wherever_it_is_missed(pool_of, monkeypatch, call):
    dask, pool = pool_of(chunks_before_restart=1)

    def gone(*args, **keys):
        raise OSError("closed\nby its owner")

    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + 3.0)
    if call != "submit":
        pool.submit(StudyChunk("", 0))
    if call == "scheduler_info":
        pool.wait_for_chunk()
    monkeypatch.setattr(Dask, call, gone)
    with pytest.raises(StudyError, match=r"^the connection to the scheduler is lost \(closed\)"):
        {"submit": lambda: pool.submit(StudyChunk("", 0)), "__next__": pool.wait_for_chunk}.get(
            call, lambda: pool.has_room)()
