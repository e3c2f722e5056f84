"""Lines, limits and texts of figures, compared with the arrays of the run; none is rendered.

The run is made_run's: a tilted path, a camera with fx other than fy, images from 1.9 s on.
"""

from __future__ import annotations

from dataclasses import MISSING, fields, replace

import numpy as np
import pytest
from made_run import GOAL, JOINTS, K, corners_seen, made_run

from aras_visual_servo_bench.plots import camera_figures as views
from aras_visual_servo_bench.plots import palette, panels, style
from aras_visual_servo_bench.plots.panel import Curve, Panel
from aras_visual_servo_bench.plots.time_plots import Layout, draw_panels, find_symbol
from aras_visual_servo_bench.recording.film import with_images
from aras_visual_servo_bench.recording.image_tracks import compute_tracks, find_milestones
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.recording.verdict import Verdict
from aras_visual_servo_bench.web.report.write import CHAPTERS
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.schemes.base import SchemeOutput

CHAPTERS = {part.name: part for row in CHAPTERS for part in row}
WIDTH, HEIGHT = 640, 400


def picture(number):
    """(400, 640, 3), of a colour of its own, white in one corner."""
    found = np.full((HEIGHT, WIDTH, 3), (40 * number, 10, 200 - 30 * number), np.uint8)
    found[:50, :70] = 255
    return found


def filmed(run):
    """Run with every twentieth image stored; the last of them is 27 images before the end."""
    stamps = run.stamp[:-26:20]
    return with_images(run, [(float(s), picture(i)) for i, s in enumerate(stamps)])


def of_points(run):
    """The run of a scheme that sees points 3 and 1, the first not in its first images."""
    rng = np.random.default_rng(7)
    names, states = ("x3", "y3", "x_1", "y_1"), []
    for i, state in enumerate(run.states):
        wanted = np.array([0.1, -0.2, -0.15, 0.05]) + 1e-4 * i
        error = np.exp(-0.03 * i) * np.array([0.2, 0.1, -0.1, 0.24]) + 1e-3 * rng.normal(size=4)
        error[:2] = np.nan if i in (0, 1, 40) else error[:2]
        wanted = np.full(4, np.nan) if i > 120 else wanted
        decision = SchemeOutput(names, wanted + error, wanted, error) if i != 33 else None
        states.append(replace(state, scheme_output=decision))
    return replace(run, states=tuple(states), units=(), name="points")


@pytest.fixture(scope="module")
def runs():
    return [filmed(made_run(3, 1.6)), filmed(made_run(4, 2.3))]


def same(line, points, **look):
    """Return whether a line goes through these points (n, 2) or (n, 3) and has this style."""
    data = line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data()
    np.testing.assert_allclose(np.transpose(data), np.reshape(points, (-1, len(data))), atol=1e-6)
    for name, value in look.items():
        assert getattr(line, f"get_{name}")() == value, (name, value)


def words(found):
    return [text.get_text() for text in found.get_texts()]


def placed(run, stamp):
    points = np.array([(x, y, 0.0) for x, y in run.target.shape.corners])
    pose = run.target.world_T_target(stamp)
    return points @ pose[:3, :3].T + pose[:3, 3]


def pixel(points):
    return np.asarray(points) * [K[0], K[4]] + [K[2], K[5]]


def centre(rim):
    x, y = rim.T
    cross = x * np.roll(y, -1) - y * np.roll(x, -1)
    return np.array([((v + np.roll(v, -1)) * cross).sum() / (3 * cross.sum()) for v in (x, y)])


