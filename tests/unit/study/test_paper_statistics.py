"""Statistics of a paper, recomputed from the rows by statsmodels or by counting all cases."""

from __future__ import annotations

import itertools
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_studies import write_study
from matplotlib.figure import Figure
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from aras_visual_servo_bench import Results, Run, Study, metric
from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.metrics import statistics
from aras_visual_servo_bench.metrics.formatting import choose_unit
from aras_visual_servo_bench.metrics.metrics import METRICS
from aras_visual_servo_bench.plots import study_figures
from aras_visual_servo_bench.plots.figure_captions import make_caption
from aras_visual_servo_bench.studies import captions, compare, tables
from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.web.browse import result_queries as queries
from aras_visual_servo_bench.web.browse.queries import GroupQuery, MapQuery
from aras_visual_servo_bench.web.browse.studies import Studies

SCHEMES = ("points", "moments", "polar")
MEASURED = ["success", "reached", "contradicts", "settled", "final_distance", "overshoot"]
BASE = {"plant": "free", "reached": [0.0003, math.radians(0.3)]}


def make_study(**changes) -> Study:
    return Study.from_mapping({
        "experiment": BASE, "repeats": 10, "seeds": "repeats", "metrics": MEASURED, "chunk": 30,
        "cases": {"scheme": [{"name": name, "set": {"scheme": scheme}} for name, scheme in zip(
            SCHEMES, ("points", "moments", "polar_points"), strict=True)]},
        "vary": {"gain": [1.0, 2.0]}, **changes})  # fmt: skip


def make_row(study: Study, run: int) -> dict:
    """Random results: `moments` is slower, `polar` at gain 2 always loses its target; ties, NaN."""
    row, rng = rows.make_blank_row(study, run), np.random.default_rng(run)
    common = np.random.default_rng(row["repeat"]).uniform(1.0, 2.0)
    if row.get("scheme") == "polar" and row.get("gain") == 2.0:
        return {**row, "outcome": "target_lost", "verdict": "goal_missed", "success": 0.0,
                "reached": 0.0, "contradicts": 0.0, "final_distance": 0.2, "simulated": 1.0}
    reached = float(rng.random() < (0.5 if row.get("scheme") == "moments" else 0.9))
    is_refused = run == 3
    return row if is_refused else {
        **row, "outcome": "converged" if reached else "timed_out", "simulated": 2.0,
        "verdict": "goal_reached" if reached else "goal_missed", "success": reached,
        "reached": reached, "contradicts": float(rng.random() < 0.1),
        "settled": round(common * (1.5 if row.get("scheme") == "moments" else 1.0)
                         + 0.1 * rng.random(), 1) if rng.random() < 0.9 else math.nan,
        "final_distance": 5e-5 * math.exp(rng.normal()), "overshoot": rng.random(),
    }  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_study(tmp_path_factory.mktemp("paper") / "out", make_study(), make_row)


@pytest.fixture(scope="module")
def raw(path):
    table = pd.read_parquet(path / "parts").sort_values("run", ignore_index=True)
    return table.assign(success=table.success.fillna(0), reached=table.reached.fillna(0))


def wilson(values):
    known = values.dropna()
    return (known.mean(), *proportion_confint(known.sum(), len(known), method="wilson"), len(known))


def run_command(words, capsys):
    code = main(list(map(str, words)))
    told = capsys.readouterr()
    return code, told.out, told.err


# -- rates ----------------------------------------------------------------------------------------


