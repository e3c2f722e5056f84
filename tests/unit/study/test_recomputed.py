"""Every number about a study, recomputed by pandas from the Parquet files.

The fixture tells apart: groups of unlike sizes, as parts are missing, and the times of two that are
there; NaN in one study's row and not in its partner's; ties; runs that were refused; seeds that
the points share.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
from functools import partial

import numpy as np
import pandas as pd
import pytest
from made_studies import write_study

from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.metrics import statistics
from aras_visual_servo_bench.plots import palette, study_figures
from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.studies.results import Results
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.web.browse.server import serve

KEYS = ["gain", "delay"]
QUARTILES = "final_distance quartiles"
UNITS = {"gain": "1/s", "delay": "s", "success": "", "settled": "s", "final_distance": "m",
         "final_angle": "rad", "path_ratio": "", "iterations": "",
         "real_time_multiple": ""}  # fmt: skip
METRICS = list(UNITS)[2:-1]
MEDIANS = [name for name in list(UNITS)[3:] if name != "final_distance"]
SHOWN_UNITS = {**UNITS, "final_distance": "mm", "final_angle": "°"}  # 0.04 to 100 mm
BETTER = {"success": 1, "settled": -1, "final_distance": -1, "final_angle": -1, "path_ratio": -1}
MAPPING = {"experiment": {"plant": "free"},
           "vary": {"gain": [0.75, 2.0, 6.5], "delay": [0.03, 0.11]},
           "repeats": 8, "chunk": 3, "seeds": "repeats", "metrics": METRICS}  # fmt: skip
MISSING = {"one": (2, 7, 8), "two": (9,)}  # parts


def made_row(second: bool, study: Study, run: int) -> dict:
    """The second study settles sooner, and ends nearer at small gains."""
    own = np.random.default_rng(1000 * second + run)
    common = np.random.default_rng(run)
    values = rows.make_blank_row(study, run)
    gain, delay = values["gain"], values["delay"]
    good = gain * delay * math.exp(0.8 * common.normal() + 0.3 * own.normal()) < 0.3
    ends = ["converged", "target_lost", "oscillating", "refused"]
    end = "converged" if good else own.choice(ends, p=[0.2, 0.4, 0.2, 0.2])
    reason = {"target_lost": f"over the left border at {own.random():.2f} s",
              "oscillating": "it swings", "refused": "gain | delay"}.get(end, "")  # fmt: skip
    verdict = "" if end == "refused" else "goal_reached" if good else "goal_missed"
    values |= {"outcome": end, "verdict": verdict, "reason": "" if good else reason,
               "images": 60 + run, "simulated": 2.0 + own.random()}  # fmt: skip
    if end == "refused":
        return values
    nearer = (0.2 if second and gain < 1.0 else 1.0) * math.exp(0.2 * own.normal())
    return values | {
        "success": float(good),
        "settled": (3.0 + common.random()) / gain * (0.8 + 0.02 * own.random() if second else 1)
        if good and own.random() < 0.9 else math.nan,
        "final_distance": (2e-4 if good else 0.08) * math.exp(common.normal()) * nearer,
        "final_angle": 0.02 + 0.03 * common.random() + 0.01 * own.random(),
        "path_ratio": round(1.0 + 0.4 * common.random(), 1),  # ties
        "iterations": own.uniform(40, 60) - (30 if second else 0),
    }  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The folders `one` and `two`."""
    path = tmp_path_factory.mktemp("recomputed")
    for name, missing in MISSING.items():
        write_study(path / name, Study.from_mapping(MAPPING), partial(made_row, name == "two"),
                    missing, wall=lambda run: 0.3 + np.random.default_rng(run).random())
    for lost in ("one/times/000005.parquet", "two/times/000015.parquet"):  # somebody deleted them
        (path / lost).unlink()
    return path


