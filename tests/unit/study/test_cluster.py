"""Real Dask workers: identical files, a killed worker, and refused workers."""

from __future__ import annotations

import contextlib
import json
import os
from typing import NamedTuple

import dask
import distributed
import distributed.core
import pytest

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.studies import chunk_execution as work
from aras_visual_servo_bench.studies import study_execution as engine
from aras_visual_servo_bench.studies import versions
from aras_visual_servo_bench.studies.chunk_execution import ONE_THREAD
from aras_visual_servo_bench.studies.dask_pool import DaskPool
from aras_visual_servo_bench.studies.study_folder import StudyFolder


def parts(path):
    return {p.name: p.read_bytes() for p in (path / "parts").glob("*")}


@pytest.fixture(scope="module")
def hanging(tiny):
    """A study of three runs, the second of which never ends; `PYTHONPATH` leads to its metric."""
    with pytest.MonkeyPatch.context() as patch:
        path = f"{os.path.dirname(__file__)}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
        patch.setenv("PYTHONPATH", path)
        yield tiny(metrics=["made_studies:hanging"], repeats=1, chunk=1, limit=60.0)


class History(NamedTuple):
    """Folders of a pool with one worker, and its process ids at the beginning and the end."""

    here: StudyFolder
    there: StudyFolder
    begun: int
    ended: int


@pytest.fixture(scope="module")
def history(hanging, tmp_path_factory):
    """What became of one worker: one of its runs hangs, and after two chunks it is made anew."""
    path = tmp_path_factory.mktemp("history")
    # Both at once, for their rows say which code the checkout has, and somebody may edit it.
    here, made = (StudyFolder.create(path / name, hanging, "") for name in ("here", "there"))
    study = hanging.to_mapping()
    # Dask would remove a worker that is just started again, if it looked at that moment.
    patch = dask.config.set({"distributed.deploy.lost-worker-timeout": "100 ms"})
    with patch, DaskPool(1, chunks_before_restart=2) as pool:
        (begun,) = pool.client.run(os.getpid).values()
        (environment,) = pool.client.run(lambda: dict(os.environ)).values()
        assert all(environment[key] == "1" for key in ONE_THREAD)
        # The worker has loaded everything before the run that hangs, whose limit is short.
        for chunk, limit in ((0, study["limit"]), (1, 2.0)):
            done = None
            while done is None:  # the worker dies of the run that hangs, and tries it in a child
                pool.submit(work.StudyChunk(json.dumps({**study, "limit": limit}), chunk))
                task, done = pool.wait_for_chunk()
            made.write_chunk(task.chunk, done)
        engine.run_missing(made, lambda: contextlib.nullcontext(pool), None)
        (ended,) = pool.client.run(os.getpid).values()
    return History(here, StudyFolder.open(made.path), begun, ended)


def test_a_run_that_hangs_and_a_worker_made_anew_leave_the_bytes_of_one_process(history, hanging):
    made, here = history.there, history.here
    assert made.read_results()["outcome"].to_pylist() == ["timed_out", "time_limit", "timed_out"]
    assert history.ended != history.begun
    for chunk in (0, 2):
        task = work.StudyChunk(json.dumps(hanging.to_mapping()), chunk)
        here.write_chunk(chunk, work.carry_out(task))
    there = parts(made.path)
    assert parts(here.path) == {name: there[name] for name in parts(here.path)} and len(there) == 3


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere"])
def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch, address):
    """And no Client was made, which would wait for 20 s at the end and write a traceback."""
    connect, limits = distributed.core.connect, []

    def impatient(address, timeout):
        limits.append(timeout)
        return connect(address, timeout=0.5)

    monkeypatch.setattr(distributed.core, "connect", impatient)
    monkeypatch.setattr(distributed, "Client", None)
    with pytest.raises(StudyError, match=f"no scheduler answers at {address}") as caught:
        DaskPool(scheduler=address)
    assert "\n" not in str(caught.value) and limits == [10]


