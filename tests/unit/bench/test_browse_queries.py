"""Queries about synthetic rows, compared with pandas, for every kind of column and every limit."""

from __future__ import annotations

import base64
import itertools
import math

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from aras_visual_servo_base.settings import build
from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.metrics.formatting import choose_unit
from aras_visual_servo_bench.web.browse import result_queries as queries
from aras_visual_servo_bench.web.browse.map_cells import divide_into_cells, to_json_value
from aras_visual_servo_bench.web.browse.queries import (
    ColumnFilter,
    GroupQuery,
    MapQuery,
    PointQuery,
    RowQuery,
    RunSelection,
)
from aras_visual_servo_bench.web.browse.studies import StudiesSnapshot, StudyEntry

COUNT = 390


def made_columns():
    """Numbers that are unknown in each way; words, two of them empty or null; a truth value."""
    rng = np.random.default_rng(5)
    distance = rng.lognormal(sigma=0.4, size=COUNT)
    distance[[3, 40]] = np.nan, np.inf
    word = [None if i % 11 == 0 else "" if i % 11 == 1 else
            f"{'Left' if i % 3 else 'right'} {i % 5}" for i in range(COUNT)]  # fmt: skip
    success = (rng.random(COUNT) < 0.4).astype(float)
    success[7] = np.nan
    end = [("converged" if s == 1 else rng.choice(["lost", "swings", "slow"], p=[0.5, 0.3, 0.2]))
           for s in success]  # fmt: skip
    return {
        "study": ["b"] * 150 + ["a"] * 240, "run": [*range(150), *range(240)],
        "gain": [None if i < 9 else (1.5, 4.0, 0.25)[i // 2 % 3] for i in range(COUNT)],
        "step": [int(i) for i in rng.permutation(COUNT)],
        "seed": [2**53 - 1 + i % 3 for i in range(COUNT)],
        "distance": [None if i in (5, 6) else float(v) for i, v in enumerate(distance)],
        "angle": rng.normal(size=COUNT), "word": word,
        "name": [f"n{min(int(v), 69):02d}" for v in rng.exponential(25, COUNT)],
        "flag": [None if i % 13 == 0 else bool(rng.random() < 0.5) for i in range(COUNT)],
        "end": [None if i == 12 else v for i, v in enumerate(end)], "success": success,
    }  # fmt: skip


@pytest.fixture(scope="module")
def look():
    studies = tuple(StudyEntry(name, None) for name in ("a", "c", "b"))
    return StudiesSnapshot(
        1, studies, pa.table(made_columns()), {"gain": "1/s"}, {"gain": "setting"}
    )


@pytest.fixture(scope="module")
def table():
    return pd.DataFrame(made_columns())


def chosen(look, *filters, studies=()):
    """Return the rows that these filters select."""
    asked = RunSelection(studies, tuple(ColumnFilter(*one) for one in filters))
    return queries.select_rows(look, asked).tolist()


def where(mask):
    return np.flatnonzero(mask).tolist()


@pytest.mark.parametrize(("column", "value"), [
    ("gain", 1.5), ("step", 200), ("word", "Left 2"), ("distance", "0.9"), ("end", "slow"),
])  # fmt: skip
def test_an_operator_compares_as_pandas_does(look, table, column, value):
    known = table[column].notna()
    other = float(value) if column == "distance" else value
    for operator, method in (("=", "eq"), ("≠", "ne"), ("<", "lt"), ("≤", "le"), (">", "gt"),
                             ("≥", "ge")):  # fmt: skip
        told = table[column].where(known, other)
        wanted = getattr(told, method)(other) & known
        if column == "distance" and operator == "≠":
            wanted[3] = True  # what is not a number is another
        assert chosen(look, (column, operator, value)) == where(wanted), operator
        assert operator in "=≤≥≠" or 0 < wanted.sum() < COUNT


def test_truth_values_are_equal_or_not(look, table):
    for value, wanted in ((True, True), (1.0, True), ("true", True), ("True", True), (False, False),
                          (0.0, False), ("no", False)):  # fmt: skip
        assert chosen(look, ("flag", "=", value)) == where(table.flag.eq(wanted)), value
        assert chosen(look, ("flag", "≠", value)) == where(table.flag.eq(not wanted)), value
    with pytest.raises(StudyError, match="flag is true or false; use the operator = or ≠"):
        chosen(look, ("flag", "<", True))
    for value in ("x", None):
        with pytest.raises(StudyError, match="step contains numbers, and .* is not a number"):
            chosen(look, ("step", "=", value))


def test_what_is_known_and_what_words_contain(look, table):
    for column in ("gain", "step", "distance", "word", "flag"):
        known = table[column].notna() & (table[column] != "")
        assert chosen(look, (column, "is known")) == where(known)
        assert chosen(look, (column, "is not known")) == where(~known)
    left = table.word.str.contains("lEFT", case=False, na=False).astype(bool)
    assert chosen(look, ("word", "contains", "lEFT")) == where(left)
    nine = table.step.astype(str).str.contains("9")
    assert chosen(look, ("step", "contains", 9)) == where(nine)
    assert chosen(look, ("word", "=", "Left 1"), ("step", "<", 300)) == where(
        table.word.eq("Left 1") & table.step.lt(300))  # fmt: skip
    assert chosen(look, studies=("a",)) == list(range(150, COUNT))
    assert chosen(look, studies=("b", "a")) == chosen(look) == list(range(COUNT))
    assert chosen(look, ("word", "=", 3)) == []
    with pytest.raises(StudyError, match="no study 'd'"):
        chosen(look, studies=("a", "d"))
    assert (
        queries.select_rows(StudiesSnapshot(0, (), pa.table({})), RunSelection(("a",))).size
        == 0
    )


def test_columns_have_the_unit_of_the_tables():
    values = {"distance": [0.0, 2e-4, 5e-4, None], "angle": [0.1, 0.2, 0.3, float("nan")],
              "delay": [0.01, 0.02, 0.03, 0.04], "word": ["1", "2", "3", "4"]}  # fmt: skip
    snapshot = StudiesSnapshot(
        1, (), pa.table(values), {"distance": "m", "angle": "rad", "delay": "s", "word": "m"},
        {"distance": "metric", "angle": "metric", "delay": "setting"},
    )  # fmt: skip
    assert [(c["unit"], c["size"]) for c in queries.describe_columns(snapshot)] == [
        ("mm", 1e-3), ("°", pytest.approx(math.pi / 180.0)), ("s", 1.0), ("m", 1.0)]
    for name in ("distance", "angle"):
        numbers = [v for v in values[name] if v is not None]
        column, = (c for c in queries.describe_columns(snapshot) if c["name"] == name)
        assert choose_unit(snapshot.units[name], numbers) == (column["unit"], column["size"])


def test_columns_are_told_with_the_values_of_those_that_take_few(look):
    told = {one["name"]: one for one in queries.describe_columns(look)}
    assert list(told) == look.table.column_names
    assert told["gain"] == {"name": "gain", "unit": "1/s", "size": 1.0,
                            "role": "setting", "kind": "number",
                            "is_binary": False,
                            "count": 4, "known_count": COUNT - 9,
                            "values": [0.25, 1.5, 4.0]}  # fmt: skip
    assert told["word"]["kind"] == told["flag"]["kind"] == "word"
    assert (told["step"]["kind"], told["step"]["count"], told["step"]["values"]) == (
        "number", COUNT, [])  # fmt: skip
    # A script's numbers hold no more digits.
    assert told["seed"]["values"] == [2**53 - 1, 2**53, str(2**53 + 1)]
    assert [told["distance"][key] for key in ("unit", "role", "known_count")] == ["", "", COUNT - 2]
    for count in (60, 61):
        few = StudiesSnapshot(1, (), pa.table({"x": np.arange(count)}))
        (one,) = queries.describe_columns(few)
        assert one["values"] == (list(range(60)) if count == 60 else [])
    assert to_json_value(-np.inf) == "-inf" and to_json_value(np.nan) is None
    assert to_json_value(-(2**53) - 1) == str(-(2**53) - 1) and to_json_value(
        -(2**53)
    ) == -(2**53)


def rows(look, **asked):
    return queries.list_rows(look, RowQuery(**asked))


def test_rows_are_a_part_of_those_in_order(look, table):
    filters = (ColumnFilter("step", "<", 380),)
    mine = table[table.step < 380]
    at = look.table.column_names.index("step")
    for column, descending in itertools.product(
        ("distance", "word", "step"), (False, True)
    ):
        told = rows(look, filters=filters, sort=column, descending=descending, first=4, count=9)
        order = mine.sort_values(column, ascending=not descending, kind="stable")[column]
        found = [row[look.table.column_names.index(column)] for row in told["rows"]]
        assert found == order.tolist()[4:13], column
        assert (told["total"], told["success_count"]) == (380, int(mine.success.sum()))
    plainly = rows(look, filters=filters)["rows"]
    assert [row[at] for row in plainly] == mine.step.tolist()[:50]
    assert len(plainly[0]) == len(look.table.column_names)
    none = rows(look, filters=(ColumnFilter("step", "<", -1),), sort="angle")
    assert none == {"total": 0, "success_count": 0, "rows": []}
    for wrong in ({"count": 0}, {"count": 201}, {"first": -1}):
        with pytest.raises(StudyError):
            build(RowQuery, wrong, "", StudyError)
    asked = build(RowQuery, {"count": 200, "first": 0}, "", StudyError)
    assert (asked.count, asked.first) == (200, 0) and RowQuery().count == 50


def cut(values, **limits):
    return divide_into_cells(pa.chunked_array([pa.array(values)]), **limits)


def test_few_values_have_a_cell_each_and_many_numbers_a_range(look, table):
    for count in (24, 25):
        found = cut(np.r_[np.arange(count)[::-1], 0.5, np.nan][:count + 1].astype(float)[1:])
        assert len(found.labels) == (24 if count == 24 else 12)
    found = cut([3.0, None, 1.0, float("nan"), 3.0])
    assert (found.labels, found.at.tolist(), (found.at < 0).sum()) == (
        [1.0, 3.0],
        [1, -1, 0, -1, 1],
        2,
    )
    assert found.bounds == [[("=", 1.0)], [("=", 3.0)]]
    angle = cut(table.angle)
    wanted = np.linspace(table.angle.min(), table.angle.max(), 13)
    np.testing.assert_allclose(angle.labels, np.column_stack([wanted[:-1], wanted[1:]]))
    for k, bounds in enumerate(angle.bounds):  # each cell's filters choose its own rows
        own = chosen(look, *(("angle", *one) for one in bounds))
        assert own == where(angle.at == k)
    assert [b[1][0] for b in angle.bounds] == ["<"] * 11 + ["≤"] and (angle.at < 0).sum() == 0
    for high, grows in ((100.0, False), (101.0, True)):
        edges = [low for low, _ in cut(np.linspace(1.0, high, 30)).labels] + [high]
        step = np.diff(np.log(edges) if grows else edges)
        np.testing.assert_allclose(step, step[0])
    assert np.ptp(np.diff([low for low, _ in cut(np.linspace(0.0, 1e4, 30)).labels])) < 1e-6


def test_of_many_words_the_commonest_have_cells(table):
    counts = table.name.value_counts()
    assert len(counts) > 60
    for most in (24, 60):
        found = cut(table.name, max_cells=most)
        assert len(found.labels) == most and found.labels == sorted(found.labels)
        sizes = np.bincount(found.at[found.at >= 0])
        assert sizes.tolist() == [counts[name] for name in found.labels]
        assert min(sizes) >= counts.drop(found.labels).max()


def test_groups_are_those_of_pandas(look, table):
    asked = GroupQuery(("a",), (ColumnFilter("step", "<", 350),), by=("word", "gain"),
                                values=("angle", "distance"))  # fmt: skip
    told = queries.compute_groups(look, asked)
    mine = table[(table.study == "a") & (table.step < 350)]
    groups = dict(list(mine.groupby(["word", "gain"])))
    assert told["count"] == len(told["groups"]) == len(groups) > 20
    for one in told["groups"]:
        own = groups.pop(tuple(one["values"]))
        hits = int(own.success.sum())
        assert (one["runs"], one["rate"][0]) == (len(own), hits / len(own))
        middles = own[["angle", "distance"]].replace(np.inf, np.nan).median()
        assert one["estimates"] == [[pytest.approx(m)] for m in middles]
        assert one["bounds"] == [["word", "=", one["values"][0]], ["gain", "=", one["values"][1]]]
        ends = own[own.success != 1].end.fillna("unknown").value_counts()
        assert one["failure"] in ([f"{n} × {end}" for end, n in ends.items() if n == ends.max()]
                                  or [""])  # fmt: skip
    assert groups == {}
    (whole,) = queries.compute_groups(look, GroupQuery())["groups"]
    ends = table[table.success != 1].end.fillna("unknown").value_counts()
    assert whole["failure"] == f"{ends.iloc[0]} × {ends.index[0]}"
    many = queries.compute_groups(look, GroupQuery(by=("name", "word")))
    assert (many["count"], len(many["groups"])) == (
        table.dropna(subset=["word"]).groupby(["name", "word"]).ngroups, 200)  # fmt: skip
    assert many["count"] > 200
    # of 390 values: 12 ranges
    each = queries.compute_groups(look, GroupQuery(by=("step",)))
    assert sum(one["runs"] for one in each["groups"]) == COUNT and each["count"] == 12
    several = queries.compute_groups(
        look, GroupQuery((), (ColumnFilter("step", "<", 200),), ("step",))
    )
    assert several["count"] == 200
    nothing = GroupQuery((), (ColumnFilter("step", "<", -1),), ("gain", "word"), ("angle",))
    assert queries.compute_groups(look, nothing) == {"count": 0, "groups": []}


def test_a_map_s_cells_are_those_of_pandas(look, table):
    for value in ("success", "distance"):
        told = queries.compute_success_map(
            look, MapQuery((), (), x="word", y="gain", value=value)
        )
        assert told["x"]["labels"] == sorted(set(table.word) - {None})
        assert told["y"]["labels"] == [0.25, 1.5, 4.0]
        assert told["uncounted"] == (table.word.isna() | table.gain.isna()).sum()
        places = (enumerate(told[axis]["labels"]) for axis in "yx")
        for (i, gain), (j, word) in itertools.product(*places):
            own = table[(table.gain == gain) & (table.word == word)][value]
            assert told["runs"][i][j] == len(own)
            wanted = own.fillna(0).mean() if value == "success" else \
                own.replace(np.inf, np.nan).median()  # fmt: skip
            assert told["values"][i][j] == (pytest.approx(wanted) if len(own) else None)
    assert MapQuery().value == "success"
    with pytest.raises(StudyError, match="word contains text; choose a column"):
        queries.compute_success_map(look, MapQuery(x="gain", y="gain", value="word"))


def read(text, kind):
    return np.frombuffer(base64.b64decode(text), kind)


def test_points_are_coloured_in_seven_classes(look, table):
    told = queries.find_points(
        look, PointQuery((), (), x="distance", y="word", colour_by="step")
    )
    words = sorted(set(table.word) - {None})
    mine = table[np.isfinite(table.distance) & table.word.notna()]
    assert (told["count"], told["uncounted"]) == (len(mine), COUNT - len(mine))
    assert (told["x"]["labels"], told["y"]["labels"]) == ([], words)
    np.testing.assert_allclose(read(told["x"]["values"], "<f4"), mine.distance, rtol=1e-6)
    assert read(told["y"]["values"], "<f4").tolist() == [words.index(w) for w in mine.word]
    assert read(told["run"], "<i4").tolist() == mine.run.tolist()
    assert [told["studies"][i] for i in read(told["study"], "<i4")] == mine.study.tolist()
    classes = np.array(told["classes"])
    assert classes.shape == (7, 2) and classes[0, 0] == mine.step.min()
    for step, shade in zip(mine.step, read(told["colours"], "u1"), strict=True):
        assert classes[shade, 0] <= step <= classes[shade, 1]
    named = queries.find_points(look, PointQuery(x="angle", y="step", colour_by="name"))
    common = set(table.name.value_counts().index[:7])
    assert len(named["classes"]) == 7 and len(common - set(named["classes"])) <= 1
    assert [(named["classes"] + ["-"])[k] if name in named["classes"] else k
            for name, k in zip(table.name, read(named["colours"], "u1"), strict=True)] == [
        name if name in named["classes"] else 7 for name in table.name]  # fmt: skip
    unshaded = queries.find_points(look, PointQuery(x="angle", y="step"))
    assert unshaded["classes"] == [] and not read(unshaded["colours"], "u1").any()