def test_seven_misses_of_sixty_are_a_rate_everywhere(tmp_path, capsys):
    """The median was 1 [1, 1]; of a study without the metric, nothing is known."""
    paths = []
    for name, metrics in (("with", ["success", "reached"]), ("without", ["success"])):
        study = make_study(cases=(), vary={"gain": [1.0]}, repeats=60, metrics=metrics)

        def make(study, run):
            told = dict.fromkeys(study.metrics, 1.0) if run >= 7 else {}
            return {"outcome": "x", "verdict": "y", **told}

        paths.append(write_study(tmp_path / name, study, make))
    low, high = proportion_confint(53, 60, method="wilson")
    text = run_command(["table", paths[0], "--metrics", "reached"], capsys)[1]
    assert f"| {53 / 60:.3f} [{low:.3f}, {high:.3f}] |" in text
    look = Studies(paths).read_snapshot(is_forced=True)
    query = GroupQuery(by=("study",), values=("reached",))
    told = {one["values"][0]: one["estimates"][0] for one in
            queries.compute_groups(look, query)["groups"]}  # fmt: skip
    assert told == {"with": pytest.approx([53 / 60, low, high]), "without": [None] * 3}
    told = queries.compute_success_map(look, MapQuery(x="gain", y="gain", value="reached"))
    assert told["values"] == [[pytest.approx(53 / 60)]]
    described = {one["name"]: one["is_binary"] for one in queries.describe_columns(look)}
    assert described["reached"] and described["success"] and not described["gain"]


@metric("", "greater", "these tests", is_binary=True)
def half(run: Run) -> float:
    """1 if it is whole."""
    return 0.5


def test_a_binary_metric_has_two_values(tmp_path, capsys):
    study = make_study(cases=(), metrics=[f"{__name__}:half"], judged=f"{__name__}:half")

    def make(study, run):
        return {"outcome": "x", "half": run % 2 / 2 + 0.5}

    path = write_study(tmp_path / "out", study, make)
    code, _, error = run_command(["table", path], capsys)
    assert code == 1 and error.count("\n") == 1
    assert "half is declared as binary, but a run has the value 0.5: return 0, 1 or NaN" in error
    # success is the value 1 of the judged metric, also of a user's own
    assert Results.read(path).compute_successes().tolist() == [run % 2 for run in range(20)]
    with pytest.raises(StudyError, match="a binary metric has no unit"):
        metric("m", "greater", "these tests", is_binary=True)


# -- the tolerance --------------------------------------------------------------------------------


def judge(study, run):
    """A run at its goal, with the tolerance by which a run of the study is judged."""
    limits = study.make_settings(run // study.repeats).get("reached") or study.experiment.get(
        "reached") or (1.5e-3 * (0.2 + 0.01 * run), math.radians(0.3))  # fmt: skip
    return {"outcome": "x", "success": 1.0,
            "distance_tolerance": limits[0], "angle_tolerance": limits[1]}  # fmt: skip


@pytest.mark.parametrize(("changes", "sentence"), [
    ({}, "A camera is at its goal within 0.3 mm and 0.3°."),
    ({"experiment": {"plant": "free"}, "vary": {}, "repeats": 1},
     "A camera is at its goal within 0.3 mm (0.15 % of the target's depth) and 0.3°."),
    ({"experiment": {"plant": "free"}, "vary": {}, "repeats": 11},
     "A camera is at its goal within 0.3 to 0.45 mm (0.15 % of the target's depth) and 0.3°."),
    ({"vary": {"reached": [[1e-3, 0.1], [5e-5, 0.1]]}, "metrics": ["success"]},
     "A camera is at its goal within 1 mm and 5.73° or 50 µm and 5.73°."),
])  # fmt: skip
@pytest.mark.parametrize("style", ["md", "tex"])
def test_captions_state_the_tolerance(changes, sentence, style, tmp_path, capsys):
    study = make_study(**{"cases": (), "repeats": 2, **changes})
    path = write_study(tmp_path / "out", study, judge)
    if style == "tex":
        for symbol, tex in (("%", r"\%"), ("°", r"$^\circ$"), ("µ", r"$\mu$")):
            sentence = sentence.replace(symbol, tex)
    assert sentence in run_command(["table", path, "--format", style], capsys)[1]


@pytest.mark.parametrize(("changes", "text"), [
    ({}, "0.3 mm and 0.3°"),
    ({"experiment": {"plant": "free"}}, "0.15 % of the target's depth and 0.3°"),
    ({"cases": [{"reached": [1e-3, 0.1]}, {"reached": [2e-3, 0.1]}]},
     "1 mm and 5.73° or 2 mm and 5.73°"),
    ({"cases": [{"reached": [1e-3, 0.1]}, {"scheme": "moments"}]},
     "0.3 mm and 0.3° or 1 mm and 5.73°"),
])  # fmt: skip
def test_runs_without_a_verdict_have_the_tolerance_of_the_study(changes, text, tmp_path):
    study = make_study(**{"cases": (), "vary": {}, "repeats": 2, "metrics": ["success"], **changes})
    path = write_study(tmp_path / "out", study, rows.make_blank_row)
    assert Results.read(path).tolerance.text == text


