"""Appearance of figures: line widths, colours, drawing order and margins.

A reader has to tell what was measured, the boldest, from what helps to read it. All widths and
letters are in points, margins in inches.
"""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from made_run import GOAL, made_run
from matplotlib.colors import to_hex, to_rgb

from aras_visual_servo_bench.plots import palette, style, views
from aras_visual_servo_bench.plots.panels import Curve, Panel
from aras_visual_servo_bench.plots.time_plots import Layout, draw_panels, make_curve_styles
from aras_visual_servo_bench.recording.film import with_images


@pytest.fixture(scope="module")
def runs():
    """Two runs: the first with full-size images, the second without images."""
    first = made_run(3, 1.6)
    shown = np.full((400, 640, 3), 90, np.uint8)
    return [with_images(first, [(float(s), shown) for s in first.stamp[:-20:30]]),
            made_run(4, 2.3)]  # fmt: skip


def check(artist, **look):
    """Check the style of a drawn object; colours in any notation."""
    for name, value in look.items():
        found = getattr(artist, f"get_{name}")()
        if "color" in name and found != "none":
            found, value = to_rgb(found), to_rgb(value)
        assert found == pytest.approx(value) if isinstance(value, float) else found == value, name


# -- both looks -----------------------------------------------------------------------------------


@pytest.mark.parametrize("paper", [False, True])
def test_a_look_is_that_of_its_page(paper):
    """A paper's letters are in 8 points, ticks and legends in 7, and its lines are finer; on a
    screen titles stand out, and a grid is finer than a curve. Neither has a box round its axes."""
    with style.apply_style(paper):
        figure, axis = plt.subplots()
        (line,) = axis.plot([0.0, 1.0], [0.0, 1.0], label="curve")
        (other,) = axis.plot([0.0, 1.0], [1.0, 0.0], "o")
        axis.set(title="Title", xlabel="x")
        legend = axis.legend(ncols=2)
        figure.draw_without_rendering()
        size = 8.0 if paper else 10.0
        assert figure.get_size_inches() == pytest.approx((3.5, 2.4) if paper else (7.2, 4.5))
        assert figure.dpi == 110 and plt.rcParams["savefig.dpi"] == 150
        check(figure, facecolor="white")
        check(line, linewidth=1.0 if paper else 1.6, color=palette.COLOURS[0])
        check(other, markersize=3.0 if paper else 6.0, color=palette.COLOURS[1])
        check(axis._left_title, fontsize=8.0 if paper else 10.5, color=palette.INK,
              fontweight="normal" if paper else "bold")  # fmt: skip
        check(axis.xaxis.label, fontsize=size, color=palette.INK)
        for ticks in (axis.xaxis, axis.yaxis):
            label, grid = ticks.get_ticklabels()[0], ticks.get_gridlines()[0]
            check(label, fontsize=7.0 if paper else size, color=palette.SOFT_INK)
            check(grid, linewidth=0.4 if paper else 0.7, color=palette.GRID, visible=True)
            assert ticks.get_zorder() < line.get_zorder()
        shown = {side: spine.get_visible() for side, spine in axis.spines.items()}
        assert shown == {"left": True, "bottom": True, "top": False, "right": False}
        check(axis.spines["left"], edgecolor=palette.FAINT, linewidth=0.6 if paper else 0.8)
        (text,) = legend.get_texts()
        check(text, fontsize=7.0 if paper else size, color=palette.INK)
        assert not legend.get_frame_on()
        assert (legend.handlelength, legend.columnspacing) == (1.6, 1.2)
        assert plt.rcParams["pdf.fonttype"] == (42 if paper else 3)
        assert axis.xaxis.label.get_fontname() == ("STIXGeneral" if paper else "DejaVu Sans")
    plt.close("all")