def test_a_target_s_corners_are_pale_and_its_centre_is_bold(runs, screen):
    seen = corners_seen(runs[0])[0]
    rims = seen[..., :2] / seen[..., 2:]
    local = (placed(runs[0], runs[0].joint_stamp[-1]) - GOAL[:3, 3]) @ GOAL[:3, :3]
    figure = views.draw_image_trajectory(runs[:1])
    (axis,) = figure.axes
    for i in range(4):
        line, start, goal = axis.lines[3 * i : 3 * i + 3]
        same(line, pixel(rims[:, i]), color=palette.FAINT, alpha=0.8)
        same(start, pixel(rims[0, i]))
        same(goal, pixel(local[i, :2] / local[i, 2]))
    line, start = axis.lines[12:]  # what the goal's is like nobody knows
    same(line, pixel([centre(rim) for rim in rims]), color=palette.COLOURS[0])
    # A centre that was measured in some images only; its goal.
    measured = np.array([0.05, -0.1]) + 1e-3 * np.arange(2 * len(rims)).reshape(-1, 2)
    measured[:3], measured[9, 1] = np.nan, np.nan
    own = replace(runs[0], centres=measured, goal=Goal(moments=Moments.from_polygon(rims[0], 2)))
    found = compute_tracks(own)
    known = np.isfinite(measured).all(axis=1)
    np.testing.assert_allclose(found.pixels[known, 4], pixel(measured[known]))
    assert np.isnan(found.pixels[~known, 4]).all() and not found.is_measured
    np.testing.assert_allclose(found.desired[4], pixel(centre(rims[0])), atol=1e-6)
    (axis,) = views.draw_image_trajectory([own]).axes
    same(axis.lines[12], pixel(measured[known]))
    same(axis.lines[14], found.desired[4])
    bare = compute_tracks(replace(own, target=None))
    assert bare.names == ("centre of gravity",)
    np.testing.assert_array_equal(bare.pixels[:, 0], found.pixels[:, 4])
    assert compute_tracks(replace(own, target=None, centres=measured[:-1])) is None
    assert compute_tracks(replace(own, states=())) is None


def test_what_is_behind_the_camera_is_nowhere_in_its_picture(runs):
    whole, pose = compute_tracks(runs[0]).pixels, runs[0].pose.copy()
    pose[5, :3, :3] = pose[5, :3, :3] @ np.diag([1.0, -1.0, -1.0])
    found = compute_tracks(replace(runs[0], pose=pose)).pixels
    assert np.isnan(found[5]).all() and np.isfinite(whole).all()
    np.testing.assert_array_equal(np.delete(found, 5, 0), np.delete(whole, 5, 0))


def test_a_strip_shows_the_picture_next_to_each_milestone(runs, paper):
    short = of_points(runs[1])
    strips = [runs[0], replace(short, states=short.states[:45], name="$two")]
    stamps = [find_milestones(run) for run in strips]
    counts = [len(one) for one in stamps]
    columns = max(counts)
    assert columns == 6 and counts[0] != counts[1]
    figure = views.draw_filmstrip(strips)
    assert len(figure.axes) == 2 * columns
    for run, times, row in zip(strips, stamps, np.reshape(figure.axes, (2, columns)), strict=True):
        assert [axis.get_visible() for axis in row] == [i < len(times) for i in range(columns)]
        for axis, stamp in zip(row, times, strict=False):
            kept = run.control_record.images
            nearest = np.argmin([abs(one - stamp) for one, _ in kept])
            np.testing.assert_array_equal(axis.images[0].get_array(), kept[nearest][1])
            assert axis.images[0].get_extent() == [-0.5, WIDTH - 0.5, HEIGHT - 0.5, -0.5]
            assert [*axis.get_xlim(), *axis.get_ylim()] == axis.images[0].get_extent()
            local = (placed(run, run.joint_stamp[-1]) - GOAL[:3, 3]) @ GOAL[:3, :3]
            rim = pixel(local[:, :2] / local[:, 2:])
            same(axis.lines[0], [*rim, rim[0]], color=palette.GOAL)
            assert axis.get_title() == f"{stamp - run.stamp[0]:.2f} s"
        (name,) = [text for axis in row for text in axis.texts]
        assert name.get_text() == style.escape_math(run.name)
    alone = views.draw_filmstrip([replace(runs[0], target=None)])
    assert not any(axis.texts or axis.lines for axis in alone.axes)
    assert views.draw_filmstrip([with_images(runs[0], [])]) is None
    blind = replace(runs[0], states=runs[0].states[:1])
    blind = replace(blind, states=(replace(blind.states[0], scheme_output=None),))
    (axis,) = views.draw_filmstrip([blind]).axes
    np.testing.assert_array_equal(axis.images[0].get_array(), picture(0))