def test_the_stored_tolerance_is_that_of_the_verdict():
    cases = {"tolerance": [{"name": name, "set": {"reached": limits}} for name, limits in (
        ("small", [1e-3, 0.1]), ("large", [1.0, 3.0]))]}  # fmt: skip
    cases["tolerance"].append({"name": "default", "set": {"scheme": "points"}})
    study = Study(experiment={"plant": "free", "features": "exact", "duration": 0.3}, cases=cases,
                  metrics=["reached", "final_distance"])  # fmt: skip
    found = study.run(progress=False).to_pandas()
    small, large, default = found.distance_tolerance
    assert (small, large) == (1e-3, 1.0) and 0.1 < default / 1.5e-3 < 0.4
    assert found.angle_tolerance.tolist() == [0.1, 3.0, math.radians(0.3)]
    assert found.reached.tolist() == (found.final_distance <= found.distance_tolerance).tolist()
    assert found.reached.tolist() == [0.0, 1.0, 0.0]


def test_a_setting_and_a_metric_cannot_share_a_column():
    slow = {"repeat": [{"name": "slow", "set": {"gain": 1.0}}]}
    for changes, told in (
        ({"cases": (), "vary": {"reached": [[1e-3, 0.1], [5e-5, 0.1]]}},
         "'reached' is both a varied key and a metric"),
        ({"metrics": ["success", "images"]}, "metric 'images' has the name of a column of all res"),
        ({"metrics": ["success", "settled", "success"]}, "two metrics are named 'success': remove"),
        ({"cases": slow, "vary": {}}, "'repeat' is a column of all results: give the axis"),
    ):  # fmt: skip
        with pytest.raises(StudyError, match=told):
            make_study(**changes)


def test_captions_define_what_is_shown(path, tmp_path):
    results = Results.read(path)
    reduced = make_study(cases=(), metrics=["reduced"], judged="reduced", repeats=1)
    found = Results.read(write_study(tmp_path / "reduced", reduced, lambda study, run: {
        **rows.make_blank_row(study, run), "outcome": "x", "reduced": 1.0}))  # fmt: skip
    assert captions.describe_success([found]) == [
        "Success (reduced): the final distance and angle to the goal are at most a tenth of the "
        "initial ones."]  # fmt: skip
    both = captions.describe_success([results, found])
    assert both[0].startswith("Success in out: ") and both[1].startswith("Success in reduced (red")


# -- comparisons ----------------------------------------------------------------------------------


def expected_differences(raw, names, by=None):
    """Group, sides, metric, p before and after Holm's correction, number of pairs."""
    found = []
    for group, part in raw.groupby(by) if by else [("all", raw)]:
        for one, two in itertools.combinations(SCHEMES, 2):
            both = part[part.scheme == one].merge(part[part.scheme == two], on=["seed", "gain"])
            for name in names:
                pairs = both[[f"{name}_x", f"{name}_y"]].dropna()
                x, y = pairs.to_numpy().T
                compare_them = (statistics.compare_rates if METRICS[name].is_binary else
                                statistics.compare_values)  # fmt: skip
                found.append((group, (one, two), name, compare_them(x, y, True).p, x, y))
    return found


