"""`bench run`, `resume` and their workers: what is carried out, printed, and kept."""

import argparse
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
import yaml

from aras_visual_servo_bench.cli import analyze, main, run, run_file
from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.plots import study_figures
from aras_visual_servo_bench.studies import replay
from aras_visual_servo_bench.studies.study import Study

STUDY = "experiment: {plant: free}\nrepeats: 3\nvary: {gain: [1.0, 2.0]}\n"


@pytest.fixture
def calls(monkeypatch):
    """What stubs were called with; `stub(place, name, answer)` puts one there."""
    found = []

    def stub(place, name, answer=None):
        def called(*given, **more):
            found.append((name, *given, *more.values()))
            if isinstance(answer, BaseException):
                raise answer
            return answer
        monkeypatch.setattr(place, name, called)

    stub.found = found
    return stub


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(STUDY)
    return path


def options(**changed):
    return argparse.Namespace(**{
        "workers": 0, "renew": 5, "in_process": False, "scheduler": "", "cluster": "", "mix": False,
        "fail_fast": False, "no_report": False, **changed})


def test_workers_are_where_the_options_say(calls):
    calls(run, "DaskPool", "dask")
    assert run.make_pool(options(workers=3, scheduler="tcp", renew=7)) == "dask"
    assert run.make_pool(options(cluster="c.yaml")) == "dask"
    assert calls.found == [("DaskPool", 3, "tcp", "", 7), ("DaskPool", 0, "", "c.yaml", 5)]
    assert isinstance(run.make_pool(options(in_process=True, workers=0, renew=1)),
                      run.InProcessPool)
    for wrong, why in (({"workers": -1}, "--workers must be 0 or more, and --renew 1 or more"),
                       ({"renew": 0}, "--renew 1 or more"),
                       ({"in_process": True, "scheduler": "s"},
                        "use only one of --in-process, --sched"),
                       ({"scheduler": "s", "cluster": "c"}, "use only one of"),
                       ({"in_process": True, "cluster": "c"}, "use only one of")):
        with pytest.raises(StudyError, match=why):
            run.make_pool(options(**wrong))


@pytest.mark.parametrize(("more", "cores", "workers"), [
    ([], 6, 6), ([], None, 1), (["--workers", "3"], 6, 3), (["--in-process"], 6, 1)])
def test_a_dry_run_says_what_would_be_done(calls, study, capsys, monkeypatch, more, cores, workers):
    calls(run.engine, "dry_run", ["6 runs", "an hour"])
    calls(run.images, "check_room", "takes 3 MB")
    calls(run, "count_stored_runs", 2)
    monkeypatch.setattr(run.os, "cpu_count", lambda: cores)
    assert main(["run", str(study), "--dry-run", "--out", "there", *more]) == 0
    kept, room, (_, asked, count) = calls.found
    assert str(kept[1]) == str(room[2]) == "there" and room[3] == 2 and room[1] is asked
    assert (asked.run_count, count) == (6, workers)
    assert capsys.readouterr().out == "takes 3 MB\n6 runs\nan hour\n"
    calls(run.images, "check_room", "")
    assert main(["run", str(study), "--dry-run"]) == 0
    assert capsys.readouterr().out == "6 runs\nan hour\n" and str(calls.found[3][1]) == "."


def test_a_study_is_made_of_its_file_or_of_what_the_words_change(calls, study, tmp_path, capsys,
                                                                  monkeypatch):
    monkeypatch.setattr(run.StudyFolder, "create", lambda *given: given)
    calls(run, "carry_out", 7)
    assert main(["run", str(study), "--out", str(tmp_path / "o")]) == 7
    ((_, (folder, made, text), given),) = calls.found
    assert (folder, text, made.repeats) == (tmp_path / "o", STUDY, 3) and not given.mix
    assert main(["run", str(study), "repeats=5", "--out", str(tmp_path / "o")]) == 7
    (_, (_, made, text), _) = calls.found[1]
    assert made.repeats == 5 and Study.from_mapping(yaml.safe_load(text)).digest == made.digest
    assert list(yaml.safe_load(text)) == list(made.to_mapping())
    assert main(["run", str(study)]) == 1
    assert "give an output folder by --out DIR, or use --dry-run" in capsys.readouterr().err
    assert main(["run", str(tmp_path / "none.yaml"), "--out", "o"]) == 1
    assert main(["run", "paper_basn", "--out", "o"]) == 1
    said = capsys.readouterr().err
    assert "there is no file paper_basn, and no shipped study: did you mean 'paper_basin'?" in said