@pytest.mark.parametrize(("top", "power"), [
    (9000.0, ""), (12000.0, "1e4"), (0.06, ""), (0.006, "1e−3"),
])  # fmt: skip
def test_numbers_have_a_power_of_ten_from_ten_thousand_and_a_hundredth_on(top, power, paper):
    figure, axis = plt.subplots()
    axis.set_ylim(0.0, top)
    figure.draw_without_rendering()
    shown = axis.yaxis.get_offset_text().get_text()
    if paper and power:  # a formula: times ten to the power
        assert shown.startswith("$") and "10^{" + power[2:] + "}" in shown
    else:
        assert shown == power


@pytest.mark.parametrize(("title", "name", "place"), [
    ("", "n", ""), ("Title", "n", ""), ("", "n" * 70, "label"), ("T" * 60, "n" * 20, "title"),
    ("T" * 30, "n" * 70, "title"),
])  # fmt: skip
def test_a_legend_is_as_high_above_its_axis_as_it_must(title, name, place, screen):
    """Beside a title it stands on the axis; else above half a label at the axis' top, or above the
    title. The figure grows where its margin ends."""
    figure, (axis, other) = style.make_axes(2, 1.5)
    axis.plot([0.0, 1.0], [0.0, 1.0], label=name)
    style.add_title(axis, title)
    before = figure.get_figheight()
    style.add_legend(axis)
    figure.draw_without_rendering()
    box, around = axis.get_legend().get_window_extent(), axis.get_window_extent()
    assert (box.x0 < around.x0) == (len(name) == 70)
    # Letters of 10 points; titles of 10.5, 6 points above the axis.
    up = {"": 0.0, "label": 0.6 * 10.0, "title": 6.0 + 1.2 * 10.5}[place]
    point = figure.dpi / 72.0
    assert box.y0 - around.y1 == pytest.approx((up + 0.1 * 10.0) * point, abs=0.1)
    assert around.x1 - box.x1 == pytest.approx(0.1 * 10.0 * point, abs=0.1)
    room = box.height / figure.dpi + up / 72.0 + 0.04
    assert figure.get_figheight() - before == pytest.approx(max(room - 0.36, 0.0), abs=1e-3)
    grown = figure.get_figheight()
    other.plot([0.0, 1.0], [0.0, 1.0], label=name)
    style.add_legend(other)  # between two axes there is room as it is
    assert figure.get_figheight() == grown


def test_axes_over_time_have_room_for_their_labels(paper):
    """0.92 inch at the left, where the label stands at 0.71; all of it smaller in a paper."""
    part = 0.66 if paper else 1.0
    figure, axes = style.make_axes(4, 1.5, 2, is_wide=True)
    width, height = figure.get_size_inches()
    assert width == (3.5 if paper else 12.0)
    first, second, third = (axis.get_position() for axis in axes[:3])
    room = [first.x0 * width, (1.0 - second.x1) * width, (1.0 - first.y1) * height,
            third.y0 * height, (first.y0 - third.y1) * height, (second.x0 - first.x1) * width]
    assert room == pytest.approx([part * one for one in (0.92, 0.12, 0.36, 0.58, 0.3, 1.0)])
    for axis in axes:
        along, up = axis.yaxis.get_label().get_position()
        box = axis.get_position()
        assert (-along * box.width * width, up) == pytest.approx((0.71 * part, 0.5))
        assert axis.get_shared_x_axes().joined(axis, axes[0])
    first, second = style.make_axes(2, 1.5, margins=style.Margins(0.5))[1]  # of pictures
    assert not first.get_shared_x_axes().joined(first, second)


@pytest.mark.parametrize("named", [
    {}, {"left": 0.4}, {"row_gap": 0.2, "right": 0.1},
    {"column_gap": 0.3, "bottom": 0.25, "top": 0.15},
])  # fmt: skip
def test_axes_fill_what_their_margins_leave(named, paper):
    """A margin that is not named is none; all axes are of one size."""
    part, wanted = 0.66 if paper else 1.0, style.Margins(**named)._asdict()
    assert {k: v for k, v in wanted.items() if v} == named
    figure, axes = style.make_axes(5, 1.5, 2, margins=style.Margins(**named))
    width, height = figure.get_size_inches()
    boxes = np.array([axis.get_position().extents for axis in axes]) * ([width, height] * 2)
    room = {name: part * named.get(name, 0.0) for name in wanted}
    across = (width - room["left"] - room["right"] - room["column_gap"]) / 2
    assert height == pytest.approx(3 * 1.5 * part + room["top"] + room["bottom"]
                                   + 2 * room["row_gap"])  # fmt: skip
    for number, (x0, y0, x1, y1) in enumerate(boxes):
        row, column = divmod(number, 2)
        left = room["left"] + column * (across + room["column_gap"])
        top = height - room["top"] - row * (1.5 * part + room["row_gap"])
        assert (x0, x1, y0, y1) == pytest.approx((left, left + across, top - 1.5 * part, top))


