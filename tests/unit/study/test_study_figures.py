"""Figures of studies, compared with the rows: groups, names, scales, paths."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from matplotlib.colors import to_hex
from scipy.stats import binomtest, spearmanr

from aras_visual_servo_bench.plots import distributions, palette, study_figures
from aras_visual_servo_bench.studies.results import Results
from aras_visual_servo_bench.studies.study import Study

SETTLED, DISTANCE = "settled", "final_distance"


def made(name="one", gains=(1.0, 2.5), delays=(0.03, 0.11), each=3, seed=0, **columns):
    """Results of a grid, `each` runs a point; the first point fails, half of the second."""
    rng = np.random.default_rng(seed)
    points = [(g, d) for g in gains for d in delays for _ in range(each)]
    count = len(points)
    study = Study.from_mapping({
        "experiment": {"plant": "free"}, "repeats": each, "metrics": ["success", SETTLED, DISTANCE],
        "vary": {"gain": list(gains), "delay": list(delays)},
    })  # fmt: skip
    table = {
        "run": list(range(count)), "gain": [g for g, _ in points], "delay": [d for _, d in points],
        "success": [float(i >= each and (i - seed) % 4 > 0) for i in range(count)],
        "outcome": ["x"] * count, SETTLED: rng.uniform(1.0, 2.0, count).tolist(),
        DISTANCE: rng.permutation(np.geomspace(0.1, 200.0, count)).tolist(),
        "real_time_multiple": [9.0] * count,
    }  # fmt: skip
    return Results(name, study, pa.table({**table, **columns}))


@pytest.fixture(autouse=True)
def one_look():
    with study_figures.apply_style():
        yield


def texts(found):
    return [text.get_text() for text in found]


def in_the_middle(text):
    """Return whether a text is centred in its cell, in letters of 9 points."""
    return (text.get_ha(), text.get_va(), text.get_fontsize()) == ("center", "center", 9.0)


def has_grid(lines):
    return any(line.get_visible() for line in lines)


def test_maps_of_several_studies_stand_beside_each_other():
    both = [made(), made("$two", seed=1)]
    figure = study_figures.draw_success(both)
    *axes, distance, bar = figure.axes
    assert distance.get_ylabel() == "runs below (%)" and len(distance.lines) == 4
    assert distance.get_xlabel().startswith("final distance (m)\nA camera is at its goal within")
    assert [axis.get_title("left") or axis.get_title() for axis in axes] == ["one", r"\$two"]
    assert [axis.get_xlabel() for axis in axes] == ["delay (s)"] * 2
    assert [axis.get_ylabel() for axis in axes] == ["gain (1/s)", ""]
    assert bar.get_ylabel() == "runs with success (%)"
    for axis, results in zip(axes, both, strict=True):
        image = axis.images[0]
        assert image.get_clim() == (0.0, 100.0)
        assert not has_grid([*axis.get_xgridlines(), *axis.get_ygridlines()])
        assert texts(axis.get_xticklabels()) == ["0.03", "0.11"]
        told = {text.get_position(): text for text in axis.texts}
        hits = np.reshape(results.read_column("success"), (2, 2, 3))
        for (j, i), text in told.items():
            assert text.get_text() == f"{int(hits[i, j].sum())}/3" and in_the_middle(text)
            assert image.get_array()[i, j] == pytest.approx(100 * hits[i, j].mean())
            ground = image.cmap(image.norm(image.get_array()[i, j]))
            assert palette.contrast_ratio(palette.to_rgb(text.get_color()), ground) >= 4.5
        assert len(told) == 4
    assert texts(axes[0].get_yticklabels()) == ["1", "2.5"]
    # 0.9 inch a column, three at least; 0.55 a line, 1.6 at least; and what stands around them;
    # two panels, the map and the distances
    for gains, delays, size in ((2, 2, (2 * 4.1, 3.0)), (5, 6, (2 * 6.5, 4.15))):
        grid = made(gains=tuple(1.0 + np.arange(gains)), delays=tuple(0.1 * np.arange(delays)))
        assert study_figures.draw_success([grid]).get_size_inches() == pytest.approx(size)
    assert figure.get_size_inches() == pytest.approx((3 * 3.0 + 2.2, 3.0))
    lacks = made(gains=(1.0, 4.0))
    shown = study_figures.draw_success([made(), lacks]).axes[0].images[0].get_array()
    assert np.isnan(np.asarray(shown)[2]).all() and np.isfinite(np.asarray(shown)[:2]).all()


def bars(results):
    """Names and per cents, from the top."""
    axis = study_figures.draw_success(results).axes[0]
    assert axis.get_xlim() == (0.0, 103.0)
    order = np.argsort([-bar.get_y() for bar in axis.patches])
    names = dict(zip(axis.get_yticks().tolist(), texts(axis.get_yticklabels()), strict=True))
    assert list(names) == list(range(len(names)))[::-1]
    return list(names.values()), [axis.patches[i].get_width() for i in order], axis


def test_bars_have_the_names_of_what_differs():
    names, rates, axis = bars([made(delays=(0.03,))])
    assert names == ["1", "2.5"] and axis.get_title("left") == "Success by gain (1/s)"
    assert rates == pytest.approx([0.0, 100 * 2 / 3])
    assert has_grid(axis.get_xgridlines()) and not has_grid(axis.get_ygridlines())
    spans = [path.vertices for path in axis.collections[0].get_paths()]
    for (low, high), hits in zip((path[:, 0] for path in spans), (0, 2), strict=True):
        wanted = binomtest(hits, 3).proportion_ci(0.95, "wilson")
        assert (low, high) == pytest.approx((100 * wanted.low, 100 * wanted.high))
    assert [path[0, 1] for path in spans] == [1.0, 0.0]
    assert [axis.figure.get_figheight() for *_, axis in (
        bars([made(gains=tuple(1.0 + np.arange(n)), delays=(0.03,))]) for n in (2, 7))
    ] == pytest.approx([0.42 * n + 1.5 for n in (2, 7)])
    names, rates, axis = bars([made(gains=(1.0,), delays=(0.03,), each=4)])
    assert names == ["one"] and axis.get_title("left") == "Success" and rates == [0.0]
    names, *_ = bars([made(delays=(0.03,)), made("$two", delays=(0.03,))])
    assert names == ["one 1", "one 2.5", r"\$two 1", r"\$two 2.5"]
    names, *_ = bars([made(gains=(1.0,), delays=(0.03,)), made("two", (1.0,), (0.03,))])
    assert names == ["one", "two"]


def test_groups_beside_each_other_are_named_and_few():
    results = made()
    metrics = results.select_metrics([SETTLED, DISTANCE])
    figure = study_figures.draw_distributions([results], metrics)
    names = [f"gain {g} 1/s, delay {d} s" for g in ("1", "2.5") for d in ("0.03", "0.11")]
    assert texts(figure.legends[0].get_texts()) == names
    figure.draw_without_rendering()  # in lines of three
    assert len({round(text.get_window_extent().x0) for text in figure.legends[0].get_texts()}) == 3
    first, second = figure.axes
    assert (first.get_ylabel(), second.get_ylabel()) == ("runs below (%)", "")
    assert (first.get_xscale(), second.get_xscale()) == ("linear", "log")
    assert first.get_ylim() == (0.0, 103.0)
    for line, (_, rows) in zip(
        first.lines, results.group_rows(("gain", "delay")).items(), strict=True
    ):
        known = np.sort(results.read_numbers(SETTLED)[rows])
        np.testing.assert_array_equal(line.get_xdata(), [known[0], *known])
        assert line.get_drawstyle() == "steps-post"
    for gains, count in ((4, 8), (5, 5)):  # more than eight curves are of one key
        many = made(gains=tuple(np.arange(gains) + 1.0), each=1)
        drawn = study_figures.draw_distributions([many], many.select_metrics([SETTLED]))
        looks = {(line.get_color(), line.get_linestyle()) for line in drawn.axes[0].lines}
        assert len(drawn.axes[0].lines) == len(looks) == count
    alone = made(gains=(1.0,), delays=(0.03,))
    assert not study_figures.draw_distributions([alone], alone.select_metrics([SETTLED])).legends
    assert study_figures.draw_distributions([alone], ()) is None
    for gains, count in ((12, 24), (13, 13)):
        many = made(gains=tuple(np.arange(gains) + 1.0), each=2)
        figure = study_figures.draw_boxes([many], many.select_metrics([SETTLED, DISTANCE]))
        assert len(figure.axes[0].patches) == count
        named = [list(filter(None, texts(axis.get_yticklabels()))) for axis in figure.axes]
        assert len(named[0]) == count and named[1] == []
        # 0.3 inch a box, and what stands around them.
        assert figure.get_size_inches() == pytest.approx((2 * 3.8, 0.3 * count + 1.4))
    figure = study_figures.draw_boxes([results], metrics)
    for axis in figure.axes:
        assert has_grid(axis.get_xgridlines()) and not has_grid(axis.get_ygridlines())
    first = figure.axes[0]
    medians = [line.get_xdata()[0] for line in first.lines if line.get_color() == palette.VERMILION]
    parts = [
        results.read_numbers(SETTLED)[rows]
        for rows in results.group_rows(("gain", "delay")).values()
    ]
    assert medians == pytest.approx([np.median(part) for part in parts][::-1])
    assert {to_hex(box.get_facecolor()) for box in first.patches} == {palette.PALE_BLUE}
    outside = made(gains=(1.0, 2.0), delays=(0.03,), each=12, **{
        SETTLED: [1.0 + 0.01 * i for i in range(11)] + [9.0] + [2.0] * 12})  # fmt: skip
    shown = study_figures.draw_boxes([outside], outside.select_metrics([SETTLED])).axes[0]
    (dot,) = [line for line in shown.lines if line.get_marker() == "." and len(line.get_xdata())]
    assert (dot.get_xdata().tolist(), dot.get_ydata().tolist()) == ([9.0], [2.0])
    assert dot.get_markeredgecolor() == palette.SOFT_INK
    assert texts(figure.axes[0].get_yticklabels()) == names[::-1]
    assert [axis.get_xlabel() for axis in figure.axes] == ["settled (s)", "final distance (m)"]
    assert study_figures.draw_boxes([alone], alone.select_metrics([SETTLED])) is None
    assert study_figures.draw_boxes([results], ()) is None


def test_an_axis_is_logarithmic_beyond_two_decades():
    for low, high, scale in ((1.0, 100.0, "linear"), (1.0, 100.5, "log"), (0.0, 1e4, "linear"),
                             (-1.0, 1e4, "linear")):  # fmt: skip
        _, (axis,) = study_figures.make_axes(1, 2.0)
        distributions.set_scale(axis, "x", [np.array([low, np.nan]), np.array([high, np.inf])])
        assert axis.get_xscale() == scale
    distributions.set_scale(axis, "x", [np.array([np.nan])])
    assert axis.get_xscale() == "linear"
    for side, few in (("x", True), ("y", False)):  # labels below each other are never too many
        figure, (axis,) = study_figures.make_axes(1, 6.0)
        axis.set(xlim=(0.0, 8.5), ylim=(0.0, 8.5))
        distributions.set_scale(axis, side, [np.array([1.0, 2.0])])
        assert (len(getattr(axis, f"get_{side}ticks")()) <= 7) == few


def test_correlations_are_of_settings_that_take_three_values():
    gains = (1.0, 2.0, 3.0)
    settled = [1.0, 2.0, 2.5, 3.0, 4.0, 5.0]
    results = made(gains=gains, each=1, **{
        SETTLED: settled, DISTANCE: [6.0, np.nan, np.nan, np.nan, 2.0, 3.0]})  # fmt: skip
    figure = study_figures.draw_sensitivity(results, results.select_metrics([]))
    axis, bar = figure.axes
    assert texts(axis.get_xticklabels()) == ["gain"]  # of delays there are two
    assert texts(axis.get_yticklabels()) == [SETTLED, DISTANCE]
    (text,) = axis.texts  # of three runs nothing follows
    assert text.get_position() == (0, 0) and in_the_middle(text)
    rank = np.corrcoef(np.repeat([1, 2, 3], 2), np.argsort(np.argsort(settled)))[0, 1]
    assert text.get_text() == f"{rank:+.2f}"
    assert axis.images[0].get_clim() == (-1.0, 1.0) and "Spearman" in bar.get_ylabel()
    assert not has_grid([*axis.get_xgridlines(), *axis.get_ygridlines()])
    blue, white, red = (np.array(axis.images[0].cmap(at)[:3]) for at in (0.0, 0.5, 1.0))
    assert white.min() > 0.95 and blue.argmax() == 2 and red.argmax() == 0
    assert figure.get_size_inches() == pytest.approx((1.1 + 3.6, 0.38 * 2 + 1.6))
    assert axis.get_xticklabels()[0].get_rotation() == 0.0
    ground = axis.images[0].cmap(0.5 + 0.5 * rank)
    assert palette.contrast_ratio(palette.to_rgb(text.get_color()), ground) >= 4.5
    assert study_figures.draw_sensitivity(results, ()) is None
    assert study_figures.draw_sensitivity(made(), made().select_metrics([])) is None
    few = made(gains=gains, delays=(0.03,), each=1)
    assert study_figures.draw_sensitivity(few, few.select_metrics([])) is None  # three runs


def traced(name, run, count, seed, lost=()):
    """A study's folder of paths that are known, as far as a figure looks at it."""
    rng = np.random.default_rng(seed)
    rows = len(run)
    error = rng.uniform(0.1, 2.0, (rows, 2))
    error[list(lost)] = np.nan
    pose = np.tile(np.eye(4), (rows, 1, 1))
    pose[:, :3, 3] = rng.normal(size=(rows, 3))
    stamp = 7.0 + rng.random(rows).cumsum()
    table = pa.table({"run": list(run), "stamp": stamp.tolist(), "error": error.tolist(),
                      "pose": pose.reshape(rows, 16).tolist()})  # fmt: skip
    folder = SimpleNamespace(path=Path("/") / name, study=SimpleNamespace(traces=bool(count)),
                             read_results=lambda kind: table)  # fmt: skip
    return folder, table


