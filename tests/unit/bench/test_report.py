"""Report: correct numbers, curves with units for any scheme, one page, clear errors."""

import errno
import json
import os
import re
import signal
import threading
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.errors import BenchError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.metrics import summary
from aras_visual_servo_bench.metrics.condition_number import compute_condition_numbers
from aras_visual_servo_bench.plots import style
from aras_visual_servo_bench.plots.panel import Curve
from aras_visual_servo_bench.recording.camera_record import CameraRecord
from aras_visual_servo_bench.recording.image_tracks import find_milestones, find_nearest
from aras_visual_servo_bench.recording.run import compute_settling_time
from aras_visual_servo_bench.recording.run_recorder import describe_settings
from aras_visual_servo_bench.studies.replay import run_with_images
from aras_visual_servo_bench.web import SHARED
from aras_visual_servo_bench.web.report import page as page_text
from aras_visual_servo_bench.web.report.write import CHAPTERS, write_report

FIGURES = {part.name: part.draw_figure for row in CHAPTERS for part in row}


@pytest.fixture(scope="module")
def moments():
    return run_with_images(
        Experiment(plant="chain", duration=3.0, time_after_convergence=None), "moments")


@pytest.fixture(scope="module")
def points():
    return run_with_images({
        "plant": "free", "target": {"shape": "square", "size": [0.1, 0.1]},
        "scheme": "numbered_points", "start": {"pose": [0.05, -0.03, 0.4, 3.14159, 0.0, 0.5]},
        "goal": {"pose": [0.0, 0.0, 0.25, 3.14159, 0.0, 0.0]}, "duration": 3.0,
        "time_after_convergence": None,
    }, "points")  # fmt: skip


@pytest.fixture(scope="module")
def unmeasured(points):
    """A run without measurements and joints, of which few figures are drawn."""
    states = tuple(replace(s, phase="idle", scheme_output=None) for s in points.states)
    return keep_joints(replace(points, states=states), 0)


def keep_joints(run, count):
    """Return the run with its first joints only."""
    names = ("measured_positions", "measured_velocities", "joint_commands")
    return replace(run, joint_names=run.joint_names[:count],
                   **{name: getattr(run, name)[:, :count] for name in names})


@pytest.fixture(scope="module")
def dollars(moments):
    """A run whose names have dollars, which are no formulas."""
    names = tuple(rf"$\input{{{i}}}$" for i in range(len(moments.names)))
    states = tuple(
        replace(state, scheme_output=replace(state.scheme_output, names=names))
        if state.scheme_output else state for state in moments.states)
    return replace(moments, states=states, units=("$x$", *moments.units[1:]),
                   joint_names=("$^$", *moments.joint_names[1:]))  # fmt: skip


def test_settling_time_wants_the_error_to_stay_small():
    stamp = np.arange(6.0)
    size = np.array([1.0, 0.01, 0.5, 0.01, 0.015, 0.0])
    assert compute_settling_time(stamp, size) == 3.0
    assert compute_settling_time(stamp, size[[0, 1, 1, 1, 1, 0]]) == np.inf
    assert compute_settling_time(stamp, np.zeros(6)) == 0.0


def test_condition_is_the_largest_over_the_smallest_singular_value_of_each_image():
    singular = np.array([[4.0, 2.0, np.nan], [9.0, 3.0, 1.0], [np.nan] * 3, [1.0, 0.0, np.nan]])
    np.testing.assert_array_equal(compute_condition_numbers(singular), [2.0, 9.0, np.nan, np.inf])
    assert np.isnan(compute_condition_numbers(np.zeros((3, 0)))).all()


def test_words_tell_a_failure_with_reason_and_remedy(moments):
    found = summary.summarise(moments)
    assert all(q.text for q in found)
    mapping = summary.make_mapping(moments, found)
    assert json.loads(json.dumps(mapping)) == mapping and mapping["converged"] is True
    assert set(mapping["definitions"]) == {q.key for q in found}

    def describe(**changes):
        changed = replace(moments, **changes)
        return summary.describe_run(changed, summary.summarise(changed))

    servoing = tuple(replace(state, phase="servoing") for state in moments.states)
    told = describe(states=servoing, outcome="target_lost", reason="over the left border",
                    remedy="begin nearer")  # fmt: skip
    assert "NO: target_lost (over the left border)" in told and "begin nearer" in told
    assert "yes, and held" in describe()
    # it is held at the goal all the same
    assert "yes, and held; yet wrong_camera_model" in describe(outcome="wrong_camera_model")
    told = describe(reason="as shown; yet", remedy="calibrate")
    assert "yes, and held; as shown; yet\n" in told and "calibrate" in told