@pytest.mark.parametrize("by", [None, "gain"])
def test_cases_of_one_study_are_compared_pairwise(path, raw, by):
    names = ["success", "reached", "contradicts", "settled", "final_distance"]
    compared = Results.read(path).compare(between="scheme", by=[by] if by else (), metrics=names)
    found = compared.differences
    wanted = expected_differences(raw, names, by)
    assert len(found) == len(wanted) == (30 if by else 15)
    for d, (group, sides, name, p, x, y) in zip(found, wanted, strict=True):
        assert d.group == ("all" if group == "all" else f"gain={group}")
        assert (d.metric, d.sides) == (name, tuple(f"scheme={side}" for side in sides))
        assert d.comparison.paired and d.comparison.count == len(x)
        if not len(x):
            assert math.isnan(d.p) and d.verdict == compare.UNTESTED
            assert d.note == "no pair of runs has a value in both runs"
            continue
        middle = np.mean if METRICS[name].is_binary else np.median
        assert (d.comparison.before, d.comparison.after) == pytest.approx((middle(x), middle(y)))
        assert d.comparison.p == pytest.approx(p)
    tested = [d for d in found if d.verdict != compare.UNTESTED]
    corrected = multipletests([d.comparison.p for d in tested], method="holm")[1]
    assert [d.p for d in tested] == pytest.approx(corrected)
    assert {d.verdict for d in found} == {
        compare.CHANCE, *([compare.UNTESTED] if by else [compare.WORSE])}


def test_a_metric_that_one_study_lacks_is_not_left_out_silently(path, tmp_path):
    results = Results.read(path)
    other = Results.read(write_study(tmp_path / "other", make_study(metrics=["success"]), make_row))
    for one, two in ((results, other), (other, results)):
        with pytest.raises(StudyError, match="no metric 'settled' in other"):
            one.compare(two, metrics=["settled"])
        assert {d.metric for d in one.compare(two).differences} == {"success"}
    named = results.compare(results, metrics=["real_time_multiple"])
    assert {d.metric for d in named.differences} == {"success", "real_time_multiple"}


def test_drawn_starts_make_pairs_although_the_seeds_differ(tmp_path):
    draws = {"delay": {"uniform": [0.01, 0.1]}}
    for repeats, paired in ((1, True), (2, False)):
        study = make_study(seeds="runs", repeats=repeats, samples=12, vary=draws)
        results = Results.read(write_study(tmp_path / f"out{repeats}", study, make_row))
        found = results.compare(between="scheme", metrics=["final_distance"]).differences
        assert {d.comparison.paired for d in found} == {paired}
        assert not any("also differ" in d.note for d in found)


def test_metrics_of_features_are_not_compared_between_schemes(path):
    results = Results.read(path)
    found = results.compare(between="scheme").differences
    assert {d.metric for d in found} == set(MEASURED) - {"overshoot"}
    assert "overshoot" in {d.metric for d in results.compare(between="gain").differences}
    with pytest.raises(StudyError, match="overshoot depends on the features of the scheme"):
        results.compare(between="scheme", metrics=["overshoot"])


def test_settings_that_differ_along_with_the_compared_one_are_named(tmp_path):
    cases = [{"scheme": "points", "delay": 0.01}, {"scheme": "moments", "delay": 0.05}]
    study = make_study(cases=cases, vary={})
    results = Results.read(write_study(tmp_path / "out", study, make_row))
    found = results.compare(between="scheme", metrics=["settled"]).differences
    assert all(d.comparison.paired for d in found)
    assert all("the compared runs also differ in delay (0.01, 0.05)" in d.note for d in found)


def test_the_command_compares_cases_and_explains_what_it_cannot(path, tmp_path, capsys):
    code, text, _ = run_command(["diff", path, "--between", "scheme", "--by", "gain", "--all"],
                                capsys)  # fmt: skip
    assert code == 0 and "scheme=points -> scheme=moments  gain=1.0" in text
    assert "untested settled" in text and "no pair of runs has a value in both runs" in text
    assert ("2 differences of settled are not tested, because one of the compared groups has no "
            "values") in text
    draws = {"delay": {"uniform": [0.01, 0.1]}, "gain": [1.0]}
    study = make_study(cases=(), samples=3, repeats=1, vary=draws)
    one = write_study(tmp_path / "one", study, make_row)
    for words, complaint in (
        ([path], "diff without --between needs 2 study folders, not 1: give two folders, or one"),
        ([path, path, "--between", "scheme"], "diff with --between needs 1 study folder, not 2"),
        ([path, "--between", "schem"], "out does not vary 'schem': did you mean 'scheme'?"),
        ([path, "--between", "gain", "--by", "gain"], "gain is given in both --between and --by"),
        ([one, "--between", "delay"], "delay is drawn at random: --between needs a key with"),
        ([one, "--between", "gain"], "all stored runs of one have gain=1.0, so there is no"),
    ):
        code, _, error = run_command(["diff", *words], capsys)
        assert code == 1 and complaint in error and error.count("\n") == 1
    with pytest.raises(StudyError, match="give either two studies, or one study and a key"):
        Results.read(path).compare()