def test_trajectories_are_the_errors_and_places_of_every_run(monkeypatch):
    runs = np.repeat([4, 5, 9], [6, 4, 5])
    made_of = {Path("a"): traced("$a", runs, 1, 0, lost=(0, *range(6, 10))),
               Path("b"): traced("b", runs[:6], 1, 1), Path("c"): traced("c", runs, 0, 2)}
    monkeypatch.setattr(study_figures.StudyFolder, "open", lambda path: made_of[path][0])
    figure = study_figures.draw_trajectories(list(made_of))
    errors, above, beside = figure.axes
    table = made_of[Path("a")][1]
    stamp, error = np.array(table["stamp"]), np.array(table["error"].to_pylist())
    place = np.array(table["pose"].to_pylist()).reshape(-1, 4, 4)[:, :3, 3]
    for k, rows in enumerate((slice(0, 6), slice(10, 15))):  # run 5 never saw its target
        line = errors.lines[k]
        np.testing.assert_allclose(line.get_xdata(), stamp[rows] - stamp[rows][0])
        norm = np.hypot(*error[rows].T)
        np.testing.assert_allclose(line.get_ydata(), norm / norm[np.isfinite(norm)][0])
        for axis, at in ((above, (0, 1)), (beside, (0, 2))):
            np.testing.assert_allclose(np.transpose(axis.lines[2 * k].get_data()),
                                       place[rows][:, at])  # fmt: skip
            np.testing.assert_allclose(np.ravel(axis.lines[2 * k + 1].get_data()),
                                       place[rows][-1, at])  # fmt: skip
    assert len(errors.lines) == 3 and len(above.lines) == len(beside.lines) == 6
    assert errors.get_yscale() == "log"
    for line in (errors.lines[0], above.lines[0], beside.lines[0]):  # others show through it
        assert (line.get_alpha(), line.get_linewidth()) == (0.5, 0.7)
    dot = above.lines[1]
    assert (dot.get_marker(), dot.get_markersize(), dot.get_color()) == (".", 4.0, palette.INK)
    assert texts(errors.get_legend().get_texts()) == [r"\$a", "b"]
    assert errors.lines[2].get_color() != errors.lines[0].get_color() == errors.lines[1].get_color()
    assert [axis.get_xlabel() for axis in figure.axes][1:] == ["x (m)", "x (m)"]
    assert [axis.get_ylabel() for axis in figure.axes][1:] == ["y (m)", "z (m)"]
    assert above.get_aspect() == beside.get_aspect() == 1.0
    assert study_figures.draw_trajectories([Path("c")]) is None
    assert study_figures.draw_trajectories([Path("b")]).axes[0].get_legend() is None
    many = traced("m", range(450), 1, 3)
    made_of[Path("m")] = many
    assert len(study_figures.draw_trajectories([Path("m")]).axes[0].lines) == 225  # every second


