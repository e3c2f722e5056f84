"""`bench run` and `resume`, and their workers: execution, output and stored results."""

import argparse
import json
import re
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
    """List of the calls of stubs; `stub(place, name, answer)` installs a stub."""
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
        "workers": 0, "renew": None, "in_process": False, "scheduler": "", "cluster": "",
        "mix": False, "fail_fast": False, "no_report": False, **changed})  # fmt: skip


def test_workers_are_where_the_options_say(calls):
    calls(run, "DaskPool", "dask")
    assert run.make_pool(options(workers=3)) == "dask"
    assert run.make_pool(options(scheduler="tcp", renew=7)) == "dask"
    assert run.make_pool(options(cluster="c.yaml", renew=5)) == "dask"
    assert calls.found == [("DaskPool", 3, "", "", 500), ("DaskPool", 0, "tcp", "", 7),
                           ("DaskPool", 0, "", "c.yaml", 5)]  # fmt: skip
    assert isinstance(run.make_pool(options(in_process=True)), run.InProcessPool)
    for wrong, why in (({"workers": -1}, "--workers must be 0 or more, and --renew 1 or more"),
                       ({"renew": 0}, "--renew 1 or more"),
                       ({"in_process": True, "scheduler": "s"},
                        "use only one of --in-process, --sched"),
                       ({"scheduler": "s", "cluster": "c"}, "use only one of"),
                       ({"in_process": True, "cluster": "c"}, "use only one of"),
                       ({"in_process": True, "workers": 2}, "--in-process starts no workers"),
                       ({"in_process": True, "renew": 7}, "leave out --workers and --renew"),
                       ({"scheduler": "s", "workers": 2}, "leave out --workers"),
                       ({"cluster": "c", "workers": 2}, "leave out --workers")):
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
    assert "there is no file paper_basn, and no shipped study of this name: did you mean '" in said


TINY = """experiment: {plant: free, duration: 0.1, lag: 0.0}
vary: {gain: [1.0, 2.0]}
repeats: 3
chunk: 1
metrics: [success]
"""


@pytest.fixture
def tiny(tmp_path):
    """Run a study of six short runs without success; further words are options."""
    path, out = tmp_path / "tiny.yaml", tmp_path / "tiny"
    path.write_text(TINY)

    def carry_out(*words):
        return main(["run", str(path), "--out", str(out), "--in-process", *words])

    carry_out.path = out
    return carry_out


def forget(folder, *chunks):
    for chunk in chunks:
        (folder / "parts" / f"{chunk:06d}.parquet").unlink()


def test_what_is_missing_is_run_and_reported(tiny, capsys):
    assert tiny("--no-report") == 0
    said, shown = capsys.readouterr()
    assert re.fullmatch(f"6 of 6 runs in {tiny.path}, 6 new runs without success, .* s\n", said)
    assert "6/6 runs" in shown and not (tiny.path / "table.md").exists()
    forget(tiny.path, 1, 4)
    assert tiny() == 0
    said, shown = capsys.readouterr()
    assert said.startswith(f"6 of 6 runs in {tiny.path}, 2 new runs without success, ")
    assert "6/6 runs, " in shown and "2 without success" in shown
    assert f"{tiny.path / 'table.md'} has all metrics" in said


def test_a_study_of_first_pictures_reports_no_failures(tiny, capsys):
    assert tiny("--no-report", "pictures=first", "features=images", "repeats=1") == 0
    said = capsys.readouterr().out
    assert said.startswith(f"2 of 2 runs in {tiny.path}, ") and "failed" not in said
    assert "README.md describes the stored images and how to read them" in said


def test_a_run_without_success_stops_it(tiny, capsys):
    assert tiny("--fail-fast") == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith(
        "stopped after run 0, which ended with timed_out (not at the goal after 0.1 s); ")
    assert last.endswith(f"; repeat it with rosrun aras_visual_servo_bench bench show {tiny.path} "
                         "0")


def test_a_study_that_is_whole_is_finished(tiny, capsys):
    tiny("--no-report")
    whole = (tiny.path / "manifest.json").read_text()
    capsys.readouterr()
    assert tiny("--no-report") == 0
    said, shown = capsys.readouterr()
    assert said == f"all 6 runs are in {tiny.path}\n" and not shown
    assert (tiny.path / "manifest.json").read_text() == whole


INTERRUPTS = """
from aras_visual_servo_bench import metric
count = 0

@metric(unit="", better="", source="this test")
def third(run) -> float:
    \"\"\"Interrupt the third run.\"\"\"
    global count
    count += 1
    if count == 3:
        raise KeyboardInterrupt
    return 1.0
"""


def test_what_ends_it_early_says_how_to_go_on(tiny, tmp_path, monkeypatch, capsys):
    (tmp_path / "interrupts.py").write_text(INTERRUPTS)
    monkeypatch.syspath_prepend(tmp_path)
    assert tiny("metrics=[success, 'interrupts:third']") == 1
    command = f"rosrun aras_visual_servo_bench bench resume {tiny.path}"
    more = f"2 of 6 runs are stored; continue with {command}"
    assert capsys.readouterr().err.splitlines()[-1] == f"bench: interrupted; {more}"
    assert main(["resume", str(tiny.path), "--workers", "-1"]) == 1
    assert capsys.readouterr().err.splitlines()[-1].endswith(f"--renew 1 or more; {more}")
    assert main(["resume", str(tiny.path), "--in-process", "--no-report"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"6 of 6 runs in {tiny.path}, 4 new runs without success")


def test_other_code_is_refused_or_mixed(tiny, capsys):
    tiny("--no-report")
    forget(tiny.path, 5)
    manifest = tiny.path / "manifest.json"
    told = json.loads(manifest.read_text())
    told["versions"]["numpy"] = "0.1"
    manifest.write_text(json.dumps(told))
    capsys.readouterr()
    for start in (lambda *words: tiny("--no-report", *words), lambda *words: main(
            ["resume", str(tiny.path), "--in-process", "--no-report", *words])):  # fmt: skip
        assert start() == 1
        assert capsys.readouterr().err.endswith("run the study again in a new folder, or add "
                                                "--mix\n")  # fmt: skip
        assert start("--mix") == 0


def test_resuming_checks_the_study_s_file(tiny, capsys):
    tiny("--no-report")
    (tiny.path / "study.yaml").write_text(TINY.replace("repeats: 3", "repeats: 4"))
    assert main(["resume", str(tiny.path), "--in-process"]) == 1
    assert "has another study: repeats was 3, is 4" in capsys.readouterr().err


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
        f"{tmp_path / 'table.md'} has all metrics; figures: a.png, b.png\n"
        f"rosrun aras_visual_servo_bench bench browse {tmp_path} shows the runs and their reports "
        "in a browser\n")


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
                  ["--renew", "3"], ["--fail-fast"], ["--mix"], ["--dry-run"]):
        assert main(["run", str(path), *words]) == 1
        assert f"{words[0]} applies to studies, not to an experiment" in capsys.readouterr().err
    path.write_text("repeats: 2\nplant: free\nvary: {}\n")
    assert main(["run", str(path)]) == 1  # of both kinds: an experiment, which has no repeats
    assert "'repeats'" in capsys.readouterr().err
    path.write_text("[1]\n")
    assert main(["run", str(path), "--dry-run"]) == 1
