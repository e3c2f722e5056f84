"""Tables, figures, comparisons, tuning and repetition of known results."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import cv2
import numpy as np
import pyarrow as pa
import pytest
from made_studies import write_study
from matplotlib.figure import Figure

from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.experiment.experiment_keys import find_unit
from aras_visual_servo_bench.metrics import formatting
from aras_visual_servo_bench.metrics.metric import metric
from aras_visual_servo_bench.recording.film import with_images
from aras_visual_servo_bench.runner import loop
from aras_visual_servo_bench.studies import columns, compare, replay, tables
from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.studies import study_execution as engine
from aras_visual_servo_bench.studies.pools import InProcessPool
from aras_visual_servo_bench.studies.results import Results
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_execution import run_missing
from aras_visual_servo_bench.studies.study_folder import StudyFolder
from aras_visual_servo_bench.studies.tuner import SearchRange, Tuner
from aras_visual_servo_bench.web.report.video import write_video, write_with_video


def made(success, settled, name="one", seeds=None, gains=(1.0, 2.0), **case):
    """Results without runs: as many per gain as there are values, all in one case."""
    study = Study.from_mapping({
        "experiment": {"plant": "free"}, "cases": [case], "vary": {"gain": list(gains)},
        "repeats": len(success) // len(gains), "metrics": ["success", "settled"],
    })  # fmt: skip
    each = len(success) // len(gains)
    table = pa.table({
        "run": list(range(len(success))), "seed": list(seeds or range(len(success))),
        "gain": [g for g in gains for _ in range(each)], "success": list(map(float, success)),
        "settled": list(map(float, settled)), "outcome": ["x"] * len(success),
        "verdict": [""] * len(success), "reason": [""] * len(success),
        "real_time_multiple": [10.0] * len(success),
        **{key: [value] * len(success) for key, value in case.items()},
    })  # fmt: skip
    return Results(name, study, table)


def test_a_column_is_written_in_one_notation():
    """A table had '0.00141 [9.80e-04, 0.00169]', and 2.50e-05 below 0.00125."""
    one = made([1] * 4, [0.00098, 0.00169, 2.5e-5, 0.00125])
    told = tables.format_table(tables.make_table([one], metrics=["settled"]), "md")
    assert "| settled (ms) |" in told
    assert "| 1.33 [0.98, 1.69] |" in told
    assert "| 0.638 [0.025, 1.25] |" in told
    assert "| 1 [0.342, 1] |" in told  # each column has its own
    tiny = made([1] * 4, [9.8e-14, 1.69e-13, 0.0, 1.25e-13])
    tex = tables.format_table(tables.make_table([tiny], metrics=["settled"]), "tex")
    assert r"$9.80 \cdot 10^{-8}$" not in tex and r"[9.80 \cdot 10^{-8}, 1.69" in tex


@pytest.mark.parametrize(("value", "shown"), [
    (0.0, "0"), (-0.0, "0"), (0.5, "0.5"), (2.0, "2"), (0.015, "0.015"), (123.4, "123"),
    (1234.4, "1234"), (12345.6, "12346"), (99999.9, "100000"), (123456.0, "1.23e+05"),
    (0.00123, "0.00123"), (0.000999, "9.99e-04"), (-0.0021, "-0.0021"), (np.nan, "–"),
    (np.inf, "∞"), (-np.inf, "-∞"), (0.001, "0.001"), (100000.0, "1.00e+05"),
])  # fmt: skip
def test_numbers_have_three_digits_and_no_more_zeros_than_they_need(value, shown):
    assert formatting.format_number(value) == shown


def test_numbers_beside_each_other_are_all_plain_or_all_raised():
    plain = formatting.make_number_format([0.002, 3e-5, 1e-12, np.nan, np.inf])
    assert [plain(v) for v in (0.002, 3e-5, -1e-12, 0.0)] == ["0.002", "0.00003", "≈0", "0"]
    assert formatting.make_number_format([2.7e-11, 0.28])(2.7e-11) == "≈0"  # it is not 0
    for value, shown in ((4e-8, "≈0"), (6e-8, "6.00e-08"), (1e-5, "0.00001"), (9e-6, "9.00e-06")):
        assert formatting.make_number_format([value, 0.28])(value) == shown
    assert formatting.make_number_format([np.nan])(1e-7) == "0.0000001"
    # nothing that it could be next to
    assert formatting.make_number_format([0.0, np.nan])(0.25) == "0.25"
    raised = formatting.make_number_format([0.0253, 6.33e-7])  # 0.000000633 cannot be read
    assert [raised(v) for v in (0.0253, 6.33e-7)] == ["2.53e-02", "6.33e-07"]
    raised = formatting.make_number_format([2e5, -1.0], 4)
    assert [raised(v) for v in (2e5, -1.0)] == ["2.000e+05", "-1.000e+00"]


def test_a_table_says_why_runs_failed():
    """More of it: test_recomputed.py."""
    results = made([0] * 4, [1.0] * 4)
    found = {}
    for reason in ("", "a b" * 30, "ca | b " * 15):
        table = results.table
        for name, value in (("outcome", "converged"), ("verdict", "goal_missed"),
                            ("reason", reason)):  # fmt: skip
            table = table.drop_columns([name]).append_column(name, pa.array([value] * 4))
        found[reason] = tables.make_table([Results("one", results.study, table)])
    head = "2 of 2 converged, goal_missed"
    long = f"{head}: {('ca | b ' * 15)[:88]} …"
    assert [one.failures for one in found.values()] == [
        (head,) * 2, (f"{head}: {'a b' * 30}",) * 2, (long,) * 2]
    for style, told in (("md", r"ca \| b ca"), ("csv", "ca | b ca")):
        assert told in tables.format_table(found["ca | b " * 15], style)
    assert "ca" not in tables.format_table(found["ca | b " * 15], "tex").partition("midrule")[2]
    several = tables.make_table([results, made([0, 0], [1, 1], "two")])
    assert several.keys[0] == "study" and several.rows[3][0] == ("two", 2.0)


def test_a_setting_has_the_unit_that_its_class_says():
    units = {
        "delay": "s", "gain": "1/s", "start.side": "m", "target.motion.frequency": "Hz",
        "controller_parameters.max_velocity": "m/s or rad/s", "calibration_offset.focal": "",
        "law": "", "no_such_key": "", "controller_parameters.none": "",
        "start.turn": "",  # rad of a drawn start, degrees of a relative one
    }  # fmt: skip
    assert {key: find_unit(key) for key in units} == units


def test_differences_that_are_more_than_chance_are_told_with_their_direction():
    """Their numbers: test_recomputed.py."""
    times = np.random.default_rng(1).uniform(1.0, 2.0, 40)
    one, faster = made([1] * 40, times), [*(times[:20] * 0.9), *(times[20:] * 1.1)]
    whole = one.compare(made([1] * 40, faster, "two"))
    sure = sorted((d for d in whole.differences if d.verdict != compare.CHANCE), key=lambda d: d.p)
    for is_all, shown in ((False, sure), (True, whole.differences)):
        *lines, last = whole.describe(is_all).splitlines()
        assert [line.split()[:2] for line in lines] == [[d.verdict, d.metric] for d in shown]
        assert last.startswith("2 of 4 differences")
    prompt, late = made([1] * 40, times, delay=0.0), made([1] * 40, faster, "two", delay=0.1)
    assert all(d.comparison.paired and d.comparison.count == 20
               for d in prompt.compare(late, by=["gain"]).differences)
    ten = {"success": [1] * 10, "settled": range(10), "gains": [1.0]}
    two = {"success": [1, 1], "settled": [1, 2]}
    for given, one_s, two_s, pairs in (
        (ten, range(10), range(1, 11), 9), (ten, range(10), range(2, 12), 0),
        (two, [7] * 2, [7] * 2, 1), (two, [7] * 2, [8] * 2, 0),
    ):  # fmt: skip
        found = made(**given, seeds=one_s).compare(made(**given, name="two", seeds=two_s))
        assert {(d.comparison.paired, d.comparison.count) for d in found.differences} == {
            (pairs > 0, pairs or (10 if given is ten else 1))}
    with pytest.raises(StudyError, match="no settings .* in common"):
        one.compare(made([1, 1], [1, 1], gains=(7.0, 8.0)))


def in_process(study, path):
    folder = StudyFolder.create(path, study, "")
    run_missing(folder, InProcessPool, None)


def test_the_tuner_finds_the_gain_and_goes_on_where_it_was(tiny, tmp_path):
    """After a tenth of a second the nearest camera is the one with the highest gain."""
    study = tiny(vary={}, repeats=1, chunk=100)
    folders = []

    def carry(generation, path):
        folders.append(path)
        in_process(generation, path)

    ranges = [SearchRange.parse("gain=0.5:4")]
    tuner = Tuner(study, ranges, "final_distance", tmp_path, carry, min_success=0.0)
    best = tuner.search(24)
    assert [path.name for path in folders] == [f"generation-{k:03d}" for k in range(len(folders))]
    assert all(0.5 <= one.values[0] <= 4.0 for one in tuner.candidates)
    assert 16 < len(tuner.candidates) <= 24
    assert best.values[0] > 3.5 and best.violation == 0.0
    assert len(folders) <= 4  # the first and two generations, and what their last steps ask again
    assert best.cost == min(c.cost for c in tuner.candidates)
    lines = (tuner.write().parent / "candidates.csv").read_text().splitlines()
    assert lines[0].startswith("gain,final_distance") and len(lines) == len(tuner.candidates) + 1
    stamps = [path.stat().st_mtime_ns for path in tmp_path.glob("*/parts/*")]
    again = Tuner(study, ranges, "final_distance", tmp_path, carry, min_success=0.0)
    assert again.search(24) == best
    assert stamps == [path.stat().st_mtime_ns for path in tmp_path.glob("*/parts/*")]
    assert len(set(folders)) == len(folders) / 2


def answering(measure):
    """Function that stores a study whose runs have the results `measure(gain, repeat)`."""
    def make(study, run):
        row = rows.make_blank_row(study, run)
        return {"outcome": "x", **measure(row["gain"], row["repeat"])}

    return lambda study, path: write_study(path, study, make)


def test_a_search_ends_where_the_image_does(tmp_path):
    """Greater gains are better here, and those above 2 leave the image."""
    study = Study.from_mapping({"experiment": {"plant": "free"}, "seed": 1})
    tuner = Tuner(study, [SearchRange("gain", 0.5, 4.0)], "settled", tmp_path, answering(
        lambda gain, _: {"success": 1.0, "settled": 10.0 - gain, "image_excursion": gain / 2.0}
    ))  # fmt: skip
    assert 1.95 < tuner.search(48).values[0] <= 2.0
    assert any(one.values[0] > 2.0 for one in tuner.candidates)


@pytest.mark.parametrize(("text", "part", "value"), [
    ("gain=0.5:8", 0.0, 0.5), ("gain=0.5:8", 0.5, 2.0), ("gain=0.5:8", 1.0, 8.0),
    ("gain=1:10", 0.5, 3.16228), ("gain=1:9", 0.5, 5.0), ("delay=0:0.1", 0.25, 0.025),
    ("gain=1.23456111:2", 0.0, 1.23456111), ("gain=1:1.23456789", 1.0, 1.23456789),
])  # fmt: skip
def test_a_range_of_ten_times_or_more_is_searched_by_factors_in_six_digits(text, part, value):
    assert SearchRange.parse(text).interpolate(part) == value


@pytest.mark.parametrize(("words", "complaint"), [
    (["gain"], "is not a range"),
    (["gain=2:1"], "low < high"), (["gain=2:inf"], "finite"), (["gain=-inf:2"], "finite"),
    (["gian=1:2"], "did you mean gain"), ([], "there is no key to search"),
    (["gain=1:2", "gain=1:3"], "varied twice"), (["delay=0:1"], "varied twice"),
])  # fmt: skip
def test_searches_that_are_none(tiny, words, complaint):
    study = tiny(vary={"delay": [0.0]})
    with pytest.raises(StudyError, match=complaint):
        Tuner(study, list(map(SearchRange.parse, words)), "settled", None, None)


def test_a_search_of_too_few_candidates_or_over_cases_is_none(tiny):
    for told, evaluations, needed, cases in (
        ("15 evaluations are too few: give at least 16", 15, 1.0, ()),
        ("a study with cases cannot be tuned", 24, 1.0, [{"delay": 0.0}, {"delay": 0.1}]),
        ("success rate is -0.1, must be from 0 to 1", 24, -0.1, ()),
        ("success rate is 1.1, must be from 0 to 1", 24, 1.1, ()),
    ):
        with pytest.raises(StudyError, match=told):
            study, ranges = tiny(vary={}, cases=cases), [SearchRange("gain", 0.5, 4.0)]
            Tuner(study, ranges, "settled", None, None, needed).search(evaluations)


def test_a_run_is_shown_again_as_it_was(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(Figure, "savefig", lambda _, path, **how: path.touch())
    study = tiny()
    in_process(study, tmp_path / "out")
    run, changed = replay.replay(StudyFolder.open(tmp_path / "out"), 3)
    assert replay.replay(StudyFolder.create(tmp_path / "none", study, ""), 0)[1] == {}
    assert (run.name, run.source) == ("run 3", f"run 3 of the study {tmp_path / 'out'}")
    row = rows.make_result_columns(study, run)
    assert changed == {} and run.experiment.gain == 2.0
    pictures = [picture for _, picture in run.control_record.images]
    assert len(pictures) == row["images"]
    assert pictures[0].shape[2] == 3 and pictures[0].min() < 128  # the target is there
    names = {path.name for path in write_with_video(run, tmp_path / "show")}
    assert {"report.html", "summary.json", "video.mp4", "feature_errors.png"} <= names
    told = json.loads((tmp_path / "show" / "summary.json").read_text())
    assert study.metric_names
    for name in study.metric_names:
        assert told[name] == row[columns.find_column_name(name)], name
    video = cv2.VideoCapture(str(tmp_path / "show" / "video.mp4"))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == len(pictures)
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(30.0, abs=0.01)
    with pytest.raises(StudyError, match="no run 6: .* has runs 0 to 5"):
        replay.replay(StudyFolder.open(tmp_path / "out"), 6)
    with pytest.raises(StudyError, match="cannot write the video .*nowhere/video.mp4"):
        write_video(run, tmp_path / "nowhere" / "video.mp4")


def test_a_video_has_the_colours_and_the_rate_of_its_pictures(tmp_path):
    finished = loop.run(Experiment(plant="free", duration=0.1))
    red = np.zeros((32, 48, 3), np.uint8)
    red[..., 0] = 220
    for stamp, rate in (([0.0], 30.0), ([0.0, 0.1], 10.0)):
        states = tuple(replace(state, stamp=at)
                       for state, at in zip(finished.states, stamp, strict=False))  # fmt: skip
        made = with_images(replace(finished, states=states), [(at, red) for at in stamp])
        video = cv2.VideoCapture(str(write_video(made, tmp_path / "video.mp4")))
        assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(rate)
        blue, green, red_there = video.read()[1].mean(axis=(0, 1))
        assert red_there > 180.0 and max(blue, green) < 40.0


@metric("", "smaller", "these tests")
def failing(finished):
    """Metric that is always NaN."""
    raise ZeroDivisionError("of mine")


def test_a_run_that_was_a_fault_is_shown_as_a_line_and_where_it_was_raised(tmp_path, capsys):
    file, out = tmp_path / "study.yaml", tmp_path / "out"
    base = "experiment: {plant: free, duration: 0.1}\n"
    file.write_text(f"{base}metrics: ['{__name__}:failing']\n")
    assert main(["run", str(file), "--dry-run"]) == 0
    assert "run 0 as tried: fault: ZeroDivisionError: of mine" in capsys.readouterr().out
    words = ["run", str(file), "--out", str(out), "--in-process", "--fail-fast"]
    assert main(words) == 1
    told = capsys.readouterr().out
    command = f"rosrun aras_visual_servo_bench bench show {out} 0"
    assert ("stopped after run 0, which ended with fault (ZeroDivisionError: of mine); repeat it "
            f"with {command}") in told
    assert main(["show", str(out), "0"]) == 1
    told = capsys.readouterr().err
    assert "run 0: ZeroDivisionError: of mine; traceback" in told
    assert told.count("\n") == 1
    assert "in failing" in (out / "show-0" / "traceback.txt").read_text()


def test_runs_of_a_study_are_analyzed_beside_each_other(tiny, tmp_path, capsys):
    study, out = tiny(), tmp_path / "out"
    in_process(study, out)
    words = ["analyze", f"{out}:0", f"{out}:3", "--out", str(tmp_path / "both"), "--formats", ""]
    assert main(words) == 0
    told = json.loads((tmp_path / "both" / "summary.json").read_text())
    assert [one["name"] for one in told] == ["out:0", "out:3"]
    kept = {row["run"]: row for row in StudyFolder.open(out).read_results().to_pylist()}
    for one, run in zip(told, (0, 3), strict=True):
        for name in study.metric_names:
            assert one[name] == kept[run][columns.find_column_name(name)], name
    capsys.readouterr()
    assert main(["analyze", f"{out}:6", "--out", str(tmp_path / "none")]) == 1
    assert "there is no run 6" in capsys.readouterr().err


@pytest.mark.parametrize("metric", ["settled", "decay_rate"])
def test_candidates_cost_what_their_runs_show(tmp_path, metric):
    """Two runs of each: of some the second once left the image, and once failed; of others nothing
    was ever measured."""
    def measure(gain, repeat):
        if gain < 1.5:
            found = (1.0, (3.0, 4.0)[repeat], (0.4, 0.9)[repeat])
        elif gain < 2.5:
            found = ((0.0, 1.0)[repeat], (5.0, 8.0)[repeat], (1.3, 0.2)[repeat])
        else:
            found = (0.0, np.nan, (0.1, np.nan)[repeat])
        return dict(zip(("success", metric, "image_excursion"), found, strict=True))

    study = Study.from_mapping({"experiment": {"plant": "free"}, "repeats": 2})
    tuner = Tuner(study, [SearchRange("gain", 0.5, 4.0)], metric, tmp_path, answering(measure))
    tuner.search(16)
    kinds = set()
    for one in tuner.candidates:
        if one.values[0] < 1.5:
            assert (one.violation, one.success, one.excursion) == (0.0, 1.0, 0.9)
            assert abs(one.cost) == 3.5
        elif one.values[0] < 2.5:
            assert one.violation == pytest.approx(0.3 + 0.5) and one.success == 0.5
        else:
            assert (one.cost, one.violation, one.excursion) == (np.inf, 11.0, np.inf)
        kinds.add(min(one.values[0] // 0.5, 5) // 2)
    assert len(kinds) == 3 and tuner.best.cost == (3.5 if metric == "settled" else -3.5)


def test_a_study_is_judged_by_the_metric_that_it_names(tiny, tmp_path):
    study = tiny(judged="reduced", metrics=["success", "reduced"], repeats=1, vary={}, chunk=1)
    row = {"outcome": "timed_out", "success": 0.0, "reduced": 1.0, "simulated": 2.0}
    found = Results.read(write_study(tmp_path, study, lambda *_: row, wall=lambda run: 0.0))
    assert found.compute_successes().tolist() == [1.0]
    with pytest.raises(StudyError, match="column 'outcome' contains text, not numbers"):
        found.read_numbers("outcome")
    assert np.isnan(found.read_numbers("real_time_multiple"))  # sooner than any clock shows
    row["verdict"] = ""
    assert engine.is_success(row, study.judged) and not engine.is_success(row)
    assert study.digest == tiny(metrics=["success", "reduced"], repeats=1, vary={}, chunk=1).digest
    assert engine.is_success({"outcome": "x"}) and not engine.is_success({"outcome": rows.FAULT})
    with pytest.raises(StudyError, match="judged is 'reached', which is not among"):
        tiny(judged="reached")


def test_where_a_number_is_published_a_row_says_whether_it_is_met(tiny, tmp_path):
    pace = [{"name": "slow", "set": {"gain": 0.5}, "published": {"outcome": "x", "images": 7}},
            {"name": "fast", "set": {"gain": 2.0}}]  # fmt: skip
    study = tiny(vary={}, cases={"pace": pace}, chunk=4)
    path = write_study(tmp_path, study, lambda _, run: {"outcome": "x", "images": 7 + run})
    table = Results.read(path).table
    assert table["published"].to_pylist() == ["outcome x, images 7"] * 2 + [""] * 2
    assert table["met"].to_pylist() == [True, False, None, None]


def test_what_a_study_would_take_is_told_by_a_run_that_loads_nothing(tiny, monkeypatch):
    """The first of two runs of 2.5 s also compiles, which takes 80 s by this clock."""
    def told(workers, **changes):
        study, clock = tiny(**changes), iter((0.0, 80.0, 80.0, 82.5))
        monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
        return engine.dry_run(study, workers)

    one = {"repeats": 1, "vary": {}, "chunk": 1, "metrics": ["success", f"{__name__}:failing"]}
    assert told(1, **one) == [
        "1 run: 1 point, 1 of each; 1 chunk of 1", "about 2 s on 1 core: a run takes 2.5 s here",
        f"run 0: base experiment; seed {tiny(**one).compute_seed(0)}",
        "run 0 as tried: fault: ZeroDivisionError: of mine"]
    some = told(4, repeats=80)
    assert some[0] == "240 runs: 3 points, 80 of each; 120 chunks of 2"
    assert some[1] == "about 2 min on 4 cores: a run takes 2.5 s here"
    assert some[2:] == [f"run {run}: gain=1.0; seed {tiny(repeats=80).compute_seed(run)}"
                        for run in range(3)]
    assert "about 8 s on 0 core" in told(0, repeats=1)[1]