def test_pictures_are_of_what_varies_or_of_what_is_asked_for(tmp_path, monkeypatch):
    results = made(**{SETTLED: [1.5] * 12})
    seen = {}
    for name in ("draw_success", "draw_distributions", "draw_boxes", "draw_sensitivity",
                 "draw_trajectories"):
        monkeypatch.setattr(
            study_figures, name, lambda *asked, name=name: seen.update({name: asked})
        )
    assert study_figures.write_figures([results], tmp_path / "out", paths=["there"]) == []
    assert seen["draw_success"] == ([results],) and seen["draw_trajectories"] == (["there"],)
    assert seen["draw_sensitivity"][0] is results
    for name in ("draw_distributions", "draw_boxes", "draw_sensitivity"):
        assert [m.name for m in seen[name][1]] == [DISTANCE]
    study_figures.write_figures([results, made("two")], tmp_path)
    assert [m.name for m in seen["draw_boxes"][1]] == [SETTLED, DISTANCE]
    study_figures.write_figures([results], tmp_path, metrics=[SETTLED, "real_time_multiple"])
    assert [m.name for m in seen["draw_boxes"][1]] == [SETTLED, "real_time_multiple"]
    unknown = made(**{SETTLED: [1.0, np.nan] * 6, DISTANCE: [np.nan] * 12})
    study_figures.write_figures([unknown], tmp_path)
    assert seen["draw_boxes"][1] == []


