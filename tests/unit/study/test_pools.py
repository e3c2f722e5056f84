"""What a pool of Dask's workers makes of what becomes of its chunks, without a worker."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace

import pytest

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.study import pools, rows, versions
from aras_visual_servo_bench.study.pools import DEATHS, DaskPool
from aras_visual_servo_bench.study.work import StudyTask

DONE, CANCELLED = rows.Rows([{"run": 1}]), "cancelled"


class KilledError(Exception):
    """As distributed.KilledWorker."""


class Dask:
    """distributed's names that a pool uses. ends: of the chunks in the order in which they are sent
    what becomes of each, Rows that are done as long as nothing else is said."""

    KilledWorker = KilledError

    def __init__(self, workers=1):
        self.ends, self.sent, self.log, self._ready = deque(), [], [], deque()
        self.loop, self._workers = None, workers

    def LocalCluster(self, n_workers, **keys):
        assert n_workers == self._workers
        return SimpleNamespace(workers={}, close=lambda timeout: self.log.append("cluster"))

    def Client(self, cluster, timeout, set_as_default):
        return self

    def as_completed(self, loop, raise_errors):
        return self

    def wait_for_workers(self, count, timeout):
        assert count == 1

    def run(self, function):
        return {f"tcp://{n}": versions.versions() for n in range(self._workers)}

    def nthreads(self):
        return dict.fromkeys(range(self._workers), 1)

    def submit(self, function, task, key, pure):
        end = self.ends.popleft() if self.ends else DONE
        self.sent.append((key, task.guarded))
        status = "finished" if end is DONE else CANCELLED if end is CANCELLED else "error"
        return SimpleNamespace(key=key, status=status, result=lambda timeout: end,
                               exception=lambda timeout: end)

    def add(self, future):
        self._ready.append(future)

    def has_ready(self):
        return bool(self._ready)

    def is_empty(self):
        return not self._ready

    def __next__(self):
        if not self._ready:
            raise StopIteration
        return self._ready.popleft()

    def scheduler_info(self, n_workers):
        return {"workers": {"one": {"nanny": "tcp://n"}, "two": {"nanny": None}}}

    def restart_workers(self, addresses, timeout, raise_for_error):
        self.log.append((addresses, len(self.sent), len(self._ready)))

    def close(self, timeout):
        self.log.append("client")


@pytest.fixture
def pool_of(monkeypatch):
    """Makes a Dask and a pool of it."""
    made = []

    def make(workers=1, **keys):
        dask = Dask(workers)
        monkeypatch.setattr(pools, "_configured", lambda: dask)
        made.append(DaskPool(workers, **keys))
        return dask, made[-1]

    yield make
    for pool in made:
        pool.close()


def test_every_worker_has_one_chunk_waiting_and_is_made_anew_after_so_many(pool_of):
    dask, pool = pool_of(3, renew=4)
    done, most = [], 0
    while len(done) < 30:
        while pool.room:
            pool.submit(StudyTask("", len(dask.sent)))
        most = max(most, len(dask.sent) - len(done))
        task, found = pool.next()
        assert found is DONE
        done.append(task.chunk)
    assert done == list(range(30)) and most == 6
    # Those that a nanny begins again, and only while nothing is under way.
    assert dask.log == [(["one"], 12, 0), (["one"], 24, 0)]
    pool.close()
    assert dask.log[2:] == ["client", "cluster"]


def test_a_chunk_whose_worker_died_is_sent_again_with_its_runs_guarded(pool_of):
    dask, pool = pool_of()
    task = StudyTask("", 7)
    for tries in range(2 * DEATHS):
        # Once it was done its deaths are forgotten.
        dask.ends.append(DONE if tries == DEATHS else KilledError())
        pool.submit(task)
        assert pool.next() == (task, DONE if tries == DEATHS else None)
    dask.ends += [KilledError(), KilledError()]
    pool.submit(task)
    pool.next()
    pool.submit(task)
    told = f"^{DEATHS + 1} workers died over chunk 7, even with its runs in processes of their own"
    with pytest.raises(StudyError, match=told):
        pool.next()
    assert dask.sent == [(f"chunk-7-{n}", n > 0) for n in (*range(DEATHS + 1), *range(DEATHS + 1))]


@pytest.mark.parametrize(("end", "told"), [
    (StudyError("a worker has another version: numpy"), "^a worker has another version: numpy$"),
    (ValueError("of three"), "^chunk 0 failed: ValueError: of three$"),
    (CANCELLED, "^the scheduler is gone$"),
])  # fmt: skip
def test_what_went_wrong_with_a_chunk_is_told(pool_of, end, told):
    dask, pool = pool_of()
    dask.ends.append(end)
    pool.submit(StudyTask("", 0))
    with pytest.raises(StudyError, match=told):
        pool.next()
    with pytest.raises(StudyError, match="nothing left to do"):
        pool.next()


@pytest.mark.parametrize("call", ["submit", "nthreads", "__next__", "scheduler_info"])
def test_a_scheduler_that_is_gone_is_told_wherever_it_is_missed(pool_of, monkeypatch, call):
    dask, pool = pool_of(renew=1)

    def gone(*args, **keys):
        raise OSError("closed\nby its owner")

    monkeypatch.setattr(pools, "LOOK", 0.0)
    if call != "submit":
        pool.submit(StudyTask("", 0))
    if call == "scheduler_info":
        pool.next()
    monkeypatch.setattr(Dask, call, gone)
    with pytest.raises(StudyError, match=r"^the scheduler is gone \(closed\)"):
        {"submit": lambda: pool.submit(StudyTask("", 0)), "__next__": pool.next}.get(
            call, lambda: pool.room)()
