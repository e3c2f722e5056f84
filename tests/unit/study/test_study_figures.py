"""Figures of studies, compared with the rows: groups, names, scales, paths."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.plots import distributions, palette, study_figures
from aras_visual_servo_bench.studies import run_rows as study_rows
from aras_visual_servo_bench.studies.results import Results
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_folder import StudyFolder

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


def test_an_axis_is_logarithmic_beyond_two_decades():
    for low, high, scale in ((1.0, 100.0, "linear"), (1.0, 100.5, "log"), (0.0, 1e4, "linear"),
                             (-1.0, 1e4, "linear"), (np.nan, np.nan, "linear")):  # fmt: skip
        _, (axis,) = study_figures.make_axes(1, 2.0)
        distributions.set_scale(axis, "x", [np.array([low, np.nan]), np.array([high, np.inf])])
        assert axis.get_xscale() == scale
    for side, few in (("x", True), ("y", False)):  # labels below each other are never too many
        _, (axis,) = study_figures.make_axes(1, 6.0)
        axis.set(xlim=(0.0, 8.5), ylim=(0.0, 8.5))
        distributions.set_scale(axis, side, [np.array([1.0, 2.0])])
        assert (len(getattr(axis, f"get_{side}ticks")()) <= 7) == few


def trace(path, run, seed, traces=True, lost=()):
    """Store a study with known paths, and return their table."""
    rng = np.random.default_rng(seed)
    study = Study.from_mapping({"experiment": {"plant": "free"}, "repeats": int(max(run)) + 1,
                                "traces": traces, "chunk": 1000})  # fmt: skip
    table = []
    for k, (number, stamp) in enumerate(zip(run, 7.0 + rng.random(len(run)).cumsum(), strict=True)):
        pose = np.eye(4)
        pose[:3, 3] = rng.normal(size=3)
        error = np.full(2, np.nan) if k in lost else rng.uniform(0.1, 2.0, 2)
        table.append({"run": int(number), "stamp": stamp, "error": error.tolist(),
                      "pose": pose.ravel().tolist()})  # fmt: skip
    done = [study_rows.make_blank_row(study, n) for n in range(study.run_count)]
    StudyFolder.create(path, study, "").write_chunk(0, study_rows.RunRows(done, [], table))
    return table


def test_trajectories_are_the_errors_and_places_of_every_run(tmp_path):
    runs = np.repeat([4, 5, 9], [6, 4, 5])
    a, b, c = (tmp_path / name for name in ("$a", "b", "c"))
    table = trace(a, runs, 0, lost=(0, *range(6, 10)))
    trace(b, runs[:6], 1)
    trace(c, runs, 2, traces=False)
    errors, above, beside = study_figures.draw_trajectories([a, b, c]).axes
    stamp, error = (np.array([row[name] for row in table]) for name in ("stamp", "error"))
    place = np.array([row["pose"] for row in table]).reshape(-1, 4, 4)[:, :3, 3]
    for k, part in enumerate((slice(0, 6), slice(10, 15))):  # run 5 never saw its target
        line = errors.lines[k]
        np.testing.assert_allclose(line.get_xdata(), stamp[part] - stamp[part][0])
        norm = np.hypot(*error[part].T)
        np.testing.assert_allclose(line.get_ydata(), norm / norm[np.isfinite(norm)][0])
        for axis, at in ((above, (0, 1)), (beside, (0, 2))):
            np.testing.assert_allclose(np.transpose(axis.lines[2 * k].get_data()),
                                       place[part][:, at])  # fmt: skip
            np.testing.assert_allclose(np.ravel(axis.lines[2 * k + 1].get_data()),
                                       place[part][-1, at])  # fmt: skip
    assert len(errors.lines) == 3 and len(above.lines) == len(beside.lines) == 6
    assert errors.get_yscale() == "log"
    assert texts(errors.get_legend().get_texts()) == [r"\$a", "b"]
    assert errors.lines[2].get_color() != errors.lines[0].get_color() == errors.lines[1].get_color()
    assert [(axis.get_xlabel(), axis.get_ylabel()) for axis in (above, beside)] == [
        ("x (m)", "y (m)"), ("x (m)", "z (m)")]
    assert above.get_aspect() == beside.get_aspect() == 1.0
    assert study_figures.draw_trajectories([c]) is None
    assert study_figures.draw_trajectories([b]).axes[0].get_legend() is None
    trace(tmp_path / "m", range(450), 3)
    assert len(study_figures.draw_trajectories([tmp_path / "m"]).axes[0].lines) == 225


def test_pictures_are_of_what_varies_or_of_what_is_asked_for(tmp_path, monkeypatch):
    """A paper has a file per metric."""
    monkeypatch.setattr(Figure, "savefig", lambda _, path: path.touch())

    def boxes(*results, **keys):
        written = study_figures.write_figures(results, tmp_path, ("svg",), is_paper=True, **keys)
        return {path.stem[6:] for path in written if path.stem.startswith("boxes_")}

    judged = {"verdict": ["goal_reached"] * 12, "distance_tolerance": [0.01] * 12,
              "angle_tolerance": [0.1] * 12}  # fmt: skip
    same = made(**{SETTLED: [1.5] * 12}, **judged)
    assert boxes(same) == {DISTANCE}
    assert boxes(same, made("two", **judged)) == {SETTLED, DISTANCE}
    assert boxes(same, metrics=[SETTLED]) == {SETTLED}
    unknown = made(**{SETTLED: [1.0, np.nan] * 6, DISTANCE: [np.nan] * 12}, **judged)
    assert boxes(unknown) == set()
    with pytest.raises(StudyError, match="unknown format 'gif'"):
        study_figures.write_figures([same], tmp_path, ("gif",))


def test_correlations_want_four_runs_and_numbers_that_vary():
    gains = (1.0, 2.0, 3.0, 5.0)
    four = made(gains=gains, delays=(0.03,), each=1, **{SETTLED: [1.0, 4.0, 3.0, 7.0]})
    axis = study_figures.draw_sensitivity(four, four.select_metrics([SETTLED])).axes[0]
    assert texts(axis.texts) == ["+0.80"]  # 1 - 6 (1 + 1) / (4 * 15)
    assert axis.images[0].get_clim() == (-1.0, 1.0)
    ground = axis.images[0].cmap(0.9)
    assert palette.contrast_ratio(palette.to_rgb(axis.texts[0].get_color()), ground) >= 4.5
    two = made(gains=gains, each=1)  # of delays there are two
    axis = study_figures.draw_sensitivity(two, two.select_metrics([SETTLED])).axes[0]
    assert texts(axis.get_xticklabels()) == ["gain"]
    few = made(gains=gains[:3], delays=(0.03,), each=1)
    assert study_figures.draw_sensitivity(few, few.select_metrics([])) is None
    same = made(gains=gains, delays=(0.03,), each=1, **{SETTLED: [2.0] * 4})
    assert not study_figures.draw_sensitivity(same, same.select_metrics([SETTLED])).axes[0].texts

    # Both settings are numbers of four values; one metric a line, one setting a column.
    both = made(gains=gains, delays=(0.01, 0.02, 0.04, 0.08), each=1)
    figure = study_figures.draw_sensitivity(both, both.select_metrics([SETTLED, DISTANCE]))
    axis = figure.axes[0]
    assert texts(axis.get_xticklabels()) == ["gain", "delay"]
    told = {text.get_position(): text.get_text() for text in axis.texts}
    for i, name in enumerate((SETTLED, DISTANCE)):
        for j, key in enumerate(("gain", "delay")):
            rank = spearmanr(both.read_column(key), both.read_column(name)).statistic
            assert told[j, i] == f"{rank:+.2f}"
    words = made(gains=("a", "b", "c", "d"), delays=(0.03,), each=1)
    assert study_figures.draw_sensitivity(words, words.select_metrics([SETTLED])) is None