def test_bars_and_boxes_have_room_between_them_and_fine_lines_around():
    """Bars and boxes take two thirds of their lines at most; what is beside them is finer."""
    axis = bars([made(delays=(0.03,))])[2]
    for bar in axis.patches:
        assert bar.get_height() == pytest.approx(0.65)
        assert to_hex(bar.get_facecolor()) == palette.BLUE
    (spans,) = axis.collections
    assert to_hex(spans.get_color()[0]) == palette.INK and spans.get_linewidth()[0] == 1.1
    caps = [line for line in axis.lines if line.get_marker() == "|"]
    assert len(caps) == 2 and {line.get_markersize() for line in caps} == {6.0}  # 3 to each side
    assert axis.get_xlabel() == "runs with success (%), Wilson's 95 % interval"
    assert axis.figure.get_figwidth() == 2 * 4.4
    alone = made(delays=(0.03,))
    alone = Results("one", alone.study, alone.table.drop_columns([DISTANCE]))
    assert bars([alone])[2].figure.get_figwidth() == 6.5

    results = made()
    axis = study_figures.draw_boxes([results], results.select_metrics([SETTLED])).axes[0]
    assert [np.ptp(box.get_path().vertices[:, 1]) for box in axis.patches] == [
        pytest.approx(0.6)] * 4  # fmt: skip
    assert {to_hex(box.get_edgecolor()) for box in axis.patches} == {palette.BLUE}
    medians = [line for line in axis.lines if line.get_color() == palette.VERMILION]
    others = [line for line in axis.lines if line.get_color() == palette.BLUE]
    assert {line.get_linewidth() for line in medians} == {1.6}
    assert (len(medians), len(others)) == (4, 16)  # of each box two whiskers and two caps
    dots = [line for line in axis.lines if line.get_marker() == "."]
    assert len(dots) == 4 and {line.get_markersize() for line in dots} == {4.0}