def column(*numbers):
    return [summary.Quantity("settled", numbers[0], "s", "-", "smaller"),
            summary.Quantity("images", numbers[1], "", "-"),
            summary.Quantity("overshoot", numbers[0], "", "-", "smaller", is_feature_based=True)]


def test_the_best_of_each_row_is_marked_once_it_differs_in_print(moments, points):
    columns = [column(1.0, 3), column(0.5, 9), column(0.50000001, 9)]
    runs, best = [moments] * 3, summary.find_best_runs
    assert best(runs, columns, "settled") == {1, 2}
    assert best(runs, columns, "images") == set()
    assert best(runs[1:], columns[1:], "settled") == set()
    assert best(runs, [[replace(q[0], better="greater")] for q in columns], "settled") == {0}
    assert best([moments] * 4, [*columns, column(np.nan, 1)], "settled") == {1, 2}
    # No run that failed is best: one that ended 82 mm off had a star for its overshoot.
    columns = [column(0.1, 3), column(0.5, 9), column(0.7, 9)]
    off = replace(moments, verdict=replace(moments.verdict, name="goal_missed", distance=0.082))
    for failed in (off, replace(moments, outcome="target_lost")):
        for key in ("settled", "overshoot"):
            assert best([failed, moments, moments], columns, key) == {1}
            assert best([failed, moments, failed], columns, key) == set()
    unknown = replace(moments, verdict=replace(moments.verdict, name=""))  # the goal's pose
    assert best([unknown, moments, off], columns, "settled") == {0}
    # What is of the features has a best only within a scheme.
    columns = columns[:2]
    assert best([moments, points], columns, "overshoot") == set()
    assert best([moments, points], columns, "settled") == {0}
    assert best([moments, moments], columns, "overshoot") == {0}
    of_features = {q.key for q in summary.summarise(moments) if q.is_feature_based}
    assert of_features == {"overshoot", "decay_rate", "error_settled", "condition_L",
                           "smallest_singular_value", "manipulability"}  # fmt: skip


def test_a_row_of_the_comparison_is_in_one_notation():
    row = [summary.Quantity("a", value, "m", "-") for value in (0.00141, 2.5e-5, np.nan)]
    assert summary.format_quantities([*row, None]) == ["0.00141", "0.000025", "–", "–"]
    other = [replace(row[0], value=value) for value in ("word", 7)]
    assert summary.format_quantities(other) == ["word", "7"]


def test_pictures_are_chosen_by_what_is_left_of_the_error(moments):
    decision = moments.states[0].scheme_output
    short = replace(moments, states=tuple(
        replace(moments.states[0], stamp=float(stamp), scheme_output=replace(decision, error=error))
        for stamp, error in enumerate(np.outer([1.0, 0.9, 0.5, 0.15, 0.01, 0.01], [1, 0, 0, 0]))))
    assert find_milestones(short) == [0.0, 2.0, 3.0, 4.0, 5.0]
    blind = tuple(replace(state, scheme_output=None) for state in short.states)
    assert find_milestones(replace(short, states=blind)) == [0.0, 5.0]
    nearest = find_nearest(np.array([0.0, 1.0, 4.0]), np.array([-1, 0.6, 2.4, 9]))
    assert nearest.tolist() == [0, 1, 1, 2]


def test_a_curve_is_open_where_nothing_was_measured():
    time, values = np.r_[0.0:1.0:0.1, 4.0:4.5:0.1], np.arange(15.0)
    at, shown = Curve("", time, values).insert_gaps()
    assert np.isnan(shown[10]) and 0.9 < at[10] < 4.0 and (np.diff(at) > 0).all()
    np.testing.assert_array_equal(shown[np.isfinite(shown)], values)
    for whole in (np.arange(5.0), np.r_[0.0:1.0:0.1, 1.2], np.zeros(1)):  # slow, one lost, one
        np.testing.assert_array_equal(Curve("", whole, whole).insert_gaps(), (whole, whole))
    for gap, opened in ((0.98, False), (1.02, True)):  # five steps of 0.2 s
        time = np.cumsum([0.0, 0.2, 0.2, gap, 0.2, 0.2])
        assert np.isnan(Curve("", time, time).insert_gaps()[1]).any() == opened


