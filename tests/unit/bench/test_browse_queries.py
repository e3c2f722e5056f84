"""Queries about synthetic rows, compared with pandas, for every kind of column and every limit."""

import base64
import itertools

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from aras_visual_servo_base.settings import build
from aras_visual_servo_bench.errors import StudyError
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
    table = pa.table(made_columns())
    return StudiesSnapshot(1, studies, table, {"gain": "1/s"}, {"gain": "setting"})


@pytest.fixture(scope="module")
def table():
    return pd.DataFrame(made_columns())


def chosen(look, *filters, studies=()):
    filters = tuple(ColumnFilter(*one) for one in filters)
    return queries.select_rows(look, RunSelection(studies, filters)).tolist()


def where(mask):
    return np.flatnonzero(mask).tolist()


def test_an_operator_compares_as_pandas_does(look, table):
    operators = {"=": "eq", "≠": "ne", "<": "lt", "≤": "le", ">": "gt", "≥": "ge"}
    for column, value in (("gain", 1.5), ("step", 200), ("word", "Left 2"), ("distance", "0.9")):
        known = table[column].notna()
        other = float(value) if column == "distance" else value
        for operator, method in operators.items():
            wanted = getattr(table[column].where(known, other), method)(other) & known
            if column == "distance" and operator == "≠":
                wanted[3] = True  # what is not a number is another
            assert chosen(look, (column, operator, value)) == where(wanted), operator
            assert operator in "=≤≥≠" or 0 < wanted.sum() < COUNT


def test_other_filters_select_what_is_true_known_or_contained(look, table):
    for value, wanted in ((True, True), (1.0, True), ("true", True), ("True", True), (False, False),
                          (0.0, False), ("no", False)):  # fmt: skip
        assert chosen(look, ("flag", "=", value)) == where(table.flag.eq(wanted)), value
        assert chosen(look, ("flag", "≠", value)) == where(table.flag.eq(not wanted)), value
    for column in ("gain", "step", "distance", "word", "flag"):
        known = table[column].notna() & (table[column] != "")
        assert chosen(look, (column, "is known")) == where(known)
        assert chosen(look, (column, "is not known")) == where(~known)
    left = table.word.str.contains("lEFT", case=False, na=False).astype(bool)
    assert chosen(look, ("word", "contains", "lEFT")) == where(left)
    nine = table.step.astype(str).str.contains("9")
    assert chosen(look, ("step", "contains", 9)) == where(nine)
    both = table.word.eq("Left 1") & table.step.lt(300)
    assert chosen(look, ("word", "=", "Left 1"), ("step", "<", 300)) == where(both)
    assert chosen(look, studies=("a",)) == list(range(150, COUNT))
    assert chosen(look, studies=("b", "a")) == chosen(look) == list(range(COUNT))
    assert not chosen(look, ("word", "=", 3))
    assert not chosen(StudiesSnapshot(0, (), pa.table({})), studies=("a",))
    for wrong, studies, why in (
        (("flag", "<", True), (), "flag is true or false; use the operator = or ≠"),
        (("step", "=", "x"), (), "step contains numbers, and 'x' is not a number"),
        (("step", "=", None), (), "step contains numbers, and .* is not a number"),
        (("step", "=", 1), ("a", "d"), "no study 'd'"),
    ):
        with pytest.raises(StudyError, match=why):
            chosen(look, wrong, studies=studies)