def check_frustum(lines, pose, size, **look):
    """Check the border of a drawn camera, and an edge from its tip to each corner."""
    x, y, z = 0.4 * size, 0.3 * size, 0.7 * size
    corners = np.array([(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z), (-x, -y, z)])
    rim = corners @ pose[:3, :3].T + pose[:3, 3]
    same(lines[0], rim, **look)
    for edge, corner in zip(lines[1:], rim[:4], strict=True):
        same(edge, [pose[:3, 3], corner], **look)


def test_a_camera_s_path_is_drawn_with_its_goal_and_its_target(runs, paper):
    poses = runs[0].true_pose.copy()
    after = np.flatnonzero(runs[0].joint_stamp >= runs[0].stamp[0])
    poses[after[[0, 1, 30]]] = np.nan  # it is unknown at times
    run, path = replace(runs[0], true_pose=poses), poses[np.delete(after, [0, 1, 30])]
    corners = placed(run, run.states[0].stamp)
    figure = views.draw_camera_path([run])
    (axis,) = figure.axes
    points = np.vstack([path[:, :3, 3], GOAL[None, :3, 3], corners])
    low, high = points.min(axis=0), points.max(axis=0)
    size = (high - low).max()
    first, last = np.transpose([axis.get_xlim(), axis.get_ylim(), axis.get_zlim()])
    np.testing.assert_allclose(first + last, low + high)  # in the middle
    assert (first < low - 0.05 * size).all() and (last > high + 0.05 * size).all()
    assert 0.34 * size < (last - first).min() and (last - first).max() < 1.2 * size
    by_label = {name: [line for line in axis.lines if line.get_label() == name]
                for name in ("camera", "straight", "start", "goal", "end")}  # fmt: skip
    assert all(len(found) == 1 for found in by_label.values())
    assert words(figure.legends[0]) == list(by_label)
    same(by_label["camera"][0], path[:, :3, 3])
    (line,) = by_label["straight"]
    data = np.transpose(line.get_data_3d())
    wanted = np.linspace(path[0, :3, 3], GOAL[:3, 3], len(data))
    np.testing.assert_allclose(data, wanted, atol=1e-9)
    assert line.get_linestyle() == "--" and line.get_color() == palette.GOAL
    check_frustum(axis.lines[2:7], path[0], 0.12 * size, color=palette.START, linestyle="-")
    check_frustum(axis.lines[7:12], GOAL, 0.18 * size, color=palette.GOAL, linestyle="--")
    check_frustum(axis.lines[12:], path[-1], 0.12 * size, linestyle="-",
                  color=by_label["camera"][0].get_color())  # fmt: skip
    assert not np.allclose(runs[0].target.world_T_target(run.start_stamp), runs[0].target.pose)