def read(path) -> pd.DataFrame:
    """The rows as their files have them, and what follows from them."""
    table = pd.read_parquet(path / "parts").sort_values("run", ignore_index=True)
    wall = pd.read_parquet(path / "times").set_index("run").wall
    table["real_time_multiple"] = table.simulated / table.run.map(wall)
    table["hit"] = (table.success == 1.0).astype(float)
    arrived = table.outcome == "converged"
    table["end"] = table.outcome.where(~arrived, table.outcome + ", " + table.verdict)
    return table


@pytest.fixture(scope="module")
def one(path):
    return read(path / "one")


@pytest.fixture(scope="module")
def two(path):
    return read(path / "two")


# -- tables ---------------------------------------------------------------------------------------


def unpack(estimate):
    """An estimate of `statistics`, whose numbers unit/properties/test_statistics.py recomputes."""
    return estimate.value, estimate.low, estimate.high, estimate.count


def told_rate(group):
    return unpack(statistics.proportion(group.hit.sum(), len(group)))


def quartiles(values):
    low, middle, high = values.quantile([0.25, 0.5, 0.75])
    return middle, low, high, values.count()


def commonest(group):
    """Return the most frequent outcome of failures, and its first reason, ignoring numbers."""
    failed = group[group.hit == 0]
    if failed.empty:
        return ""
    end = failed.end.value_counts(sort=False).idxmax()
    kinds = failed[failed.end == end].reason
    kind = kinds.str.replace(r"[-+]?\d+(\.\d+)?", "", regex=True)
    why = kinds[kind == kind.value_counts(sort=False).idxmax()].iloc[0]
    return f"{(failed.end == end).sum()} of {len(failed)} {end}" + (f": {why}" if why else "")


@pytest.fixture(scope="module")
def expected(one):
    """Return, for each gain and delay, (value, low, high, count) of each quantity, and the failure.
    """
    found = []
    for values, group in one.groupby(KEYS, sort=False):
        numbers = {"success": told_rate(group), QUARTILES: quartiles(group.final_distance)}
        numbers |= {name: unpack(statistics.median(group[name])) for name in MEDIANS}
        found.append((values, numbers, commonest(group)))
    return found


def shows(text, value, digits=3):
    """Return whether a printed number is this value, rounded to its digits."""
    if not math.isfinite(value):
        return text == ("∞" if value > 0 else "–")
    if value == 0:
        return text == "0"
    if text == "≈0":
        return abs(value) < 1e-5
    step = 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)
    return abs(float(text) - value) <= 0.50001 * step


def printed(words, capsys):
    assert main(list(map(str, words))) == 0
    return capsys.readouterr().out


def test_every_cell_of_a_table_is_recomputed(path, expected, capsys):
    names = [*list(UNITS)[:3], QUARTILES, *MEDIANS]
    units = [SHOWN_UNITS.get(name, "mm") for name in names]
    headings = [f"{name} ({unit})" if unit else name
                for name, unit in zip(names, units, strict=True)]  # fmt: skip
    headings = [*headings[:2], "runs", *headings[2:], "commonest failure"]

    text = printed(["table", path / "one", "--format", "csv"], capsys)
    table = pd.read_csv(io.StringIO(text), keep_default_na=False, na_values=["nan"])
    assert len(table) == len(expected)
    for (_, row), (values, numbers, failure) in zip(table.iterrows(), expected, strict=True):
        assert (row.gain, row.delay) == values and row["commonest failure"] == failure
        for name, (value, low, high, count) in numbers.items():
            name = name.replace(" ", "_")
            found = [row[name], row[f"{name}_low"], row[f"{name}_high"]]
            assert found == pytest.approx([value, low, high], rel=1e-9, nan_ok=True), name
            assert row[f"{name}_n"] == count, name

    text = printed(["table", path / "one"], capsys)
    lines = [re.split(r" (?<!\\)\| ", line.strip("| "))
             for line in text.splitlines() if "|" in line]  # fmt: skip
    assert lines[0] == headings
    for cells, (values, numbers, failure) in zip(lines[2:], expected, strict=True):
        assert tuple(map(float, cells[:2])) == values
        assert int(cells[2]) == numbers["success"][3]
        assert cells[-1].replace("\\|", "|") == (failure or "–")
        for cell, (name, told) in zip(cells[3:-1], numbers.items(), strict=True):
            if not told[3]:
                assert cell == "–", name
                continue
            found = re.match(r"(\S+)(?: \[(\S+), (\S+)\])?$", cell)
            scale = (1e3 if name.startswith("final_distance") else
                     180.0 / math.pi if name == "final_angle" else 1.0)  # fmt: skip
            assert (found.group(2) is None) == math.isnan(told[1]), (name, cell)
            for text, value in zip(found.groups(), told, strict=False):
                assert text is None or shows(text, scale * value), (name, cell, told)