def test_runs_looks_are_parts_of_a_curve_s_width(paper):
    """The last is as thick as a curve, the first 0.7 more; markers are at places of their own."""
    width = 1.0 if paper else 1.6
    found = make_curve_styles(3)
    assert [one["lw"] for one in found] == pytest.approx([1.7 * width, 1.35 * width, width])
    for i, one in enumerate(found):
        assert one["ms"] == pytest.approx(4.2 * width) and (one["alpha"], one["mew"]) == (0.9, 0.0)
        assert one["markevery"] == pytest.approx((0.125 * i / 3, 0.125))
        assert one["color"] == palette.COLOURS[i]
    assert [one["marker"] for one in found] == ["o", "s", "^"]
    again = make_curve_styles(8)  # colours begin anew with other markers
    assert again[6]["color"] == found[0]["color"] and again[6]["marker"] == "s"


# -- over time ------------------------------------------------------------------------------------


def axis_of(runs, curves, **more):
    figure = draw_panels(
        [Panel("title", "axis", "m", tuple(curves), **more)], runs, "Title", Layout()
    )
    return figure.axes[0]


def test_what_helps_to_read_is_finer_than_curves(runs, screen):
    time = np.linspace(0.0, 3.0, 31)
    curves = [Curve("a", time, time - 1.0), Curve("b", time, 0.5 * time, colour_index=1,
        dashed=True),
              Curve("c", time, 0.3 * time, colour_index=2, is_pale=True)]  # fmt: skip
    axis = axis_of(runs[:1], curves, band=0.3, levels=((1.1, "2 %"),), marks=((0.7, "settled"),),
                   limits=((-1.5, "least"), (2.5, "greatest")))  # fmt: skip
    full, dashed, pale, zero, level, low, high, mark = axis.lines
    check(full, linewidth=1.6, alpha=None, linestyle="-")
    check(dashed, linewidth=1.0, linestyle="--")
    check(pale, linewidth=0.8, alpha=0.35, linestyle="-")
    check(zero, linewidth=0.8, color=palette.FAINT, zorder=1, linestyle="-")
    check(level, linewidth=0.9, color=palette.GOAL, linestyle="--")
    check(mark, linewidth=1.2, color=palette.GOAL, linestyle=":")
    for limit in (low, high):  # dashes of five widths, gaps of two
        check(limit, linewidth=1.0, color=palette.BAD)
        assert limit._unscaled_dash_pattern == (0, (5, 2))
    band, *spans = axis.patches
    check(band, facecolor=palette.GOAL, alpha=0.13, linewidth=0.0)
    for span in spans:
        check(span, facecolor=palette.BAD, alpha=0.08, linewidth=0.0)
    # Words are in the green that can be read, a few points beside their lines.
    for text, offset in zip(axis.texts, ((-2, 3), (4, -3)), strict=True):
        check(text, color=palette.GOOD, fontsize=10.0)
        assert text.xyann == offset and text.anncoords == "offset points"
    late = axis_of(runs[:1], curves, marks=((2.9, "settled"),)).texts[0]
    assert late.xyann == (-4, -3)


@pytest.mark.parametrize(("falls", "offset"), [(False, (-3, 3)), (True, (-3, -2))])
def test_far_limits_are_small_words_in_a_corner(falls, offset, runs, screen):
    time = np.linspace(0.0, 3.0, 31)
    axis = axis_of(runs[:1], [Curve("a", time, -time if falls else time)],
                   limits=((-50.0, "least"), (50.0, "greatest")))  # fmt: skip
    (text,) = axis.texts
    check(text, fontsize=7.5, color=palette.SOFT_INK)
    assert text.xyann == offset and text.anncoords == "offset points"