@pytest.mark.parametrize("name", [n for n, part in CHAPTERS.items() if part.draw is None])
@pytest.mark.parametrize(("count", "paper"), [(1, False), (2, True)], indirect=["paper"])
def test_a_figure_has_its_panels_curves_and_names_them(runs, count, name, paper):
    part, some = CHAPTERS[name], runs[:count]
    figure, shown = part.draw_figure(some), part.panels(some)
    if figure is None:
        assert (name, count, shown) == ("features", 2, [])
        return
    axes = [axis for axis in figure.axes if axis.get_visible()]
    columns = part.layout.columns
    assert len(axes) == len(shown) > 0
    end = max(run.stamp[-1] - run.stamp[0] for run in some)
    for number, (axis, panel) in enumerate(zip(axes, shown, strict=True)):
        assert axis.get_xlim() == pytest.approx((0.0, end))
        assert axis.get_yscale() == ("log" if panel.is_logarithmic else "linear")
        low, high = axis.get_ylim()
        if panel.is_logarithmic and not paper:
            label = axis.yaxis.get_major_formatter()(1e-4, 0)
            assert label == ("10⁻⁴" if high > 1e3 * low else "0.0001")
        said, looks = [text.get_text() for text in axis.texts], []
        assert all(f"{what} after {at:.2f} s" in said for at, what in panel.marks)
        for line, curve in zip(axis.lines, panel.curves, strict=False):
            np.testing.assert_array_equal(line.get_data(), curve.insert_gaps())
            known = curve.values[np.isfinite(curve.values)]
            assert (low < known).all() and (known < high).all()
            looks.append((line.get_color(), str(line.get_linestyle()), line.get_marker(),
                          line.get_alpha()))  # fmt: skip
            dashed = str(line.get_linestyle()) == "--"
            assert dashed == curve.dashed and (line.get_linestyle() == "None") == panel.is_dotted
        assert len(set(looks)) == len(panel.curves)
        legend = axis.get_legend()
        full = [c for c in panel.curves if not (c.dashed or c.is_pale)]
        label = axis.get_ylabel()
        assert label.startswith((panel.axis, find_symbol(panel.axis))), label
        assert label.endswith(f"({panel.unit})") or not panel.unit, label
        if columns == 1:
            shows = number == 0 if count == 2 else [c.name for c in full] != [panel.axis]
            assert (legend is not None) == shows
        if legend is not None:
            named = dict(zip(words(legend), legend.get_lines(), strict=True))
            wanted = [r.name for r in some] if count == 2 else [find_symbol(c.name) for c in full]
            assert [w for w in named if w not in ("commanded position", "desired")] == wanted
            for line in axis.lines[: len(panel.curves)]:
                if line.get_label() in named:
                    assert line.get_color() == named[line.get_label()].get_color()
        lowest = number >= len(axes) - columns
        time = "time (s)" if paper and columns == 2 else "time since servoing began (s)"
        assert axis.get_xlabel() == (time if lowest else "")
    for column in range(columns):
        assert len({axis.get_xlim() for axis in axes[column::columns]}) == 1


def axis_of(run, *curves, **more):
    drawn = tuple(Curve("curve", *one, colour_index=i) for i, one in enumerate(curves))
    panel = Panel("title", "axis", "m", drawn, **more)
    return draw_panels([panel], [run], "Title", Layout()).axes[0]


def test_limits_near_the_curves_are_lines_and_far_ones_are_words(runs, screen):
    rise = (np.linspace(0.0, 3.0, 31), np.linspace(1.0, 2.0, 31))
    low, high = axis_of(runs[0], rise).get_ylim()
    extent = high - low
    assert (low, high) == pytest.approx((0.95, 2.05))
    near, far = high + 0.59 * extent, high + 0.61 * extent
    below, under = low - 0.59 * extent, low - 0.61 * extent
    axis = axis_of(runs[0], rise, limits=((below, "least"), (near, "greatest")))
    assert axis.get_ylim() == pytest.approx((below - 0.03 * extent, near + 0.03 * extent))
    lines = [line for line in axis.lines if line.get_color() == palette.BAD]
    assert [line.get_ydata()[0] for line in lines] == pytest.approx([below, near])
    assert not axis.texts
    for values, place in ((rise[1], 0.0), (rise[1][::-1], 1.0)):
        axis = axis_of(runs[0], (rise[0], values), limits=((under, "least"), (far, "greatest")))
        assert axis.get_ylim() == pytest.approx((low, high)) and len(axis.lines) == 1
        (text,) = axis.texts
        assert text.get_text() == f"limits {under:.3g} to {far:.3g}"
        assert text.xy == (1.0, place)  # where the curve does not end
    within = axis_of(runs[0], rise, limits=((1.5, "least"), (9.0, "greatest")))
    assert within.get_ylim() == pytest.approx((low, high)) and not within.texts
    still = axis_of(runs[0], (rise[0], 0.3 + 1e-5 * rise[1]), limits=((-50.0, ""), (50.0, "")))
    middle = 0.3 + 1.5e-5
    assert still.get_ylim() == pytest.approx((middle - 0.002, middle + 0.002))


