"""Workers of Dask, once for real: the same bytes, a death survived, and who is refused."""

from __future__ import annotations

import io
import json
import os
import signal
import threading

import dask
import distributed
import pytest

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.study import engine, pools, versions, work
from aras_visual_servo_bench.study.folder import Folder
from aras_visual_servo_bench.study.pools import DaskPool, ThisProcess
from aras_visual_servo_bench.study.progress import Progress
from aras_visual_servo_bench.study.work import ONE_THREAD


def parts(path):
    return {p.name: p.read_bytes() for p in (path / "parts").glob("*")}


def _looks(server):
    """ms between the looks of a scheduler or worker at its own load."""
    return min(server.periodic_callbacks[name].callback_time for name in ("tick", "monitor"))


class Killing(Progress):
    """Kills a worker when the first chunk is there."""

    def more(self, *told):
        super().more(*told)
        if self.victims:
            os.kill(self.victims.pop(), signal.SIGKILL)


def test_two_workers_one_killed_and_all_made_anew_end_with_the_bytes_of_one_process(tiny, tmp_path):
    study = tiny(chunk=1)
    here, there = tmp_path / "here", tmp_path / "there"
    engine.carry_out(
        Folder.create(here, study, ""), ThisProcess(), Progress(study.runs, out=io.StringIO())
    )
    with DaskPool(2, renew=2) as pool:
        before = pool._client.run(os.getpid)
        environment = pool._client.run(lambda: dict(os.environ))
        assert len(before) == 2 == pool.workers
        assert all(env[key] == "1" for env in environment.values() for key in ONE_THREAD)
        looks = pool._client.run(lambda dask_worker: _looks(dask_worker))
        assert min([*looks.values(), _looks(pool._cluster.scheduler)]) >= 1000.0
        progress = Killing(study.runs, out=io.StringIO())
        progress.victims = [next(iter(before.values()))]
        done = engine.carry_out(Folder.create(there, study, ""), pool, progress)
        assert not set(before.values()) & set(pool._client.run(os.getpid).values())
    assert done.runs == study.runs
    assert parts(here) == parts(there)


def test_a_worker_that_stands_still_for_a_while_is_slow_and_not_dead(tiny, tmp_path, monkeypatch):
    """As on a machine that bears twenty times its load; the scheduler gave workers 2 s here."""
    dask.config.set({"distributed.scheduler.worker-ttl": "2s"})
    monkeypatch.setattr(pools, "APPEAR", 1.0)
    monkeypatch.setattr(pools, "LOOK", 0.2)
    study = tiny(chunk=1)
    with DaskPool(1) as pool:
        (worker,) = pool._client.run(os.getpid).values()
        os.kill(worker, signal.SIGSTOP)
        threading.Timer(8.0, os.kill, (worker, signal.SIGCONT)).start()
        progress = Progress(study.runs, out=io.StringIO())
        done = engine.carry_out(Folder.create(tmp_path / "out", study, ""), pool, progress)
        assert done.runs == study.runs
        assert set(pool._client.run(os.getpid).values()) == {worker}