def test_colour_bars_are_a_little_shorter_than_their_maps():
    results = made(gains=(1.0, 2.0, 3.0))
    for figure in (
        study_figures.draw_success([results]),
        study_figures.draw_sensitivity(results, results.select_metrics([])),
    ):
        figure.draw_without_rendering()
        axis, *_, bar = (one.get_position().height for one in figure.axes)
        assert bar / axis == pytest.approx(0.9, abs=0.005)


def test_correlations_want_four_runs_and_numbers_that_vary():
    gains = (1.0, 2.0, 3.0, 5.0)
    four = made(gains=gains, delays=(0.03,), each=1, **{SETTLED: [1.0, 4.0, 3.0, 7.0]})
    axis = study_figures.draw_sensitivity(four, four.select_metrics([SETTLED])).axes[0]
    assert [text.get_text() for text in axis.texts] == ["+0.80"]  # 1 - 6 (1 + 1) / (4 * 15)
    same = made(gains=gains, delays=(0.03,), each=1, **{SETTLED: [2.0] * 4})
    assert not study_figures.draw_sensitivity(same, same.select_metrics([SETTLED])).axes[0].texts

    # Both settings are numbers of four values; one metric a line, one setting a column.
    both = made(gains=gains, delays=(0.01, 0.02, 0.04, 0.08), each=1)
    figure = study_figures.draw_sensitivity(both, both.select_metrics([SETTLED, DISTANCE]))
    assert figure.get_size_inches() == pytest.approx((2 * 1.1 + 3.6, 2 * 0.38 + 1.6))
    axis = figure.axes[0]
    assert texts(axis.get_xticklabels()) == ["gain", "delay"]
    told = {text.get_position(): text.get_text() for text in axis.texts}
    for i, name in enumerate((SETTLED, DISTANCE)):
        for j, key in enumerate(("gain", "delay")):
            rank = spearmanr(both.read_column(key), both.read_column(name)).statistic
            assert told[j, i] == f"{rank:+.2f}"
    assert axis.get_title("left") == "Correlation of metrics and settings"
    words = made(gains=("a", "b", "c", "d"), delays=(0.03,), each=1)
    assert study_figures.draw_sensitivity(words, words.select_metrics([SETTLED])) is None


@pytest.mark.parametrize(("count", "turn"), [(3, 0.0), (4, 20.0)])
def test_names_of_many_settings_are_turned(count, turn):
    keys = ("gain", "delay", "duration", "time_after_convergence")[:count]
    rng = np.random.default_rng(3)
    study = Study.from_mapping({
        "experiment": {"plant": "free"}, "repeats": 5, "metrics": [SETTLED],
        "vary": {key: {"uniform": [0.1, 0.2]} for key in keys},
    })  # fmt: skip
    table = {"run": list(range(5)), SETTLED: rng.uniform(size=5),
             **{key: rng.uniform(0.1, 0.2, 5) for key in keys}}  # fmt: skip
    results = Results("many", study, pa.table(table))
    labels = (
        study_figures.draw_sensitivity(results, results.select_metrics([SETTLED]))
        .axes[0]
        .get_xticklabels()
    )
    assert texts(labels) == list(keys) and {label.get_rotation() for label in labels} == {turn}