@pytest.mark.parametrize(("name", "shown"), [
    ("x0", "$x_{0}$"), ("y_12", "$y_{12}$"), ("s3", "$s_{3}$"), ("xn", "$x_n$"),
    ("ωz", r"$\omega_z$"), ("vx", "$v_x$"), ("area2", "area2"), ("some_area", "some area"),
    ("p$", r"p\$"), ("7", "7"),
    ("alpha", r"$\alpha$"), ("L J", r"$L\,J$"), ("|v|", "$|v|$"), ("x", "x")])  # fmt: skip
def test_a_quantity_is_written_as_in_a_formula(name, shown):
    assert find_symbol(name) == shown


def test_several_runs_are_compared_feature_by_feature_while_these_are_few(runs):
    found = {p.title: p for p in panels.make_error_panels(runs)}
    assert list(found) == ["error of area", "error of height", "error of turn",
                           "norm of the errors, relative"]  # fmt: skip
    for k, name in enumerate(runs[0].names):
        panel = found[f"error of {name}"]
        assert (panel.axis, panel.unit) == (name, ("", "m", "rad")[k])
        for run, curve in zip(runs, panel.curves, strict=True):
            np.testing.assert_array_equal(curve.values, run.error[:, k])
            assert (curve.name, curve.run) == (run.name, runs.index(run))
    assert found["norm of the errors, relative"].marks == ()
    assert list({p.title: p for p in panels.make_error_panels([runs[0], of_points(runs[1])])}) == [
        "norm of the errors, relative"]


def test_a_band_is_that_of_features_whose_tolerances_are_one(runs):
    run = of_points(runs[0])
    two = replace(run, units=("", "", "m", "m"), tolerances=(0.1, 0.1, 0.2, 0.3))
    plain, metres, _ = panels.make_error_panels([two])
    assert (plain.unit, plain.band, metres.unit, metres.band) == ("", 0.1, "m", None)
    assert [c.name for c in metres.curves] == ["x_1", "y_1"] and not metres.curves[0].is_pale
    assert [p.band for p in panels.make_error_panels([run])] == [None, None]
    assert panels.group_by_unit(replace(run, units=("m", "", "m", ""))) == [("m", [0, 2]),
                                                                          ("", [1, 3])]  # fmt: skip


def test_several_runs_show_their_speeds(runs):
    for k, panel in enumerate(panels.make_twist_panels(runs)):
        assert panel.axis == ("|v|", "|ω|")[k] and panel.unit == ("m/s", "rad/s")[k]
        for run, curve in zip(runs, panel.curves, strict=True):
            twist = run.achieved_twist[:, 3 * k : 3 * k + 3]
            np.testing.assert_allclose(curve.values, np.sqrt((twist**2).sum(axis=1)))
    assert panels.make_feature_panels(runs) == []
    ratios = {p.title: p for p in panels.make_conditioning_panels(runs)}
    for title, at in (("condition number of L", 0), ("condition number of L J", 1)):
        for run, curve in zip(runs, ratios[title].curves, strict=True):
            told = [s.ik_solution.recorded_singular_values[at] for s in run.states]
            np.testing.assert_allclose(curve.values, [max(one) / min(one) for one in told])
    scale = ratios["factor by which limits reduced the twist"]
    assert scale.span == (-0.05, 1.1)