class Folder:
    """A study's, of six runs, of which some are kept."""

    def __init__(self, kept=2, **study):
        self.kept, self.path, self.told = kept, "the/folder", []
        self.study = SimpleNamespace(**{"run_count": 6, "pictures": "",
                                        "has_image_rows": False, **study})  # fmt: skip

    def check_code(self):
        self.told.append("code")

    def check_file(self):
        self.told.append("file")

    def finish(self):
        self.told.append("finish")

    def count_stored_runs(self):
        return self.kept

    @contextmanager
    def lock(self):
        self.told.append("lock")
        yield
        self.told.append("free")


class Closed:
    """A pool of workers, or a bar of progress."""

    def __init__(self, told, *given):
        self.told, self.given = told, given

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.told.append("ended")

    def close(self):
        self.told.append("closed")


@pytest.fixture
def carried(monkeypatch, calls):
    """Carry a folder out: engine and pool are stubs, and what was done is told."""
    told = []

    def carry_out(folder, answer, **changed):
        told.clear()
        calls.found.clear()
        calls(run.engine, "carry_out", answer)
        monkeypatch.setattr(run, "make_pool", lambda given: Closed(told))
        monkeypatch.setattr(run, "Progress", lambda *given: Closed(told, *given))
        monkeypatch.setattr(run, "format_duration", lambda seconds: f"<{seconds}>")
        calls(run, "_write_report")
        return run.carry_out(folder, options(**changed)), told
    return carry_out


DONE = {"runs": 6, "failed": 1, "seconds": 3.5, "stopped": None}


def test_what_is_missing_is_run_and_reported(carried, calls, capsys):
    folder = Folder()
    status, told = carried(folder, SimpleNamespace(**DONE), fail_fast=True)
    (_, given, workers, progress, fast, mixed), report = calls.found
    assert status == 0 and folder.told == ["code", "lock", "free"] and given is folder
    assert progress.given == (6, 2) and (fast, mixed) == (True, False)
    assert told == ["ended", "closed"] and report == ("_write_report", "the/folder")
    assert capsys.readouterr().out == (
        "6 of 6 runs in the/folder, 1 new runs failed, <3.5>\n")
    folder = Folder(pictures="first")
    carried(folder, SimpleNamespace(**DONE), mix=True, no_report=True)
    assert folder.told == ["lock", "free"] and len(calls.found) == 1 and calls.found[0][5] is True
    assert capsys.readouterr().out == "6 of 6 runs in the/folder, <3.5>\n"


def test_a_run_without_success_stops_it(carried, calls, capsys):
    row = {"run": 4, "outcome": "timed_out", "reason": "late", "verdict": "goal_missed"}
    status, _ = carried(Folder(), SimpleNamespace(**{**DONE, "stopped": row}))
    assert status == 1 and [call[0] for call in calls.found] == ["carry_out"]
    assert capsys.readouterr().out.endswith(
        "stopped at run 4, timed_out: late; bench show the/folder 4\n")
    carried(Folder(), SimpleNamespace(**{**DONE, "stopped": {**row, "reason": ""}}))
    assert "stopped at run 4, timed_out: goal_missed; " in capsys.readouterr().out


def test_a_study_that_is_whole_is_finished(carried, calls, capsys, monkeypatch):
    folder = Folder(kept=6, has_image_rows=True)
    calls(run.card, "write_card", "README.md")
    monkeypatch.setattr(run.card, "write_card", lambda given: f"card of {given.path}")
    status, told = carried(folder, None)
    assert status == 0 and folder.told == ["code", "lock", "finish", "free"] and not told
    assert capsys.readouterr().out == (
        "all 6 runs are in the/folder\n"
        "card of the/folder describes the stored images and how to read them\n")
    assert calls.found == [("_write_report", "the/folder")]


@pytest.mark.parametrize(("fault", "said"), [
    (StudyError("no worker"), "no worker"), (KeyboardInterrupt(), "interrupted")])