def test_values_that_no_line_joins_are_dots(runs, screen):
    time = np.arange(5.0)
    (alone, *_) = axis_of(runs[:1], [Curve("a", time, time + 1.0)], is_dotted=True).lines
    check(alone, marker=".", markersize=3.0, linestyle="None")
    both = [Curve(f"run {i}", time, time + 1.0 + i, i, i) for i in range(2)]
    first, second = axis_of(runs, both, is_dotted=True).lines[:2]
    check(first, linestyle="None", markersize=2 * 1.7 * 1.6, markevery=None)
    check(second, linestyle="None", markersize=2 * 1.6, markevery=None)
    few = axis_of(runs[:1], [Curve("a", time[:2], time[:2] + 1.0)]).lines[0]
    check(few, marker=".", markersize=3.0, linestyle="-")
    dashes = [axis_of(runs[:1], [Curve("a", time, time + 1.0, colour_index=6 * i)]).lines[0]
              for i in range(4)]  # fmt: skip
    assert [line._unscaled_dash_pattern for line in dashes] == [
        (0, None), (0, (4, 1.5)), (0, (1, 1.2)), (0, None)]  # fmt: skip


# -- the picture plane ----------------------------------------------------------------------------


def test_corners_are_half_as_bold_as_the_centre_and_below_it(runs, screen):
    figure = views.draw_image_trajectory(runs[:1])
    (axis,) = figure.axes
    line, dot, ring = axis.lines[:3]
    check(line, linewidth=0.9, alpha=0.8, zorder=3)
    check(dot, markersize=3.0, color=palette.START, zorder=5, linestyle="None")
    check(ring, markersize=5.0, markeredgewidth=0.9, zorder=6, markeredgecolor=palette.GOAL,
          linestyle="None")  # fmt: skip
    line, dot = axis.lines[12:]
    check(line, linewidth=1.8, alpha=1.0, zorder=4)
    check(dot, markersize=6.0, zorder=5)
    start, goal = figure.legends[0].get_lines()[-2:]
    check(start, marker="o", linestyle="None", markersize=6.0, color=palette.START)
    check(goal, marker="o", linestyle="None", markersize=9.0, markeredgewidth=1.6,
          markeredgecolor=palette.GOAL, markerfacecolor="none")  # fmt: skip
    two = views.draw_image_trajectory(runs).axes[0]
    check(two.lines[12], linewidth=1.7 * 1.6, alpha=1.0, zorder=4)
    check(two.lines[0], linewidth=0.5 * 1.7 * 1.6, alpha=0.8, zorder=3)


def test_a_picture_plane_has_room_for_its_labels(runs, paper):
    """As axes over time have it at the right and above; below also for its legend."""
    one = views.draw_image_trajectory(runs[:1])
    width, height = one.get_size_inches()
    box, part = one.axes[0].get_position(original=True), 0.66 if paper else 1.0
    assert box.x0 * width == pytest.approx(0.85 * part)
    assert (1.0 - box.x1) * width == pytest.approx(0.12 * part)
    assert (1.0 - box.y1) * height == pytest.approx(0.36 * part)
    two = views.draw_image_trajectory(runs)  # two names stand in one line
    box, height = two.axes[0].get_position(original=True), two.get_figheight()
    assert box.y0 * height == pytest.approx(0.89 * part)