def test_a_row_a_run_is_exported_as_it_was_written(path, one, tmp_path):
    Results.read(path / "one").write_csv(tmp_path / "all.csv")
    found = pd.read_csv(tmp_path / "all.csv", keep_default_na=False, na_values=["nan", "NaN"])
    assert "code" not in found
    for name in ["run", "point", "repeat", "seed", *UNITS, "images", "simulated", "reason"]:
        pd.testing.assert_series_equal(found[name], one[name], check_dtype=False)


# -- differences ----------------------------------------------------------------------------------


def differences(one, two, by):
    """Group, quantity, before, after, p after Holm's correction, pairs or None, runs."""
    found = []
    rest = [key for key in KEYS if key not in by]
    for values, a in one.groupby(by, sort=False):
        b = two[(two[by] == list(values)).all(axis=1)]
        both = a.merge(b, on=[*rest, "seed"], suffixes=("_a", "_b"))
        paired = len(both) >= 0.9 * max(len(a), len(b))
        for name in METRICS:
            column = "hit" if name == "success" else name
            if paired:
                x, y = both[[f"{column}_a", f"{column}_b"]].dropna().to_numpy().T
            else:
                x, y = a[column].dropna().to_numpy(), b[column].dropna().to_numpy()
            middle = np.mean if name == "success" else np.median
            known = [middle(v) if len(v) else math.nan for v in (x, y)]
            found.append([", ".join(map(str, values)), name, *known, chance(name, x, y, paired),
                          paired, min(len(x), len(y))])  # fmt: skip
    names = ["group", "metric", "before", "after", "p", "paired", "count"]
    table = pd.DataFrame(found, columns=names)
    table["p"] = statistics.holm(table.p.tolist())
    return table


def chance(name, x, y, paired):
    """p of a difference; unit/properties/test_statistics.py recomputes it."""
    compare = statistics.compare_rates if name == "success" else statistics.compare_values
    return compare(x, y, paired).p


@pytest.fixture(scope="module", params=[KEYS, ["gain"]], ids=["each setting", "by gain"])
def asked(request, one, two):
    """Keys, and the table of differences."""
    return request.param, differences(one, two, request.param)


def test_every_difference_is_recomputed(path, asked, capsys):
    by, wanted = asked
    text = printed(["diff", path / "one", path / "two", "--all", "--by", ",".join(by), "--metrics",
                    ",".join(METRICS[1:])], capsys)  # fmt: skip
    lines, last = text.splitlines()[: len(wanted)], text.splitlines()[len(wanted)]
    sure, tested = wanted[wanted.p < 0.05], wanted.p.count()
    assert last.startswith(f"{len(sure)} of {tested} differences are significant (Holm")
    pattern = (r"(\w+) +(\S+) +(\S+) -> ([^\s°]+)(?: ?(\S+))?  p (\S+)  (\d+) (\w+)  "
               r"(\S+?=[^(]*?)(?:  \(.*\))?$")  # fmt: skip
    for line, row in zip(lines, wanted.itertuples(), strict=True):
        found = re.match(pattern, line).groups()
        verdict, name, before, after, unit, p, count, what, group = found
        scale = {"mm": 1e3, "µm": 1e6, "ms": 1e3, "°": 180.0 / math.pi}.get(unit, 1.0)
        assert (unit or "")[-1:] == {"rad": "°"}.get(UNITS[name], UNITS[name]), line
        told = (row.metric, labelled(by, row.group), row.count)
        assert (name, group, int(count)) == told, line
        assert what == ("pair" if row.paired else "run") + ("" if row.count == 1 else "s"), line
        assert shows(before, scale * row.before) and shows(after, scale * row.after), (line, row)
        assert shows(p, row.p, 2), (line, row)
        assert verdict == verdict_of(row), line