def test_joints_of_another_run_are_found_by_their_names(runs):
    turned = replace(runs[1], joint_names=(JOINTS[2], "tool", JOINTS[0]))
    found = {p.title: p for p in panels.make_joint_panels([runs[0], turned])}
    assert len(found["elbow"].curves) == 1 and len(found["wrist"].curves) == 2
    curve = found["wrist"].curves[1]
    shown = turned.joint_stamp >= turned.stamp[0] - 0.1
    np.testing.assert_array_equal(curve.values, turned.measured_positions[shown, 0])
    np.testing.assert_array_equal(found["slide, speed"].curves[1].values,
                                  turned.measured_velocities[shown, 2])  # fmt: skip
    assert (curve.name, curve.run, curve.colour_index) == (turned.name, 1, 1)


def test_of_a_run_of_which_little_is_known_the_rest_is_shown(runs):
    given = {f.name: getattr(runs[0], f.name) for f in fields(Run)
             if f.default is MISSING and f.default_factory is MISSING}  # fmt: skip
    bare = Run(**given)
    found = {p.title: p for p in panels.make_joint_panels([bare])}
    assert len(found) == 6 and all(not panel.limits for panel in found.values())
    assert found["slide"].unit == "rad" and found["slide, speed"].unit == "rad/s"
    assert [p.title for p in panels.make_timing_panels([bare])] == [
        "interval between images", "delay"]  # fmt: skip
    assert compute_tracks(bare) is None and bare.project_desired_outline() is None
    assert bare.control_record.find_nearest_image(0.0) is None


def test_time_ends_with_the_last_image_of_all_runs_or_after_a_millisecond(runs):
    short = replace(runs[0], states=runs[0].states[:2])
    long = replace(runs[1], states=runs[1].states[:40])
    end = long.states[-1].stamp - long.states[0].stamp
    for some in ([short, long], [long, short]):
        assert panels.find_last_time(some) == pytest.approx(end, rel=1e-12)
    for count in (0, 1):
        assert panels.find_last_time([replace(short, states=short.states[:count])]) == 0.001


def test_distances_too_small_for_a_logarithm_are_cut(runs):
    poses = runs[0].true_pose.copy()
    poses[-3:] = GOAL
    distance, angle = panels.make_pose_panels([replace(runs[0], true_pose=poses)])
    assert distance.curves[0].values[-3:] == pytest.approx([1e-4] * 3)
    assert angle.curves[0].values[-3:] == pytest.approx([1e-4] * 3) and angle.is_logarithmic
    zero = tuple(replace(s, scheme_output=s.scheme_output and replace(
        s.scheme_output, error=np.zeros(3))) for s in runs[0].states[5:])
    for states, find in ((runs[0].states[:5] + zero, np.nanmin), (zero, np.nanmax)):
        norm = panels.make_error_panels([replace(runs[0], states=states)])[-1]
        assert find(norm.curves[0].values) == 1e-6 and norm.levels == ((0.02, "2 %"),)


def test_verdicts_are_of_distance_and_angle(runs):
    at = GOAL.copy()
    at[:3, 3] += [3e-3, 0.0, 4e-3]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    at[:3, :3] = GOAL[:3, :3] @ turn
    for reached, word in (((6e-3, 1.6), True), ((4e-3, 1.6), False), ((6e-3, 1.5), False)):
        found = Verdict.compare(GOAL, at, 1.0, reached)
        assert (found.distance, found.angle) == pytest.approx((5e-3, np.pi / 2))
        assert found.is_reached == word and found.name == f"goal_{'reached' if word else 'missed'}"


def test_what_goes_over_decades_has_a_logarithmic_axis_of_one_run_and_of_several(runs):
    decades = {"norm of the errors, relative", "distance to the goal", "angle to the goal",
               "condition number", "condition number of L", "condition number of L J"}  # fmt: skip
    for some in (runs[:1], runs, [of_points(runs[0]), runs[1]]):
        told = {p.title: p.is_logarithmic for part in CHAPTERS.values() for p in part.panels(some)}
        assert {title for title, log in told.items() if log} == decades & set(told)
        assert len(decades & set(told)) == (4 if len(some) == 1 else 5)
