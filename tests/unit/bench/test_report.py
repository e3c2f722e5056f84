"""Report: correct numbers, curves with units for any scheme, one page, clear errors."""

import errno
import html
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
from aras_visual_servo_bench.metrics import metrics, summary
from aras_visual_servo_bench.metrics.condition_number import compute_condition_numbers
from aras_visual_servo_bench.plots import style
from aras_visual_servo_bench.plots.panel import Curve
from aras_visual_servo_bench.plots.time_plots import make_curve_styles
from aras_visual_servo_bench.recording.camera_record import CameraRecord
from aras_visual_servo_bench.recording.image_tracks import (
    find_milestones,
    find_nearest,
)
from aras_visual_servo_bench.recording.run import compute_settling_time
from aras_visual_servo_bench.recording.run_recorder import describe_settings
from aras_visual_servo_bench.studies.replay import run_with_all_images, run_with_images
from aras_visual_servo_bench.web import SHARED
from aras_visual_servo_bench.web.report import page as page_text
from aras_visual_servo_bench.web.report.write import CHAPTERS, write_report

SECONDS = 3.0
FIGURES = {part.name: part.draw_figure for row in CHAPTERS for part in row}
CHAPTER_NAMES = tuple(FIGURES)
DRAWN = [name for name in CHAPTER_NAMES if name != "image_strip"]


@pytest.fixture(scope="module")
def moments():
    """Run of the scheme `moments` on an arm without dynamics, with exact features."""
    return run_with_images(
        Experiment(plant="chain", duration=SECONDS, time_after_convergence=None), "moments"
    )


@pytest.fixture(scope="module")
def points():
    """Run of four points of a square with a free camera."""
    return run_with_images({
        "plant": "free", "target": {"shape": "square", "size": [0.1, 0.1]},
        "scheme": "numbered_points", "start": {"pose": [0.05, -0.03, 0.4, 3.14159, 0.0, 0.5]},
        "goal": {"pose": [0.0, 0.0, 0.25, 3.14159, 0.0, 0.0]}, "duration": SECONDS,
        "time_after_convergence": None,
    }, "points")  # fmt: skip


def values(record):
    return {q.key: q.value for q in summary.summarise(record)}


# -- numbers --------------------------------------------------------------------------------


def test_the_numbers_are_those_of_the_studies():
    experiment = Experiment(plant="chain", duration=1.0, time_after_convergence=None)
    run = run_with_all_images(experiment)
    found = values(run_with_images(experiment, "again"))
    for name, metric in metrics.METRICS.items():
        assert found[name] == pytest.approx(metric.measure(run), abs=0.0, nan_ok=True), name
    assert [stamp for stamp, _ in run.control_record.images] == run.stamp.tolist()


def test_summary_says_how_it_ended_with_units_and_definitions(moments):
    found = {q.key: q for q in summary.summarise(moments)}
    assert (found["outcome"].value, found["verdict"].value) == ("converged", "goal_reached")
    assert 0.3 < found["settled"].value < 2.0 and found["settled"].unit == "s"
    assert abs(found["final_error_xn"].value) < 1e-3 and found["final_error_xn"].unit == "m"
    assert found["final_error_alpha"].unit == "rad"
    assert found["image_rate"].value == pytest.approx(30.0, abs=0.01)
    assert abs(found["images"].value - 30 * SECONDS) <= 2 and found["images_late"].value == 0
    assert all(q.text for q in found.values())
    told = summary.make_mapping(moments, list(found.values()))
    assert json.loads(json.dumps(told)) == told and told["converged"] is True
    assert told["units"]["settled"] == "s" and set(told["definitions"]) == set(found)


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
    lost = replace(
        moments, states=tuple(replace(state, phase="servoing") for state in moments.states),
        outcome="target_lost", reason="over the left border", remedy="begin nearer",
    )  # fmt: skip
    told = summary.describe_run(lost, summary.summarise(lost))
    assert "NO: target_lost (over the left border)" in told and "begin nearer" in told
    assert "yes, and held" in summary.describe_run(moments, summary.summarise(moments))
    doubted = replace(moments, outcome="wrong_camera_model")
    assert doubted.is_held_at_goal  # it is held at the goal all the same
    told = summary.describe_run(doubted, summary.summarise(doubted))
    assert "yes, and held; yet wrong_camera_model" in told
    noted = replace(moments, reason="as shown; yet", remedy="calibrate")
    told = summary.describe_run(noted, summary.summarise(noted))
    assert "yes, and held; as shown; yet\n" in told and "calibrate" in told