@pytest.mark.filterwarnings("error:Glyph")
def test_the_report_is_one_page_that_needs_nothing_else(dollars, tmp_path):
    run, told = replace(dollars, notes=["the bag was <not> closed"]), []
    written = write_report([run], tmp_path, ("png",), progress=lambda part, _: told.append(part))
    page = (tmp_path / "report.html").read_text()
    assert written[0] == tmp_path / "report.html"
    assert not re.findall(r'(?:src|href)="(?!data:|#)|@import|url\((?!data:)', page)
    assert set(re.findall(r"https?://[\w./-]+", page)) == {"https://github.com/leeoniya/uPlot"}
    assert "the bag was &lt;not&gt; closed" in page
    parts = {part.name for row in CHAPTERS for part in row if part.panels([run])}
    assert parts == set(re.findall(r'<section id="(\w+)"[^>]*>.*\n<div class="panels">', page))
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == set(FIGURES)
    np.testing.assert_allclose(told, np.linspace(0.0, 1.0, len(CHAPTERS) + 3))
    assert len(set(written)) == len(written) == len(FIGURES) + 5 and all(
        p.is_file() for p in written)
    scripts = [path.read_text() for path in page_text.SCRIPTS]
    assert len(scripts) == 4 and all(text in page for text in scripts)
    assert (SHARED / "style.css").read_text() in page


@pytest.mark.parametrize(("threads", "cores", "kinds", "copied"), [
    (1, 2, ("png", "svg"), True), (2, 2, ("png", "svg"), False), (1, 1, ("png", "svg"), False),
    (1, 2, ("svg",), False)])  # fmt: skip
def test_copies_of_the_process_draw_where_that_is_safe_and_saves_time(
    threads, cores, kinds, copied, unmeasured, tmp_path, monkeypatch):
    monkeypatch.setattr(threading, "active_count", lambda: threads)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)))

    def save(figure, path, format, metadata):
        path.write_text(str(os.getpid()))

    monkeypatch.setattr(Figure, "savefig", save)
    written = write_report([unmeasured], tmp_path, kinds)
    figures = list((tmp_path / "figures").iterdir())
    drew = {int(path.read_text()) for path in figures}
    assert len(drew) == 2 and os.getpid() not in drew if copied else drew == {os.getpid()}
    assert {*figures} <= {*written} and len(written) == len({*written})
    drawn = {*FIGURES} - {"features", "feature_errors", "joint_positions"}
    assert {path.name for path in figures} == {f"{n}.{kind}" for n in drawn for kind in kinds}


@pytest.mark.parametrize(("fault", "told"), [
    ("full", r"cannot write the report into .*: No space left"),
    ("killed", "probably because of too little memory")])  # fmt: skip