# -- bad input ------------------------------------------------------------------------------------


def test_one_run_per_cell_has_no_interval_and_no_test(tmp_path, capsys):
    path = write_study(tmp_path / "out", make_study(repeats=1), make_row)
    text = run_command(["table", path, "--metrics", "overshoot"], capsys)[1]
    assert "overshoot has only one value, and so no interval, in every group." in text
    cells = text.splitlines()[2].split(" | ")
    assert "[" in cells[3] and "[" not in cells[5]
    text = run_command(["diff", path, "--between", "scheme", "--by", "gain"], capsys)[1]
    assert "of these differences have too few runs to be significant: repeat each setting" in text
    text = run_command(["diff", path, "--between", "scheme", "--by", "gain", "--all"], capsys)[1]
    assert "(a sample of 1 pair is too small for p < 0.05)" in text
    text = run_command(["table", path, "--metrics", "settled", "--format", "tex"], capsys)[1]
    assert "nan" not in text


def test_runs_without_a_value_are_counted(path, raw, capsys):
    text = run_command(["table", path, "--metrics", "contradicts,settled"], capsys)[1]
    assert "10 of 10 runs with scheme=polar, gain=2.0 (target_lost)" in text
    line = next(line for line in text.splitlines() if line.startswith("| polar | 2"))
    assert "| – |" in line and "10 of 10 target_lost" in line
    assert "contradicts has no value in 1 of 10 runs with scheme=points, gain=1.0 (refused)" in text
    for (scheme, gain), own in raw.groupby(["scheme", "gain"]):
        missing = own.settled.isna().sum()
        named = f"{missing} of 10 runs with scheme={scheme}, gain={gain} (" in text
        assert named == (missing > 0), (scheme, gain)


def test_missing_values_of_two_studies_name_the_study(path, tmp_path, monkeypatch):
    """The captions of figures named only the setting, the same one for both studies."""
    monkeypatch.setattr(Figure, "savefig", lambda _, path: path.touch())
    shutil.copytree(path, tmp_path / "again")
    both = [Results.read(path), Results.read(tmp_path / "again")]
    study_figures.write_figures(both, tmp_path / "plots", metrics=["settled"])
    for text in ((tmp_path / "plots" / "captions.md").read_text(),
                 tables.format_table(tables.make_table(both, metrics=["settled"]), "md")):
        assert "runs with study=out, scheme=points" in text
        assert "runs with scheme=" not in text


def test_identical_repeats_are_no_sample(tmp_path, capsys):
    def make(study, run):
        return {"outcome": "converged", "success": 1.0,
                "verdict": "goal_reached", "settled": 1.0, "final_distance": 1e-4}  # fmt: skip

    path = write_study(tmp_path / "out", make_study(), make)
    sentence = "The repeats of each setting of out are identical, because nothing in them is random"
    assert sentence in run_command(["table", path], capsys)[1]
    code, text, _ = run_command(["diff", path, "--between", "scheme", "--all"], capsys)
    assert code == 0 and sentence in text and "(no difference)" in text
    other = write_study(tmp_path / "other", make_study(), make_row)
    assert sentence not in run_command(["table", other], capsys)[1]