def column(*numbers):
    return [summary.Quantity("settled", numbers[0], "s", "-", "smaller"),
            summary.Quantity("images", numbers[1], "", "-"),
            summary.Quantity("overshoot", numbers[0], "", "-", "smaller", is_feature_based=True),
            ]  # fmt: skip


def test_the_best_of_each_row_is_marked_once_it_differs_in_print(moments):
    columns = [column(1.0, 3), column(0.5, 9), column(0.50000001, 9)]
    runs = [moments] * 3
    assert summary.find_best_runs(runs, columns, "settled") == {1, 2}
    assert summary.find_best_runs(runs, columns, "images") == set()
    assert summary.find_best_runs(runs[1:], columns[1:], "settled") == set()
    better = [[replace(q[0], better="greater")] for q in columns]
    assert summary.find_best_runs(runs, better, "settled") == {0}
    assert summary.find_best_runs([moments] * 4, [*columns, column(np.nan, 1)], "settled") == {1, 2}


def test_no_run_that_failed_is_best(moments):
    """A run that ended 82 mm off had a star for its overshoot."""
    columns = [column(0.1, 3), column(0.5, 9), column(0.7, 9)]
    off = replace(moments, verdict=replace(moments.verdict, name="goal_missed", distance=0.082))
    lost = replace(moments, outcome="target_lost")
    for failed in (off, lost):
        for key in ("settled", "overshoot"):
            assert summary.find_best_runs([failed, moments, moments], columns, key) == {1}
            assert summary.find_best_runs([failed, moments, failed], columns, key) == set()
    unknown = replace(moments, verdict=replace(moments.verdict, name=""))  # the goal's pose
    assert summary.find_best_runs([unknown, moments, off], columns, "settled") == {0}


def test_what_is_of_the_features_has_a_best_only_within_a_scheme(moments, points):
    columns = [column(0.1, 3), column(0.5, 9)]
    assert moments.is_success and points.is_success
    assert summary.find_best_runs([moments, points], columns, "overshoot") == set()
    assert summary.find_best_runs([moments, points], columns, "settled") == {0}
    assert summary.find_best_runs([moments, moments], columns, "overshoot") == {0}
    other = replace(moments, states=tuple(replace(s, scheme="another") for s in moments.states))
    assert summary.find_best_runs([moments, other], columns, "overshoot") == set()
    of_features = {q.key for q in summary.summarise(moments) if q.is_feature_based}
    assert of_features == {"overshoot", "decay_rate", "error_settled", "condition_L",
                           "smallest_singular_value", "manipulability"}  # fmt: skip


def test_a_row_of_the_comparison_is_in_one_notation():
    row = [summary.Quantity("a", value, "m", "-") for value in (0.00141, 2.5e-5, np.nan)]
    assert summary.format_quantities([*row, None]) == ["0.00141", "0.000025", "–", "–"]
    assert summary.format_quantities([replace(row[0], value="word"), replace(row[0], value=7)]) == [
        "word",
        "7",
    ]


# -- what happened in the image --------------------------------------------------------------


def test_pictures_are_chosen_by_what_is_left_of_the_error(moments):
    decision = moments.states[0].scheme_output
    short = replace(moments, states=tuple(
        replace(moments.states[0], stamp=float(stamp), scheme_output=replace(decision, error=error))
        for stamp, error in enumerate(np.outer([1.0, 0.9, 0.5, 0.15, 0.01, 0.01], [1, 0, 0, 0]))
    ))  # fmt: skip
    assert find_milestones(short) == [0.0, 2.0, 3.0, 4.0, 5.0]
    blind = tuple(replace(state, scheme_output=None) for state in short.states)
    assert find_milestones(replace(short, states=blind)) == [0.0, 5.0]
    np.testing.assert_array_equal(find_nearest(np.array([0.0, 1.0, 4.0]),
        np.array([-1, 0.6, 2.4, 9])),
                                  [0, 1, 1, 2])  # fmt: skip


# -- figures ---------------------------------------------------------------------------------


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


@pytest.mark.parametrize("paper", [False, True])
@pytest.mark.filterwarnings("error:Glyph")
def test_both_looks_have_the_letters_of_a_logarithmic_axis(paper, tmp_path):
    with style.apply_style(paper):
        figure, (axis,) = style.make_axes(1, 1.5)
        axis.semilogy([0.0, 1.0], [1e-4, 1.0])
        style.format_log_axis(axis)
        label = axis.yaxis.get_major_formatter()
        assert paper or [label(value, 0) for value in (1e-4, 1.0, 1e12)] == ["10⁻⁴", "10⁰", "10¹²"]
        figure.savefig(tmp_path / "x.pdf")
        plt.close("all")


