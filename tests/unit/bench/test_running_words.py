"""`bench run` and `resume`, and their workers: execution, output and stored results."""

import json
import os
import re

import pytest
import yaml

from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.studies import tables
from aras_visual_servo_bench.studies.results import Results
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_folder import StudyFolder

STUDY = "experiment: {plant: free}\nrepeats: 3\nvary: {gain: [1.0, 2.0]}\n"


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(STUDY)
    return path


@pytest.mark.parametrize(("words", "why"), [
    (["--workers", "-1"], "--workers must be 0 or more, and --renew 1 or more"),
    (["--renew", "0"], "--renew 1 or more"),
    (["--in-process", "--scheduler", "s"], "use only one of --in-process, --sched"),
    (["--scheduler", "s", "--cluster", "c"], "use only one of"),
    (["--in-process", "--workers", "2"], "--in-process starts no workers"),
    (["--in-process", "--renew", "7"], "leave out --workers and --renew"),
    (["--scheduler", "s", "--workers", "2"], "leave out --workers"),
    (["--cluster", "c", "--workers", "2"], "leave out --workers"),
    (["--scheduler", "nowhere"], "no scheduler answers at nowhere"),
    (["--cluster", "none.yaml", "--renew", "5"], "none.yaml")])  # fmt: skip
def test_workers_are_where_the_options_say(words, why, study, tmp_path, capsys):
    assert main(["run", str(study), "--out", str(tmp_path / "o"), *words]) == 1
    assert why in capsys.readouterr().err


@pytest.mark.parametrize(("more", "cores", "workers"), [
    ([], 6, "6 cores"), ([], None, "1 core"), (["--workers", "3"], 6, "3 cores"),
    (["--in-process"], 6, "1 core")])
def test_a_dry_run_says_what_would_be_done(study, tmp_path, capsys, monkeypatch, more, cores,
                                           workers):  # fmt: skip
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    out = tmp_path / "there"
    assert main(["run", str(study), "duration=0.1", "--dry-run", "--out", str(out), *more]) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith("6 runs: 2 points, 3 of each") and f" on {workers}: a run" in second
    assert not out.exists()


def test_a_study_is_made_of_its_file_or_of_what_the_words_change(study, tmp_path, capsys):
    words = ["--in-process", "--no-report"]
    for name, more, repeats in (("o", ["gain=3.0"], 3), ("p", ["repeats=1", "gain=3.0"], 1)):
        out = tmp_path / name
        assert main(["run", str(study), "duration=0.1", *more, "--out", str(out), *words]) == 0
        made, text = StudyFolder.open(out).study, (out / "study.yaml").read_text()
        assert made.repeats == repeats
        assert Study.from_mapping(yaml.safe_load(text)).digest == made.digest
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


def test_what_is_missing_is_run_and_reported(tiny, capsys):
    assert tiny("--no-report") == 0
    assert (tiny.path / "study.yaml").read_text() == TINY
    said, shown = capsys.readouterr()
    assert re.fullmatch(f"6 of 6 runs in {tiny.path}, 6 new runs without success, .* s\n", said)
    assert "6/6 runs" in shown and not (tiny.path / "table.md").exists()
    for chunk in (1, 4):
        (tiny.path / "parts" / f"{chunk:06d}.parquet").unlink()
    assert tiny() == 0
    said, shown = capsys.readouterr()
    assert said.startswith(f"6 of 6 runs in {tiny.path}, 2 new runs without success, ")
    assert "6/6 runs, " in shown and "2 without success" in shown
    assert f"{tiny.path / 'table.md'} has all metrics" in said


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
    (tiny.path / "parts" / "000005.parquet").unlink()
    manifest = tiny.path / "manifest.json"
    told = json.loads(manifest.read_text())
    told["versions"]["numpy"] = "0.1"
    manifest.write_text(json.dumps(told))
    capsys.readouterr()
    resume = ["resume", str(tiny.path), "--in-process", "--no-report"]
    for start in (lambda *words: tiny("--no-report", *words), lambda *w: main([*resume, *w])):
        assert start() == 1
        assert capsys.readouterr().err.endswith("again in a new folder, or add --mix\n")
        assert start("--mix") == 0


@pytest.mark.parametrize(("changes", "shown"), [
    (["traces=true"], True), (["vary={gain: {uniform: [1.0, 2.0]}}"], True),
    (["metrics=[success]"], False)])  # fmt: skip
def test_a_report_is_a_table_and_pictures(tiny, capsys, changes, shown):
    assert tiny("metrics=[success, final_distance]", *changes) == 0
    said, found = capsys.readouterr().out, [Results.read(tiny.path)]
    table = tables.format_table(tables.make_table(found), "md")
    assert (tiny.path / "table.md").read_text() == table
    assert ("final_distance" in said.partition("table.md has")[0]) is shown
    (drawn,) = re.findall(rf"^{tiny.path}/table.md has all metrics; figures: (.*)$", said, re.M)
    assert ("trajectories.png" in drawn) is ("traces=true" in changes)
    assert {*drawn.split(", ")} == {str(path) for path in (tiny.path / "plots").iterdir()}
    assert said.endswith(f"\nrosrun aras_visual_servo_bench bench browse {tiny.path} shows the "
                         "runs and their reports in a browser\n")  # fmt: skip


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
