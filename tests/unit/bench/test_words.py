"""Commands on stored studies: every option of the command line changes what is written."""

import os
import re
from dataclasses import replace

import pyarrow.csv
import pytest
import yaml
from matplotlib.figure import Figure

from aras_visual_servo_bench import load_run, run_study
from aras_visual_servo_bench.cli import analyze, main
from aras_visual_servo_bench.errors import BenchError
from aras_visual_servo_bench.studies import tables
from aras_visual_servo_bench.studies.results import Results
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_folder import StudyFolder

STUDY = """experiment: {plant: free, duration: 0.1}
repeats: 2
seed: 10
vary: {gain: [1.0, 2.0]}
metrics: [success, final_distance]
cases:
  scheme: [{name: a, set: {scheme: points}}, {name: b, set: {scheme: numbered_points}}]
  start: [{name: near, set: {lag: 0.1}}, {name: far, set: {lag: 0.2}}]
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "mine.yaml"
    path.write_text(STUDY)
    return path


@pytest.fixture(scope="module")
def folders(study, tmp_path_factory):
    places = [tmp_path_factory.mktemp("runs") / name for name in "xy"]
    first, longer = Study.from_yaml(study), Study.from_yaml(study, {"duration": 0.2})
    run_study(first, places[0])
    run_study(replace(longer, vary={"gain": [1.0, 3.0]}), places[1])
    return [str(place) for place in places]


def test_a_table_has_the_selected_rows_columns_and_format(folders, tmp_path, capsys):
    made = tables.make_table(
        [Results.read(one) for one in folders], ["gain", "start"], ["final_distance"])
    words = ["table", *folders, "--by", "gain, start,", "--metrics", "final_distance"]
    for kind in ("md", "csv", "tex"):
        assert main([*words, "--format", kind]) == 0
        assert capsys.readouterr().out.startswith(tables.format_table(made, kind))
        assert main([*words, "--format", kind, "--out", str(tmp_path / f"t.{kind}")]) == 0
        assert not capsys.readouterr().out
        assert (tmp_path / f"t.{kind}").read_text().startswith(tables.format_table(made, kind))
    assert main([*words, "--out", str(tmp_path)]) == 1
    for more, why in ((["--format", "pdf"], "pdf"), (["--metrics", "setled"], "metric 'setled'"),
                      (["--by", "gian"], "no column 'gian': did you mean 'gain'")):  # fmt: skip
        assert main([*words, *more]) == 1 and why in capsys.readouterr().err


def test_figures_have_the_selected_place_and_formats(folders, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(Figure, "savefig", lambda _, path: path.touch())
    words = ["plot", folders[1], "--metrics", "final_distance"]
    for more, place, kinds in (
        (["--format", "svg, pdf", "--out", str(tmp_path)], str(tmp_path), {"svg", "pdf"}),
        (["--paper"], f"{folders[1]}/plots", {"pdf"}), ([], f"{folders[1]}/plots", {"png"}),
    ):  # fmt: skip
        assert main([*words, *more]) == 0
        written = capsys.readouterr().out.split()
        assert all(map(os.path.isfile, written))
        assert {os.path.dirname(one) for one in written} == {place}
        captions = "tex" if "--paper" in more else "md"
        assert {one.rpartition(".")[2] for one in written} == {*kinds, captions}


@pytest.mark.parametrize(("more", "by", "names", "everything"), [
    (["--by", "start", "--metrics", "final_distance"], ["start"], ["final_distance"], False),
    (["--all"], [], [], True)])  # fmt: skip
def test_differences_are_of_the_second_folder_from_the_first(
        more, by, names, everything, folders, capsys):
    first, second = map(Results.read, folders)
    assert main(["diff", *folders, *more]) == 0
    told = first.compare(second, by, names).describe(everything)
    assert capsys.readouterr().out.startswith(told)


def test_a_protocol_is_carried_out_in_part(study, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["protocol", str(study), "--out", str(out), "--in-process"]
    chosen = ["--seeds", "1", "--first", "5", "--case", "b", "--start", "far", "--start", "near"]
    assert main([*words, *chosen]) == 0
    assert capsys.readouterr().out.endswith(f"wrote {out / 'table.csv'}: 4 runs\n")
    made, whole = StudyFolder.open(out).study, Study.from_yaml(study)
    assert (made.repeats, made.seed, made.vary) == (1, 5, whole.vary)
    assert [case.name for case in made.case_axes["start"]] == ["near", "far"]
    rows = pyarrow.csv.read_csv(out / "table.csv").to_pylist()
    assert {(row["scheme"], row["start"], row["gain"]) for row in rows} == {
        ("b", start, gain) for start in ("near", "far") for gain in (1.0, 2.0)}
    assert Study.from_mapping(yaml.safe_load((out / "study.yaml").read_text())).digest == \
        made.digest  # fmt: skip
    assert not (out / "table.md").exists()
    assert main([*words, "--condition", "rain"]) == 1
    assert "condition 'rain'" in capsys.readouterr().err
    # without options it is the whole study
    assert main(["protocol", str(study), "--out", str(tmp_path / "all"), "--in-process"]) == 0
    assert StudyFolder.open(tmp_path / "all").study.digest == whole.digest


def test_settings_are_searched_for_as_the_words_say(study, tmp_path, capsys):
    file = tmp_path / "plain.yaml"
    file.write_text("{experiment: {plant: free, duration: 0.1}, vary: {gain: [1.0], delay: [0.0]}}")
    out = tmp_path / "o"
    words = ["tune", str(file), "repeats=2", "--over", "gain=0.5:4", "--out", str(out),
             "--in-process", "--metric", "final_distance", "--evaluations", "16"]  # fmt: skip
    assert main([*words, "--success", "0"]) == 0
    told = capsys.readouterr().out
    assert re.fullmatch(r"gain=[\d.]+: final_distance [\d.]+, success 0%, image excursion [\d.]+; "
                        rf"best of 16 candidates \({out}/best.yaml\)\n", told)  # fmt: skip
    first = StudyFolder.open(out / "generation-000")
    assert first.study.repeats == 2 and list(first.study.vary) == ["delay"]
    assert first.count_stored_runs() == first.study.run_count
    assert list(yaml.safe_load((first.path / "study.yaml").read_text())) == list(
        first.study.to_mapping())
    words[words.index(str(out))] = str(tmp_path / "again")
    assert main(words) == 1  # all runs must succeed, and none lasts long enough
    assert "no candidate keeps the target in the image" in capsys.readouterr().err


def test_the_report_names_the_runs_and_their_notes(tmp_path, capsys):
    paths = [tmp_path / "one.yaml", tmp_path / "two.yml"]
    for path in paths:
        path.write_text("plant: free\ngain: 2.5\nduration: 0.1\n")
    words = ["analyze", *map(str, paths), "--formats", "", "--out", str(tmp_path / "out")]
    for more, names in (([], ["one", "two"]), (["--names", "a, b"], ["a", "b"]),
                        (["--names", "c,c"], ["c (1)", "c (2)"])):  # fmt: skip
        assert main([*words, *more]) == 0
        told = capsys.readouterr().out
        assert [line[:-1] for line in told.splitlines() if re.fullmatch(r"\S.*:", line)] == names
        assert f"files; the page is {tmp_path / 'out' / 'report.html'}" in told
    run = load_run(paths[0])
    assert (run.name, run.source, run.experiment.gain) == ("one", str(paths[0]), 2.5)
    analyze.write_reports([replace(run, notes=["late", "dark"])], None)
    assert capsys.readouterr().out.endswith("\n  Note: late\n  Note: dark\n")
    for text, why in (("gain: -1\n", f"{paths[0]}: gain is -1.0"), ("gain: [\n", "")):
        paths[0].write_text(text)
        with pytest.raises(BenchError) as error:
            load_run(paths[0])
        assert str(error.value).startswith(why) and str(error.value).count("one.yaml") == 1


def test_a_bag_is_found_however_it_was_left(tmp_path):
    """Files without messages: the error names the file that was read."""
    whole, cut, none = (tmp_path / name for name in ("whole", "cut", "none"))
    for folder, names in ((whole, ("run.bag", "run.bag.active")), (cut, ("run.bag.active",)),
                          (none, ("other.bag",))):  # fmt: skip
        folder.mkdir()
        for name in names:
            (folder / name).write_text("")
    for given, read in ((whole, whole / "run.bag"), (cut, cut / "run.bag.active"),
                        (none / "other.bag", none / "other.bag"),
                        (cut / "run.bag", cut / "run.bag.active")):  # fmt: skip
        with pytest.raises(BenchError, match=f"{re.escape(str(read))}(?!.active)"):
            load_run(str(given))
    for given, why in ((none, f"{none} has no run.bag; for a run of a study give {none}:NUMBER"),
                       (tmp_path / "c.bag", f"there is no file {tmp_path / 'c.bag'}")):
        with pytest.raises(BenchError, match=re.escape(why)):
            load_run(str(given))


@pytest.mark.parametrize(("words", "told"), [
    (["convert", "{}/none.bag"], "there is no file {}/none.bag"),
    (["show", "{}/a.bag", "3"], "{}/a.bag is a bag and contains only one run"),
    (["show", "{}"], "give the number of a run: rosrun aras_visual_servo_bench bench show {} 0"),
    (["browse", "{}", "--port", "0"], "--port is 0, must be 1 to 65535"),
    (["browse", "{}", "--port", "65536"], "--port is 65536, must be 1 to 65535")])  # fmt: skip
def test_a_wrong_argument_is_one_line(words, told, tmp_path, capsys):
    (tmp_path / "a.bag").write_text("")
    assert main([word.format(tmp_path) for word in words]) == 1
    assert told.format(tmp_path) in capsys.readouterr().err.splitlines()[-1]