def test_what_settled_is_marked_in_its_own_curve(moments):
    """The features' errors settle later here than the camera: each figure says its own time."""
    camera, errors = metrics.settled.measure(moments), metrics.error_settled.measure(moments)
    assert abs(camera - errors) > 0.01
    for draw, settled in ((FIGURES["pose_errors"], camera), (FIGURES["feature_errors"], errors)):
        with style.apply_style():
            figure = draw([moments])
            said = [text.get_text() for axis in figure.axes for text in axis.texts]
        plt.close(figure)
        assert f"settled after {settled:.2f} s" in said


@pytest.mark.parametrize("draw", FIGURES.values(), ids=CHAPTER_NAMES)
def test_a_name_with_dollars_is_drawn_as_it_stands(draw, moments, points):
    name = r"$\input{x}$"
    names = tuple(f"{name}{i}" for i in range(len(moments.names)))
    states = tuple(
        replace(
            state, scheme_output=state.scheme_output and replace(state.scheme_output, names=names)
        )
        for state in moments.states
    )
    joints = (name, *moments.joint_names[1:])
    hostile = replace(
        moments, name=name, states=states, joint_names=joints, units=("$x$", *moments.units[1:])
    )
    with style.apply_style():
        for records in ([hostile], [hostile, replace(points, name="$^$")]):
            figure = draw(records)
            if figure is not None:
                figure.draw_without_rendering()
                assert all(a.has_data() for a in figure.axes if a.get_visible())
        plt.close("all")


# -- files -----------------------------------------------------------------------------------


def test_the_report_is_one_page_that_needs_nothing_else(moments, tmp_path):
    moments.notes.append("the bag was <not> closed")
    told, words = [], []
    try:
        written = write_report([moments], tmp_path, ("png",), progress=lambda part, what: (
            told.append(part), words.append(what)))  # fmt: skip
    finally:
        moments.notes.clear()
    page = (tmp_path / "report.html").read_text()
    assert written[0] == tmp_path / "report.html"
    assert not re.findall(r'(?:src|href)="(?!data:|#)|@import|url\((?!data:)', page)
    assert set(re.findall(r"https?://[\w./-]+", page)) == {"https://github.com/leeoniya/uPlot"}
    assert "the bag was &lt;not&gt; closed" in page
    parts = {part.name for row in CHAPTERS for part in row if part.panels([moments])}
    assert parts == set(re.findall(r'<section id="(\w+)"[^>]*>.*\n<div class="panels">', page))
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == set(CHAPTER_NAMES)
    np.testing.assert_allclose(told, np.linspace(0.0, 1.0, len(CHAPTERS) + 3))
    assert words[:2] == ["numbers", "page"] and words[-1] == "done"
    assert words[2:-1] == [" and ".join(part.title.lower() for part in row) for row in CHAPTERS]
    assert len(set(written)) == len(written) == len(CHAPTER_NAMES) + 5 and all(
        p.is_file() for p in written
    )
    for row in (("feature_errors", "pose_errors"), ("conditioning", "timing")):
        drawn = [plt.imread(tmp_path / "figures" / f"{name}.png") for name in row]
        assert drawn[0].shape == drawn[1].shape  # they stand beside each other
    scripts = [path.read_text() for path in page_text.SCRIPTS]
    assert len(scripts) == 4 and all(text in page for text in scripts)
    assert (SHARED / "style.css").read_text() in page
    for row in CHAPTERS:
        for part in row:
            assert part.name not in parts or part.text in html.unescape(page)


@pytest.mark.parametrize(("threads", "cores", "kinds", "copied"), [
    (1, 2, ("png", "svg"), True), (2, 2, ("png", "svg"), False), (1, 1, ("png", "svg"), False),
    (1, 2, ("svg",), False),
])  # fmt: skip
def test_copies_of_the_process_draw_where_that_is_safe_and_saves_time(
    threads, cores, kinds, copied, points, tmp_path, monkeypatch
):
    """Where no other thread runs and there are several files a figure; each figure once."""
    monkeypatch.setattr(threading, "active_count", lambda: threads)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)))

    def save(figure, path, format, metadata):
        path.write_text(str(os.getpid()))

    monkeypatch.setattr(Figure, "savefig", save)
    written = write_report([points], tmp_path, kinds)
    figures = list((tmp_path / "figures").iterdir())
    drew = {int(path.read_text()) for path in figures}
    assert len(drew) == 2 and os.getpid() not in drew if copied else drew == {os.getpid()}
    assert {*figures} <= {*written} and len(written) == len({*written})
    assert {path.name for path in figures} == {f"{n}.{kind}" for n in DRAWN for kind in kinds}