# -- units and LaTeX ------------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "values", "found"), [
    ("m", [4.89e-5], ("µm", 1e-6)), ("m", [3e-4], ("mm", 1e-3)),
    ("m", [1.2, 4.89e-5], ("mm", 1e-3)), ("m", [0.0229, 2.5e-8], ("mm", 1e-3)),
    ("m", [0.0, math.nan, 0.3], ("m", 1.0)), ("m", [2e-12], ("µm", 1e-6)), ("m", [], ("m", 1.0)),
    ("s", [0.004, 0.02], ("ms", 1e-3)), ("s", [1.5], ("s", 1.0)), ("ms", [0.02], ("µs", 1e-3)),
    ("ms", [4000.0], ("s", 1e3)), ("rad", [1e-3], ("°", math.pi / 180)), ("", [1e-5], ("", 1.0)),
    ("rad²/s", [1e-5], ("rad²/s", 1.0)), ("m", [1.0, 1e-12], ("m", 1.0)),
])  # fmt: skip
def test_units_follow_the_magnitude(unit, values, found):
    name, size = choose_unit(unit, values)
    assert (name, size) == (found[0], pytest.approx(found[1]))


def write_tex(path, tmp_path, *words):
    """The LaTeX table of a study."""
    file = tmp_path / "table.tex"
    assert main(["table", str(path), *words, "--format", "tex", "--out", str(file)]) == 0
    return file.read_text()


def test_a_narrow_table_is_as_wide_as_a_column(path, tmp_path):
    for by, metrics, name in (("gain", "success", "table"), ("scheme,gain", "settled", "table*"),
                              ("scheme,gain", "", "table*")):  # fmt: skip
        text = write_tex(path, tmp_path, "--by", by, "--metrics", metrics)
        assert text.count(rf"\begin{{{name}}}") == text.count(r"\begin{table") >= 1


def test_a_table_of_a_hundred_rows_is_divided_into_pages(tmp_path):
    study = make_study(vary={"gain": [1.0 + 0.1 * i for i in range(34)]}, repeats=2)
    text = write_tex(write_study(tmp_path / "out", study, make_row), tmp_path)
    parts = {text.count(f"\n{scheme} & {1.0 + 0.1 * i:.3g} & 2 & ")
             for scheme in SCHEMES for i in range(34)}  # fmt: skip
    assert len(parts) == 1 and parts.pop() > 1  # every row is in all parts
    assert text.count("(continued)") == text.count(r"\begin{table") - 1 > 2


def test_latex_has_no_cell_that_it_takes_for_an_argument_nor_a_number_that_it_cannot_set(tmp_path):
    cases = {"scheme": [{"name": "[50 %] a_b & {#$} ~^\\ <|> \"q\" λ ° µ",
                         "set": {"scheme": "points"}},
                        {"name": "*", "set": {"scheme": "moments"}}]}  # fmt: skip
    text = write_tex(write_study(tmp_path / "out", make_study(cases=cases), make_row), tmp_path)
    assert "commonest failure" not in text and "nan" not in text
    # \\ of older versions of LaTeX and of amsmath takes [ and * in the next line as its arguments
    assert "\n{[50 \\%]" in text and "\n{*} &" in text
    column = tables.StatisticColumn("energy", "", tables.MEDIAN)
    estimate = tables.Estimate(-math.inf, 1e-9, math.inf, 3)
    text = tables.format_table(tables.Table((), (column,), (((), 3, (estimate,)),)), "tex")
    assert r"$-\infty$ {\footnotesize $[1.00 \cdot 10^{-9}, \infty]$}" in text


# -- figures --------------------------------------------------------------------------------------


def draw(path, draw_figure, *words):
    """A figure of a study, with its text set."""
    with study_figures.apply_style():
        figure = draw_figure([Results.read(path)], *words)
        figure.canvas.draw()
    return figure


def test_there_is_a_map_per_scheme(tmp_path, raw):
    """The map of gain and delay pooled the schemes."""
    study = make_study(vary={"gain": [1.0, 2.0], "delay": [0.01, 0.1]}, repeats=4)
    path = write_study(tmp_path / "out", study, make_row)
    own = pd.read_parquet(path / "parts")
    figure = draw(path, study_figures.draw_success)
    *maps, distance = figure.axes[:4]
    assert [axis.get_title("left") for axis in maps] == list(SCHEMES)
    assert (maps[0].get_ylabel(), maps[0].get_xlabel()) == ("gain (1/s)", "delay (s)")
    assert [text.get_text() for text in maps[0].get_xticklabels()] == ["0.01", "0.1"]
    for axis, scheme in zip(maps, SCHEMES, strict=True):
        for text in axis.texts:
            j, i = text.get_position()
            part = own[(own.scheme == scheme) & (own.gain == (1.0, 2.0)[i])
                       & (own.delay == (0.01, 0.1)[j])]  # fmt: skip
            assert text.get_text() == f"{int((part.success == 1).sum())}/4"
    assert [line.get_label() for line in distance.lines[:3]] == list(SCHEMES)
    assert distance.get_legend().get_title().get_text() == "scheme"
    caption = "\n".join(make_caption("success", [Results.read(path)], ()))
    assert "The curves pool runs with different gain, delay." in caption
    assert distance.lines[3].get_linestyle() == ":"
    assert distance.lines[3].get_xdata() == pytest.approx([0.3, 0.3])  # mm