def test_a_run_that_hangs_in_a_worker_ends_as_a_row(tiny, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_hanging.py").write_text(
        "from aras_visual_servo_bench.numbers.metrics import metric\n"
        "@metric('', 'smaller', 'me')\ndef hanging(run):\n    'Never ends at a gain of 2.'\n"
        "    while run.experiment.gain == 2.0:\n        pass\n    return 0.0\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    study = tiny(metrics=["my_hanging:hanging"], repeats=1, chunk=1, limit=8.0)
    made = Folder.create(tmp_path / "out", study, "")
    with DaskPool(1) as pool:
        engine.carry_out(made, pool, Progress(study.runs, out=io.StringIO()))
    assert made.results()["outcome"].to_pylist() == ["timed_out", "time_limit", "timed_out"]


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere", "http://127.0.0.1:9"])
def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch, address):
    """And no Client was made, which would wait for 20 s at the end and write a traceback."""
    monkeypatch.setattr(pools, "ANSWER", 0.5)
    monkeypatch.setattr(distributed, "Client", None)
    with pytest.raises(StudyError, match=f"no scheduler answers at {address}") as caught:
        DaskPool(scheduler=address)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("text", "complaint"), [
    ("class: nowhere.Cluster\n", "nowhere.Cluster: No module named"),
    ("class: distributed.LocalClutser\n", "no attribute|cannot import"),
    ("clas: x\n", "names no cluster"),
    ("class: x.Y\nworker: 3\n", "unknown key 'worker': did you mean 'workers'"),
    ("class: x.Y\nworkers: [3]\n", "workers is .3., must be a number, or .least, most."),
    ("class: x.Y\nworkers: [3, 1]\n", "workers is .3, 1., must be"),
    ("class: x.Y\nworkers: many\n", "workers is 'many', must be"),
])  # fmt: skip
def test_clusters_that_are_none(tmp_path, text, complaint):
    (tmp_path / "cluster.yaml").write_text(text)
    with pytest.raises(StudyError, match=complaint):
        DaskPool(cluster=str(tmp_path / "cluster.yaml"))


def test_a_named_clusters_workers_are_used_when_they_come(tiny, tmp_path, monkeypatch):
    """It begins with none, and more are begun for chunks that wait: two for the first would do."""
    monkeypatch.setattr(pools, "LOOK", 0.0)
    file = tmp_path / "cluster.yaml"
    file.write_text(
        "class: distributed.LocalCluster\nworkers: [1, 2]\n"
        "arguments: {n_workers: 0, threads_per_worker: 1, dashboard_address: ':0'}\n"
    )
    study = tiny(chunk=1, repeats=8)
    made = Folder.create(tmp_path / "out", study, "")
    with DaskPool(cluster=str(file)) as pool:
        sent = 0
        while pool.room:
            pool.submit(work.StudyTask(json.dumps(study.to_mapping()), sent))
            sent += 1
        assert sent == 4  # two for each that there may be
        for _ in range(sent):
            task, rows = pool.next()
            made.write(task.chunk, rows)
        engine.carry_out(made, pool, Progress(study.runs, out=io.StringIO()))
    assert made.missing() == []


@pytest.fixture(scope="module")
def other():
    """A scheduler that was started elsewhere, with one worker that no nanny watches."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
        protocol="tcp://",
    ) as cluster:
        yield cluster


def test_a_scheduler_of_somebody_else_is_used_and_left_as_it_was(tiny, tmp_path, other):
    study = tiny(chunk=1)
    made = Folder.create(tmp_path, study, "")
    with DaskPool(scheduler=other.scheduler_address, renew=2) as pool:
        engine.carry_out(made, pool, Progress(study.runs, out=io.StringIO()))
    assert made.missing() == [] and len(other.scheduler.workers) == 1


def test_workers_of_another_version_or_with_threads_are_refused(monkeypatch, other):
    address = other.scheduler_address
    there = {**versions.versions(), "numba": "0.1"}
    monkeypatch.setattr(distributed.Client, "run", lambda self, asked: {"tcp://one": there})
    told = "worker at tcp://one has another version: numba"
    with pytest.raises(StudyError, match=told) as caught:
        DaskPool(scheduler=address)
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    monkeypatch.setattr(distributed.Client, "nthreads", lambda self: {"one": 2})
    with pytest.raises(StudyError, match="several threads each: start them with --nthreads 1"):
        DaskPool(scheduler=address)


def test_a_study_whose_last_worker_has_gone_says_so(tiny, monkeypatch, other):
    with DaskPool(scheduler=other.scheduler_address) as pool:
        monkeypatch.setattr(pools, "LOOK", 0.0)
        monkeypatch.setattr(pools, "APPEAR", 0.0)
        monkeypatch.setattr(pool._client, "nthreads", dict)
        with pytest.raises(StudyError, match="no worker has been there for 0 s"):
            pool._look()