@pytest.mark.parametrize(("fault", "told"), [
    ("full", "No space left on device"), ("killed", "probably because of too little memory"),
])  # fmt: skip
def test_a_process_that_cannot_draw_says_so_and_nothing_hangs(
    fault, told, points, tmp_path, monkeypatch
):
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
        write_report([points], tmp_path, ("png", "svg"))


def test_headers_say_settings_in_plain_words_with_units(points, tmp_path):
    """They had CameraPoseSpec(pose=(0.06, …))."""
    settings = points.settings
    assert settings["start"] == (
        "camera at x 0.05, y -0.03, z 0.4 m, roll 180°, pitch 0°, yaw 28.65°"
    )
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


def test_runs_are_told_apart_without_colour_and_none_hides_another():
    with style.apply_style(is_paper=True):
        five = make_curve_styles(5)
    assert make_curve_styles(1) == [{"color": make_curve_styles(1)[0]["color"]}]
    assert len({one["marker"] for one in five}) == 5
    assert len({one["markevery"] for one in five}) == 5
    widths = [one["lw"] for one in five]
    assert widths == sorted(widths, reverse=True) and widths[0] > 1.5 * widths[-1]
    many = make_curve_styles(30)
    assert len({(one["color"], one["marker"]) for one in many}) == 30


@pytest.mark.parametrize(("count", "paper"), [(5, False), (5, True)])
@pytest.mark.parametrize("draw", FIGURES.values(), ids=CHAPTER_NAMES)
def test_nothing_of_a_figure_is_cut_off_or_lies_on_a_legend(draw, count, paper, moments):
    """Names of runs are as long as a user's; a paper's column is 3.5 inches wide."""
    runs = [replace(moments, name=f"moments, gain {1.5 * i:g} and filter") for i in range(count)]
    with style.apply_style(paper):
        figure = draw(runs)
        if figure is None:
            return
        alone = any(len(row) == 1 and row[0].draw_figure == draw for row in CHAPTERS)
        assert figure.get_figwidth() == (3.5 if paper else style.WIDE_FIGURE if alone else 7.2)
        figure.draw_without_rendering()
        width, height = figure.get_size_inches() * figure.dpi
        spatial = any(axis.name == "3d" for axis in figure.axes)
        for axis in [] if spatial else [a for a in figure.axes if a.get_visible()]:
            assert axis.has_data()
            box = axis.get_tightbbox()
            assert box.x0 >= -1.0 and box.x1 <= width + 1.0
            assert box.y0 >= -1.0 and box.y1 <= height + 1.0
        legends = [axis.get_legend() for axis in figure.axes if axis.get_legend()]
        for legend in [*legends, *figure.legends]:
            box = legend.get_window_extent()
            for axis in figure.axes if spatial else ():
                for label in (axis.xaxis.label, axis.yaxis.label, axis.zaxis.label):
                    place = label.get_window_extent()
                    assert place.x0 >= 0.0 and place.x1 <= width and not box.overlaps(place)
            assert box.x0 >= -1.0 and box.x1 <= width + 1.0
            assert box.y0 >= -1.0 and box.y1 <= height + 1.0
            for axis in [] if spatial else [a for a in figure.axes if a.get_visible()]:
                labels = [*axis.get_xticklabels(), *axis.get_yticklabels(), axis.xaxis.label,
                          axis.yaxis.label, axis.title]  # fmt: skip
                inside = axis.get_window_extent()
                for label in [t for t in labels if t.get_text() and t.get_visible()]:
                    place = label.get_window_extent()
                    hidden = label in labels[:-3] and not (  # a tick beyond the axis' end
                        inside.y0 - 40 < 0.5 * (place.y0 + place.y1) < inside.y1 + 1)
                    assert hidden or not box.overlaps(place), label.get_text()
                if axis.get_legend() is not legend:
                    other = axis.get_window_extent()
                    assert not box.overlaps(other)
        plt.close("all")