def test_studies_in_folders_of_one_name_have_their_own_rates(tmp_path):
    study, found = make_study(cases=(), vary={}), []
    for name, value in (("one", 0.0), ("two", 1.0)):
        path = write_study(tmp_path / name / "out", study, lambda study, run, value=value: {
            **rows.make_blank_row(study, run), "outcome": "converged", "success": value})
        found.append(Results.read(path))
    figure = study_figures.draw_success(found)
    assert [bar.get_width() for bar in figure.axes[0].patches] == [0.0, 100.0]


def test_binary_metrics_are_drawn_as_rates(path, raw, tmp_path, monkeypatch):
    results = Results.read(path)
    figure = draw(path, study_figures.draw_rates, results.select_metrics(["reached"]))
    order = [group for _, group in raw.groupby(["scheme", "gain"], sort=False)]
    widths = [bar.get_width() for bar in figure.axes[0].patches]
    assert widths == pytest.approx([100 * group.reached.mean() for group in order])
    for line, group in zip(figure.axes[0].collections[0].get_segments(), order, strict=True):
        assert line[:, 0] == pytest.approx([100 * v for v in wilson(group.reached)[1:3]], abs=1e-9)
    monkeypatch.setattr(Figure, "savefig", lambda _, path: path.touch())
    written = {one.stem for one in study_figures.write_figures([results], tmp_path / "plots")}
    assert "rates" in written
    boxes = draw(path, study_figures.draw_boxes, results.select_metrics(["settled"])).axes[0]
    assert [text.get_text() for text in boxes.texts] == ["no value"]
    assert boxes.texts[0].get_position()[1] == 1  # polar at gain 2 is the last group
    text = (tmp_path / "plots" / "captions.md").read_text()
    assert "**rates.png**: Rates of reached, contradicts, with Wilson's 95 % interval." in text
    tolerance = "A camera is at its goal within 0.3 mm and 0.3°."
    assert text.count(tolerance) == text.count("**: ") > 3


def test_figures_for_a_paper_have_its_column_and_font(tmp_path, capsys):
    study = make_study(metrics=["success", "reached", "final_distance"])
    path = write_study(tmp_path / "out", study, make_row)
    words = ["plot", path, "--paper", "--out", tmp_path / "plots"]
    files = list(map(Path, run_command(words, capsys)[1].split()))
    assert {one.name for one in files} >= {"success.pdf", "rates_reached.pdf", "figures.tex",
                                           "boxes_final_distance.pdf"}  # fmt: skip
    for file in files[:-1]:
        data = file.read_bytes()
        width = float(re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ", data).group(1))
        assert width == pytest.approx(252.0), file
        fonts = set(re.findall(rb"/BaseFont /\w+\+(\w+)", data))
        assert fonts and all(font.startswith(b"STIX") for font in fonts), file
    text = (tmp_path / "plots" / "figures.tex").read_text()
    assert text.count(r"A camera is at its goal within 0.3 mm and 0.3$^\circ$.") == len(files) - 1
    with study_figures.apply_style(is_paper=True):
        figure = study_figures.draw_success([Results.read(path)])
        figure.canvas.draw()
        inside = figure.get_tightbbox().extents
    assert min(inside[:2]) >= 0.0 and (inside[2:] <= figure.get_size_inches()).all()
    assert all(axis.get_window_extent().height > 60 for axis in figure.axes if axis.lines)