def test_a_process_that_cannot_draw_says_so_and_nothing_hangs(
        fault, told, unmeasured, tmp_path, monkeypatch):
    monkeypatch.setattr(threading, "active_count", lambda: 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    parent = os.getpid()

    def save(figure, path, **how):
        assert os.getpid() != parent
        if fault == "full":
            raise OSError(errno.ENOSPC, "No space left on device")
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(Figure, "savefig", save)
    with pytest.raises(BenchError, match=told):
        write_report([unmeasured], tmp_path, ("png", "svg"))


def test_headers_say_settings_in_plain_words_with_units(points, tmp_path):
    """They had CameraPoseSpec(pose=(0.06, …))."""
    assert points.settings["start"] == (
        "camera at x 0.05, y -0.03, z 0.4 m, roll 180°, pitch 0°, yaw 28.65°")
    asked = points.experiment.with_changes(
        start={"height": [0.15, 0.5], "side": 0.1, "turn": 0.5236}, camera={"width": 320})
    told = describe_settings(asked)
    assert told["start"] == "random, camera 0.15 to 0.5 m above the target and up to 0.1 m to " \
        "the side, rotated by up to 30°"  # fmt: skip
    assert told["camera"] == "own settings"
    assert describe_settings(asked.with_changes(start=[0.1, -0.2]))["start"] == "joints 0.1 -0.2"
    faster = replace(points, settings=describe_settings(asked.with_changes(gain=2.0)))
    for run, shown in ((points, False), (faster, True)):
        write_report([run], tmp_path, ())
        text = (tmp_path / "report.html").read_text()
        header = re.search('<p class="meta">(.*?)</p>', text)[1]
        assert ("gain 2 1/s" in header) is shown and ("delay 0.015 s" in header) is not shown
        assert bool(re.search(r">gain<.{,40}>2 1/s<", text)) is shown


@pytest.mark.parametrize("paper", [False, True])
@pytest.mark.parametrize("draw", FIGURES.values(), ids=FIGURES)
@pytest.mark.filterwarnings("error:Glyph")
def test_nothing_of_a_figure_is_cut_off_or_lies_on_a_legend(draw, paper, dollars):
    """Names of runs are as long as a user's, with dollars; a paper's column is 3.5 inches wide."""
    if draw == FIGURES["joint_positions"]:
        dollars = keep_joints(dollars, 2)
    runs = [replace(dollars, name=f"$moments, gain {1.5 * i:g} and filter") for i in range(5)]
    with style.apply_style(paper):
        # `write_report` draws those of a single run for the screen, above
        if alone := paper and draw(runs[:1]):
            alone.draw_without_rendering()
        figure = draw(runs)
        if figure is None:
            return
        alone = any(len(row) == 1 and row[0].draw_figure == draw for row in CHAPTERS)
        assert figure.get_figwidth() == (3.5 if paper else style.WIDE_FIGURE if alone else 7.2)
        figure.draw_without_rendering()
        width, height = figure.get_size_inches() * figure.dpi
        flat = [axis for axis in figure.axes if axis.get_visible() and axis.name != "3d"]
        legends = [axis.get_legend() for axis in figure.axes if axis.get_legend()]
        legends += figure.legends
        for box in [*(axis.get_tightbbox() for axis in flat),
                    *(legend.get_window_extent() for legend in legends)]:  # fmt: skip
            assert box.x0 >= -1.0 and box.x1 <= width + 1.0
            assert box.y0 >= -1.0 and box.y1 <= height + 1.0
        for axis in flat:
            assert axis.has_data()
            labels = (axis.xaxis.label, axis.yaxis.label, axis.title)
            for box in (legend.get_window_extent() for legend in legends):
                for label in [text for text in labels if text.get_text() and text.get_visible()]:
                    assert not box.overlaps(label.get_window_extent()), label.get_text()
            for legend in legends:
                assert axis.get_legend() is legend or not legend.get_window_extent().overlaps(
                    axis.get_window_extent())  # fmt: skip
        plt.close("all")


@pytest.mark.parametrize(("name", "later", "pace"), [
    ("late", 100.0, 1.0), ("unknown", 0.1, np.nan), ("one", 0.5, 0.98)])
def test_a_pace_without_a_curve_leaves_no_empty_panel(moments, name, later, pace):
    """Real-time factors come once a second: a short run has none, or one, of its own."""
    factors = np.array([[moments.start_stamp + later, pace]])
    with style.apply_style():
        figure = FIGURES["timing"]([replace(moments, real_time_factors=factors)])
    labels = [axis.get_ylabel() for axis in figure.axes]
    (dots,) = figure.axes[0].lines
    assert (dots.get_linestyle(), dots.get_marker()) == ("None", ".")
    assert ("real-time factor" in labels) == (name == "one")
    if name == "one":
        (line,) = figure.axes[-1].lines
        assert line.get_marker() == "." and list(line.get_xdata()) == pytest.approx([0.5])
    plt.close("all")


def test_a_delay_below_zero_is_shown_and_explained(moments, tmp_path):
    stamp = moments.stamp
    early = replace(moments, cameras={"camera": CameraRecord(None, stamp, stamp - 0.13)})
    write_report([early], tmp_path, ())
    told = (tmp_path / "report.html").read_text()
    assert "A negative delay means that an image arrived before the clock message" in told


def test_figures_for_a_paper_are_vectors_a_column_wide(points, tmp_path, monkeypatch):
    """Of all figures one is drawn into its files."""
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **how: save(
        figure, path, **how) if path.stem == "features" else path.touch())
    write_report([points], tmp_path, ("svg", "png", "pdf"), paper=True)
    files = {path.name for path in (tmp_path / "figures").iterdir()}
    assert files == {f"{name}.{kind}" for name in FIGURES for kind in ("svg", "pdf")}
    assert 'width="252pt"' in (tmp_path / "figures" / "features.svg").read_text()  # 3.5 inches
    assert b"/Type3" not in (tmp_path / "figures" / "features.pdf").read_bytes()


@pytest.mark.parametrize(("words", "complaint"), [
    (["cut.bag"], "cut.bag.active"),  # what a recorder without a disk leaves
    (["none.bag", "--formats", "gif"], "unknown format 'gif'"),
    (["none.bag", "--names", "a,b"], "2 names for 1 runs")])  # fmt: skip
def test_what_cannot_be_analyzed_is_one_line(words, complaint, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cut.bag.active").write_bytes(b"no bag")
    assert main(["analyze", *words, "--out", "out"]) == 1
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