def test_columns_are_told_with_their_units_and_the_values_of_those_that_take_few(look):
    values = {"distance": [0.0, 2e-4, 5e-4, None], "angle": [0.1, 0.2, 0.3, float("nan")],
              "delay": [0.01, 0.02, 0.03, 0.04], "word": ["1", "2", "3", "4"]}  # fmt: skip
    snapshot = StudiesSnapshot(
        1, (), pa.table(values), {"distance": "m", "angle": "rad", "delay": "s", "word": "m"},
        {"distance": "metric", "angle": "metric", "delay": "setting"},
    )  # fmt: skip
    assert [(c["unit"], c["size"]) for c in queries.describe_columns(snapshot)] == [
        ("mm", 1e-3), ("°", pytest.approx(np.pi / 180.0)), ("s", 1.0), ("m", 1.0)]
    told = {one["name"]: one for one in queries.describe_columns(look)}
    assert list(told) == look.table.column_names
    assert told["gain"] == {
        "name": "gain", "unit": "1/s", "size": 1.0, "role": "setting", "kind": "number",
        "is_binary": False, "count": 4, "known_count": COUNT - 9, "values": [0.25, 1.5, 4.0],
    }  # fmt: skip
    assert told["word"]["kind"] == told["flag"]["kind"] == "word"
    assert [told["step"][key] for key in ("kind", "count", "values")] == ["number", COUNT, []]
    # A script's numbers hold no more digits.
    assert told["seed"]["values"] == [2**53 - 1, 2**53, str(2**53 + 1)]
    assert [told["distance"][key] for key in ("unit", "role", "known_count")] == ["", "", COUNT - 2]
    for count, listed in ((60, [*range(60)]), (61, [])):
        few = StudiesSnapshot(1, (), pa.table({"x": np.arange(count)}))
        assert queries.describe_columns(few)[0]["values"] == listed
    least = -(2**53)
    assert [to_json_value(v) for v in (-np.inf, np.nan, least - 1, least)] == [
        "-inf", None, str(least - 1), least]  # fmt: skip


def rows(look, **asked):
    return queries.list_rows(look, RowQuery(**asked))


def test_rows_are_a_part_of_those_in_order(look, table):
    filters = (ColumnFilter("step", "<", 380),)
    mine = table[table.step < 380]
    names = look.table.column_names
    for column, descending in itertools.product(("distance", "word", "step"), (False, True)):
        told = rows(look, filters=filters, sort=column, descending=descending, first=4, count=9)
        order = mine.sort_values(column, ascending=not descending, kind="stable")[column]
        assert [row[names.index(column)] for row in told["rows"]] == order.tolist()[4:13], column
        assert (told["total"], told["success_count"]) == (380, int(mine.success.sum()))
    plainly = rows(look, filters=filters)["rows"]
    assert [row[names.index("step")] for row in plainly] == mine.step.tolist()[:50]
    assert len(plainly[0]) == len(names)
    none = rows(look, filters=(ColumnFilter("step", "<", -1),), sort="angle")
    assert none == {"total": 0, "success_count": 0, "rows": []}
    for wrong in ({"count": 0}, {"count": 201}, {"first": -1}):
        with pytest.raises(StudyError):
            build(RowQuery, wrong, "", StudyError)
    assert build(RowQuery, {"count": 200, "first": 0}, "", StudyError).count == 200


def cut(values, **limits):
    return divide_into_cells(pa.chunked_array([pa.array(values)]), **limits)