def test_a_pace_without_a_curve_leaves_no_empty_panel(moments):
    """Real-time factors come once a second: a short run has none, or one, of its own."""
    paces = {
        "late": [[moments.start_stamp + 100.0, 1.0]],
        "unknown": [[moments.start_stamp + 0.1, np.nan]],
        "one": [[moments.start_stamp + 0.5, 0.98]],
    }  # fmt: skip
    for name, pace in paces.items():
        with style.apply_style():
            figure = FIGURES["timing"]([replace(moments, real_time_factors=np.array(pace))])
            labels = [axis.get_ylabel() for axis in figure.axes]
            (dots,) = figure.axes[0].lines
            assert (dots.get_linestyle(), dots.get_marker()) == ("None", ".")

            assert ("real-time factor" in labels) == (name == "one"), name
            if name == "one":
                (line,) = figure.axes[-1].lines
                assert line.get_marker() == "." and list(line.get_xdata()) == pytest.approx([0.5])
            plt.close("all")


def test_a_delay_below_zero_is_shown_and_explained(moments, tmp_path):
    stamp = moments.stamp
    early = replace(moments, cameras={"camera": CameraRecord(None, stamp, stamp - 0.13)})
    with style.apply_style():
        labels = [axis.get_ylabel() for axis in FIGURES["timing"]([early]).axes]
        assert "delay (ms)" in labels
        plt.close("all")
    write_report([early], tmp_path, ())
    told = (tmp_path / "report.html").read_text()
    assert "A negative delay means that an image arrived before the clock message" in told
    assert "negative if" in metrics.delay.source


def test_several_runs_are_compared_with_the_best_marked(moments, points, tmp_path):
    write_report([moments, replace(points, name="<points>")], tmp_path, ())
    page = (tmp_path / "report.html").read_text()
    assert 'id="comparison"' in page and 'class="number best"' in page
    compared = page.partition('id="comparison"')[2].partition("</section>")[0]
    assert "settled" in compared
    # What one run alone has is no comparison.
    assert "final_error_alpha" not in compared and "final_error_x0" not in compared
    assert "&lt;points&gt;" in page and "<points>" not in page
    told = json.loads((tmp_path / "summary.json").read_text())
    assert [one["name"] for one in told] == ["moments", "<points>"]
    assert {path.name for path in (tmp_path / "data").iterdir()} == {
        f"{run}_{kind}.csv" for run in (1, 2) for kind in ("images", "joints")}  # fmt: skip


def test_figures_for_a_paper_are_vectors_a_column_wide(points, tmp_path):
    write_report([points], tmp_path, ("png", "svg", "pdf"), paper=True)
    files = {path.name for path in (tmp_path / "figures").iterdir()}
    assert files == {f"{name}.{kind}" for name in DRAWN for kind in ("svg", "pdf")}
    assert 'width="252pt"' in (tmp_path / "figures" / "features.svg").read_text()  # 3.5 inches
    assert b"/Type3" not in (tmp_path / "figures" / "features.pdf").read_bytes()


def test_a_full_disk_is_one_clear_line(points, tmp_path, monkeypatch):
    def full(*_, **how):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", full)
    with pytest.raises(BenchError, match=r"cannot write the report into .*: No space left"):
        write_report([points], tmp_path, ("png",))
    with pytest.raises(BenchError, match="unknown format 'jpg': use one of png, svg, pdf"):
        write_report([points], tmp_path, ("jpg",))


# -- command ---------------------------------------------------------------------------------


def test_an_experiments_file_is_run_and_reported(tmp_path, capsys):
    file = tmp_path / "quick.yaml"
    file.write_text("{plant: free, duration: 0.4, time_after_convergence: null}\n")
    out = tmp_path / "out"
    assert main(["analyze", str(file), "--out", str(out), "--formats", "svg"]) == 0
    told = capsys.readouterr().out
    assert "quick:" in told and str(out / "report.html") in told
    assert (out / "figures" / "features.svg").is_file()


@pytest.mark.parametrize(("words", "complaint"), [
    (["none.bag"], "there is no file none.bag"),
    (["cut.bag"], "cut.bag.active"),  # what a recorder without a disk leaves
    (["."], "has no run.bag; for a run of a study give .:NUMBER"),
    (["none.bag", "--formats", "gif"], "unknown format 'gif'"),
    (["none.bag", "--names", "a,b"], "2 names for 1 runs"),
])  # fmt: skip
def test_what_cannot_be_analyzed_is_one_line(words, complaint, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cut.bag.active").write_bytes(b"no bag")
    assert main(["analyze", *words, "--out", "out"]) == 1
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