def labelled(by, group):
    return ", ".join(f"{k}={v}" for k, v in zip(by, group.split(", "), strict=True))


def verdict_of(row):
    if math.isnan(row.p):
        return "untested"
    if row.p >= 0.05:
        return "chance"
    direction = BETTER.get(row.metric, 0) * np.sign(row.after - row.before)
    return {1: "better", -1: "WORSE", 0: "differs"}[int(direction)]


# -- pictures -------------------------------------------------------------------------------------


def test_distributions_and_boxes_show_the_rows_numbers(path, one):
    results = Results.read(path / "one")
    chosen = results.select_metrics(["settled", "final_distance", "path_ratio"])
    names = [m.name for m in chosen]
    groups = [group for _, group in one.groupby(KEYS, sort=False)]

    drawn = study_figures.draw_distributions([results], chosen)
    for axis, name in zip(drawn.axes, names, strict=False):
        unit, size = ("mm", 1e-3) if name == "final_distance" else (UNITS[name], 1.0)
        assert axis.get_xlabel() == name.replace("_", " ") + (f" ({unit})" if unit else "")
        lines = [line for line in axis.lines
                 if len(line.get_xdata()) and line.get_linestyle() != ":"]  # fmt: skip
        for line, group in zip(lines, [g for g in groups if g[name].notna().any()], strict=True):
            known = group[name].dropna().sort_values()
            np.testing.assert_allclose(line.get_xdata()[1:], known / size, rtol=1e-12)
            below = 100 * np.arange(len(known) + 1) / len(group)  # of all, the unknown too
            np.testing.assert_allclose(line.get_ydata(), below)

    drawn = study_figures.draw_boxes([results], chosen)
    for axis, name in zip(drawn.axes, names, strict=False):
        size = 1e-3 if name == "final_distance" else 1.0
        quarters = [group[name].quantile([0.25, 0.5, 0.75]) / size for group in groups[::-1]]
        for place, wanted in enumerate(quarters, 1):
            middle = [line.get_xdata()[0] for line in axis.lines
                      if line.get_color() == palette.VERMILION
                      and round(line.get_ydata().mean()) ==
                      place and len(line.get_xdata())]  # fmt: skip
            box = axis.patches[place - 1].get_path().vertices
            if wanted.notna().all():
                assert middle == [pytest.approx(wanted[0.5])]
                ends = [np.nanmin(box[:, 0]), np.nanmax(box[:, 0])]
                assert ends == pytest.approx([wanted[0.25], wanted[0.75]])


# -- the browser ----------------------------------------------------------------------------------


def test_the_browser_compares_with_the_same_numbers(path, one, two):
    real_time = "real_time_multiple"  # of the machine, not of the study
    found = serve([path], "127.0.0.1", 21300 + os.getpid() % 1000, say=lambda _: None)
    try:
        told = found.answer_query(json.dumps(
            {"do": "compare", "first": "one", "second": "two"}))  # fmt: skip
    finally:
        found.close()
    known = {(d["group"], d["metric"]): d for d in told["differences"]}
    wanted = differences(one, two, KEYS)
    assert len(known) == len(wanted) and not any(name == real_time for _, name in known)
    for row in wanted.itertuples():
        d = known[labelled(KEYS, row.group), row.metric]
        for name in ("before", "after", "p", "count"):
            value = getattr(row, name)
            assert d[name] == (None if value != value else pytest.approx(value)), (row, d)
        assert (d["paired"], d["verdict"]) == (row.paired, verdict_of(row))