def test_few_values_have_a_cell_each_and_many_numbers_a_range(look, table):
    for count, cells in ((24, 24), (25, 12)):
        values = np.r_[np.arange(count)[::-1], np.nan].astype(float)
        assert len(cut(values).labels) == cells
    found = cut([3.0, None, 1.0, float("nan"), 3.0])
    assert (found.labels, found.at.tolist()) == ([1.0, 3.0], [1, -1, 0, -1, 1])
    assert found.bounds == [[("=", 1.0)], [("=", 3.0)]]
    angle = cut(table.angle)
    wanted = np.linspace(table.angle.min(), table.angle.max(), 13)
    np.testing.assert_allclose(angle.labels, np.column_stack([wanted[:-1], wanted[1:]]))
    for k, bounds in enumerate(angle.bounds):  # each cell's filters choose its own rows
        assert chosen(look, *(("angle", *one) for one in bounds)) == where(angle.at == k)
    assert cut(np.arange(37.0)).at.tolist() == [min(i // 3, 11) for i in range(37)]
    for low, high, grows in ((1.0, 100.0, False), (1.0, 101.0, True), (0.0, 1e4, False)):
        edges = [a for a, _ in cut(np.linspace(low, high, 30)).labels] + [high]
        step = np.diff(np.log(edges) if grows else edges)
        np.testing.assert_allclose(step, step[0])
    counts = table.name.value_counts()
    for most in (24, 60):  # of more words the commonest have cells
        found = cut(table.name, max_cells=most)
        assert len(found.labels) == most and found.labels == sorted(found.labels)
        sizes = np.bincount(found.at[found.at >= 0])
        assert sizes.tolist() == [counts[name] for name in found.labels]
        assert min(sizes) >= counts.drop(found.labels).max()


def test_groups_are_those_of_pandas(look, table):
    def ask(*filters, **asked):
        filters = tuple(ColumnFilter(*one) for one in filters)
        told = queries.compute_groups(look, GroupQuery(filters=filters, **asked))
        return told["count"], told["groups"]

    def find_failures(rows):
        ends = rows[rows.success != 1].end.fillna("unknown").value_counts()
        return [f"{n} × {end}" for end, n in ends.items() if n == ends.max()] or [""]

    count, told = ask(("step", "<", 350), studies=("a",), by=("word", "gain"),
                      values=("angle", "distance"))  # fmt: skip
    mine = table[(table.study == "a") & (table.step < 350)]
    groups = dict(list(mine.groupby(["word", "gain"])))
    assert count == len(told) == len(groups) > 20
    for one in told:
        own = groups.pop(tuple(one["values"]))
        assert (one["runs"], one["rate"][0]) == (len(own), own.success.sum() / len(own))
        middles = own[["angle", "distance"]].replace(np.inf, np.nan).median()
        assert one["estimates"] == [[pytest.approx(m)] for m in middles]
        assert one["bounds"] == [["word", "=", one["values"][0]], ["gain", "=", one["values"][1]]]
        assert one["failure"] in find_failures(own)
    assert ask()[1][0]["failure"] in find_failures(table)
    count, many = ask(by=("name", "word"))
    assert len(many) == 200 < count == table.dropna(subset="word").groupby(["name", "word"]).ngroups
    for filters, count in (((), 12), ((("step", "<", 200),), 200)):  # 390: ranges
        found, each = ask(*filters, by=("step",))
        assert (found, sum(one["runs"] for one in each)) == (count, 200 if filters else COUNT)
    assert ask(("step", "<", -1), by=("gain", "word"), values=("angle",)) == (0, [])


def test_a_map_s_cells_are_those_of_pandas(look, table):
    for value in ("success", "distance"):
        told = queries.compute_success_map(look, MapQuery(x="word", y="gain", value=value))
        assert told["x"]["labels"] == sorted(set(table.word) - {None})
        assert told["y"]["labels"] == [0.25, 1.5, 4.0]
        assert told["uncounted"] == (table.word.isna() | table.gain.isna()).sum()
        places = (enumerate(told[axis]["labels"]) for axis in "yx")
        for (i, gain), (j, word) in itertools.product(*places):
            own = table[(table.gain == gain) & (table.word == word)][value].replace(np.inf, np.nan)
            wanted = own.fillna(0).mean() if value == "success" else own.median()
            assert told["runs"][i][j] == len(own)
            assert told["values"][i][j] == (pytest.approx(wanted) if len(own) else None)
    with pytest.raises(StudyError, match="word contains text; choose a column"):
        queries.compute_success_map(look, MapQuery(x="gain", y="gain", value="word"))


def read(text, kind):
    return np.frombuffer(base64.b64decode(text), kind)


def test_points_are_coloured_in_seven_classes(look, table):
    told = queries.find_points(look, PointQuery(x="distance", y="word", colour_by="step"))
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
    classes = named["classes"]
    common = set(table.name.value_counts().index[:7])
    assert len(classes) == 7 and len(common - set(classes)) <= 1
    assert read(named["colours"], "u1").tolist() == [
        classes.index(name) if name in classes else 7 for name in table.name]  # fmt: skip
    unshaded = queries.find_points(look, PointQuery(x="angle", y="step"))
    assert unshaded["classes"] == [] and not read(unshaded["colours"], "u1").any()