def test_what_ends_it_early_says_how_to_go_on(carried, fault, said):
    with pytest.raises(StudyError) as error:
        carried(Folder(), fault)
    assert str(error.value) == (
        f"{said}; 2 of 6 runs are stored; continue with bench resume the/folder")


def test_resuming_checks_the_study_s_file(calls, monkeypatch):
    folder = Folder()
    monkeypatch.setattr(run.StudyFolder, "open", lambda path: folder)
    calls(run, "carry_out", 9)
    assert main(["resume", "x", "--mix", "--fail-fast", "--no-report", "--renew", "3"]) == 9
    given = calls.found[0][2]
    assert folder.told == ["file"] and calls.found[0][1] is folder
    assert (given.mix, given.fail_fast, given.no_report, given.renew) == (True, True, True, 3)


@pytest.mark.parametrize(("rows", "names", "shown"), [
    (40, ("settled", "final_distance", "other"), True), (41, ("settled",), False),
    (3, ("other",), False)])
def test_a_report_is_a_table_and_pictures(calls, tmp_path, capsys, monkeypatch, rows, names, shown):
    results = SimpleNamespace(study=SimpleNamespace(metric_names=names))
    monkeypatch.setattr(run.Results, "read", lambda path: results)
    calls(run.tables, "make_table", SimpleNamespace(rows=[0] * rows))
    calls(run.tables, "format_table", "| a |\n")
    calls(study_figures, "write_figures", ["a.png", "b.png"])
    run._write_report(tmp_path)
    assert (tmp_path / "table.md").read_text() == "| a |\n"
    told = [name for name in names if name != "other"]
    assert [call for call in calls.found if call[0] == "make_table"] == [
        ("make_table", [results]), *([("make_table", [results], told)] if told else [])]
    assert {call[2] for call in calls.found if call[0] == "format_table"} == {"md"}
    assert calls.found[-1] == ("write_figures", [results], tmp_path / "plots", [tmp_path])
    assert capsys.readouterr().out == ("\n| a |\n\n" if shown else "") + (
        f"{tmp_path / 'table.md'} has all metrics; figures: a.png, b.png\n")


@pytest.mark.parametrize(("words", "name", "source", "out"), [
    ([], "demo", "", None), (["--out", "o"], "demo", "", "o"), (["FILE", "--out", "o"], "one", "F",
     "o"), (["FILE", "--out", "o", "--no-report"], "one", "F", None)])
def test_an_experiment_is_run_once(calls, tmp_path, monkeypatch, words, name, source, out):
    path = tmp_path / "one.yaml"
    path.write_text("plant: free\nduration: 1.0\n")
    words = [str(path) if word == "FILE" else word for word in words]
    done, ran = SimpleNamespace(name=""), []
    monkeypatch.setattr(run_file.loop, "run", lambda asked: ran.append(asked) or done)
    calls(replay, "run_with_images", done)
    calls(analyze, "write_reports")
    assert main(["run", *words, "gain=2.5"]) == 0
    assert calls.found[-1] == ("write_reports", [done], None if out is None else run.Path(out))
    asked = ran[0] if out is None else calls.found[0][1]
    assert asked.gain == 2.5 and (asked.plant == "free") is bool(source)
    if out is None:
        assert done.name == name
    else:
        assert calls.found[0][2:4] == (name, str(path) if source else "")


def test_what_belongs_to_studies_is_refused_of_an_experiment(tmp_path, capsys):
    path = tmp_path / "one.yaml"
    path.write_text("plant: free\n")
    for words in (["--workers", "2"], ["--in-process"], ["--scheduler", "s"], ["--cluster", "c"],
                  ["--fail-fast"], ["--mix"], ["--dry-run"]):
        assert main(["run", str(path), *words]) == 1
        assert f"{words[0]} applies to studies, not to an experiment" in capsys.readouterr().err
    path.write_text("repeats: 2\nplant: free\nvary: {}\n")
    assert main(["run", str(path)]) == 1  # of both kinds: an experiment, which has no repeats
    assert "'repeats'" in capsys.readouterr().err
    path.write_text("[1]\n")
    assert main(["run", str(path), "--dry-run"]) == 1