@pytest.mark.parametrize(("text", "complaint"), [
    ("class: nowhere.Cluster\n", "nowhere.Cluster: No module named"),
    ("class: distributed.LocalClutser\n", "no attribute|cannot import"),
    ("clas: x\n", "has no key 'class'"),
    ("class: x.Y\nworker: 3\n", "unknown key 'worker': did you mean 'workers'"),
    ("class: x.Y\nworkers: [3]\n", "workers is .3., must be a number, or .minimum, maximum."),
    ("class: x.Y\nworkers: [3, 1]\n", "workers is .3, 1., must be"),
    ("class: x.Y\nworkers: many\n", "workers is 'many', must be"),
])  # fmt: skip
def test_clusters_that_are_none(tmp_path, text, complaint):
    (tmp_path / "cluster.yaml").write_text(text)
    with pytest.raises(StudyError, match=complaint):
        DaskPool(cluster=str(tmp_path / "cluster.yaml"))


@pytest.mark.parametrize(("workers", "asked"), [
    ("", {}), ("workers: 3\n", {"scale": (3,)}), ("workers: [2, 2]\n", {"scale": (2,)}),
    ("workers: [0, 4]\n", {"adapt": {"minimum": 0, "maximum": 4}}),
])  # fmt: skip
def test_a_named_cluster_is_asked_for_its_workers(tmp_path, monkeypatch, workers, asked):
    class Mine:
        """A user's cluster."""

        def scale(self, *count):
            told.update(scale=count)

        def adapt(self, **keys):
            told.update(adapt=keys)

        def close(self, timeout):
            """Do nothing."""

    cluster, told = Mine(), {}
    monkeypatch.setattr(distributed, "Mine", lambda queue: {"long": cluster}[queue], False)

    def connect(address, **keys):
        assert address is cluster
        raise OSError("not today")

    monkeypatch.setattr(distributed, "Client", connect)
    (tmp_path / "cluster.yaml").write_text(
        f"class: distributed.Mine\narguments: {{queue: long}}\n{workers}")
    with pytest.raises(StudyError, match="not today"):
        DaskPool(cluster=str(tmp_path / "cluster.yaml"))
    assert told == asked


def test_a_named_clusters_workers_are_used_when_they_come(tiny, tmp_path):
    """It begins with none, and more are begun for chunks that wait: two for the first would do."""
    file = tmp_path / "cluster.yaml"
    file.write_text(
        "class: distributed.LocalCluster\nworkers: [1, 2]\n"
        "arguments: {n_workers: 0, threads_per_worker: 1, processes: false,"
        " dashboard_address: null}\n"
    )
    study = tiny(chunk=1, repeats=8)
    made = StudyFolder.create(tmp_path / "out", study, "")
    with DaskPool(cluster=str(file)) as pool:
        assert pool.cluster.scheduler.WORKER_SATURATION == 1.0  # what waits is nobody's yet
        sent = 0
        while pool.has_room:
            pool.submit(work.StudyChunk(json.dumps(study.to_mapping()), sent))
            sent += 1
        assert sent == 4  # two for each that there may be
        for _ in range(sent):
            task, rows = pool.wait_for_chunk()
            made.write_chunk(task.chunk, rows)
        engine.run_missing(made, lambda: contextlib.nullcontext(pool), None)
    assert made.find_missing_chunks() == []


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
    made = StudyFolder.create(tmp_path, study, "")
    with DaskPool(scheduler=other.scheduler_address, chunks_before_restart=2) as pool:
        engine.run_missing(made, lambda: contextlib.nullcontext(pool), None)
        with pytest.raises(ValueError, match="No client"):  # that others would use unasked
            distributed.default_client()
    assert made.find_missing_chunks() == [] and len(other.scheduler.workers) == 1


def test_workers_of_another_version_or_with_threads_are_refused(monkeypatch, other):
    address = other.scheduler_address
    there = {**versions.read_versions(), "numba": "0.1"}
    monkeypatch.setattr(distributed.Client, "run", lambda self, asked: {"tcp://one": there})
    told = "worker at tcp://one has other versions: numba"
    with pytest.raises(StudyError, match=told) as caught:
        DaskPool(scheduler=address)
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    monkeypatch.setattr(distributed.Client, "nthreads", lambda self: {"one": 2})
    with pytest.raises(StudyError, match="several threads each, .*: start them with --nthreads 1"):
        DaskPool(scheduler=address)