def test_pictures_of_a_strip_stand_close_with_room_for_their_times(runs, paper):
    part, small = (0.66, 7.0) if paper else (1.0, 10.0)
    figure = views.draw_filmstrip([runs[0], replace(runs[0], name="other")])
    width, height = figure.get_size_inches()
    columns = len(figure.axes) // 2
    first, second, below = (figure.axes[i].get_position(original=True) for i in (0, 1, columns))
    last = figure.axes[columns - 1].get_position(original=True)
    room = [first.x0 * width, (1.0 - last.x1) * width, (1.0 - first.y1) * height,
            below.y0 * height, (first.y0 - below.y1) * height, (second.x0 - first.x1) * width]
    assert room == pytest.approx([part * one for one in (0.03, 0.03, 0.3, 0.03, 0.3, 0.07)])
    axis = figure.axes[0]
    for side in axis.spines.values():
        check(side, edgecolor=palette.FAINT, linewidth=0.6)
    check(axis.lines[0], linewidth=1.1, color=palette.GOAL)
    check(axis.title, fontsize=small, fontweight="normal")
    figure.draw_without_rendering()
    above = axis.title.get_transform().transform(axis.title.get_position())[1] - axis.bbox.y1
    assert above * 72.0 / figure.dpi == pytest.approx(3.0)
    (name,) = axis.texts
    check(name, fontsize=small, va="top")
    ground = name.get_bbox_patch()
    check(ground, facecolor="white", alpha=0.7, linewidth=0.0)
    assert ground.get_boxstyle().pad * small == pytest.approx(0.07 * 7.0 if paper else 0.5)
    assert name.get_position() == (0.03, 0.95) and name.get_transform() == axis.transAxes


# -- the path in space ----------------------------------------------------------------------------


def test_a_camera_s_path_is_bolder_than_what_stands_around_it(runs, paper):
    figure = views.draw_camera_path(runs[:1])
    (axis,) = figure.axes
    path, straight, *frusta = axis.lines
    check(path, linewidth=2.0, color=palette.COLOURS[0], zorder=4, linestyle="-")
    check(straight, linewidth=1.1, color=palette.GOAL, zorder=3, linestyle="--")
    for i, line in enumerate(frusta):  # a rim, then four edges
        check(line, linewidth=0.8 if i % 5 else 1.0, zorder=6)
    (face,) = axis.collections
    assert (face.get_zorder(), to_hex(face.get_facecolor()[0])) == (1, palette.INK)
    assert to_hex(face.get_edgecolor()[0]) == palette.INK
    assert (axis.elev, axis.azim, axis.computed_zorder) == (20, -58, False)
    for one in (axis.xaxis, axis.yaxis, axis.zaxis):
        assert one.pane.get_facecolor()[3] == 0.0 and one._axinfo["grid"]["linewidth"] == 0.6
        low, high = one.get_view_interval()
        assert 2 <= sum(low <= at <= high for at in one.get_majorticklocs()) <= 5
    for text in figure.texts:  # in the left upper corner, as axes' titles are
        check(text, fontsize=10.5, fontweight="bold", va="top")
        assert text.get_position() == pytest.approx((0.1 / 7.2, 0.995))
    assert len(figure.texts) == (0 if paper else 1)
    (legend,) = figure.legends  # below it is room for one line, and as much as others need
    lines = len({round(text.get_window_extent().y0) for text in legend.get_texts()})
    grown = legend.get_window_extent().height / figure.dpi * (lines - 1) / lines
    box, height = axis.get_position(original=True), figure.get_figheight()
    assert box.y0 * height == pytest.approx((0.5 * 0.66 * 1.5 if paper else 0.5) + grown, abs=0.01)


def test_paths_of_several_runs_look_as_their_curves_do(runs, screen):
    (axis,) = views.draw_camera_path(runs).axes
    for line, look in zip((axis.lines[0], axis.lines[2]), make_curve_styles(2), strict=True):
        check(line, linewidth=look["lw"], color=look["color"], marker=look["marker"],
              markersize=look["ms"], markevery=look["markevery"], zorder=4)  # fmt: skip
    for line, look in zip((axis.lines[1], axis.lines[3]), make_curve_styles(2), strict=True):
        check(line, linewidth=1.1, color=look["color"], zorder=3, linestyle="--", marker="None")
        assert line.get_label().startswith("_")
    assert [line.get_label() for line in axis.lines if line.get_label()[0] != "_"] == [
        "run 3", "run 4", "goal"]  # fmt: skip
    np.testing.assert_allclose(np.transpose(axis.lines[3].get_data_3d())[-1], GOAL[:3, 3])
