"""Workers of Dask, once for real: the same bytes, a death survived, and who is refused."""

from __future__ import annotations

import io
import os
import signal

import pytest

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.study import engine, pools
from aras_visual_servo_bench.study.folder import Folder
from aras_visual_servo_bench.study.pools import DaskPool, ThisProcess
from aras_visual_servo_bench.study.progress import Progress
from aras_visual_servo_bench.study.work import ONE_THREAD


def parts(path):
    return {p.name: p.read_bytes() for p in (path / "parts").glob("*")}


class Killing(Progress):
    """Kills a worker when the first chunk is there."""

    def more(self, runs, failed):
        super().more(runs, failed)
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
        progress = Killing(study.runs, out=io.StringIO())
        progress.victims = [next(iter(before.values()))]
        done = engine.carry_out(Folder.create(there, study, ""), pool, progress)
        assert not set(before.values()) & set(pool._client.run(os.getpid).values())
    assert done.runs == study.runs
    assert parts(here) == parts(there)


def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch):
    monkeypatch.setattr(pools, "ANSWER", 0.5)
    with pytest.raises(StudyError, match="no scheduler answers at tcp://127.0.0.1:9") as caught:
        DaskPool(scheduler="tcp://127.0.0.1:9")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("text", "complaint"), [
    ("class: nowhere.Cluster\n", "nowhere.Cluster: No module named"),
    ("class: distributed.LocalClutser\n", "no attribute|cannot import"),
    ("clas: x\n", "names no cluster"),
    ("class: x.Y\nworker: 3\n", "unknown key 'worker': did you mean 'workers'"),
])  # fmt: skip
def test_clusters_that_are_none(tmp_path, text, complaint):
    (tmp_path / "cluster.yaml").write_text(text)
    with pytest.raises(StudyError, match=complaint):
        DaskPool(cluster=str(tmp_path / "cluster.yaml"))
