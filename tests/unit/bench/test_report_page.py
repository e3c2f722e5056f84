"""Data of the report's page: arrays of the runs, film and events; any run name is safe."""

import base64
import html
import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from made_run import made_run

from aras_visual_servo_bench.errors import BenchError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.metrics.metrics import settled
from aras_visual_servo_bench.metrics.statistics import proportion
from aras_visual_servo_bench.plots import panels
from aras_visual_servo_bench.plots.panel import MAX_CURVES, Curve, make_panel
from aras_visual_servo_bench.recording.image_tracks import compute_tracks
from aras_visual_servo_bench.recording.verdict import Verdict
from aras_visual_servo_bench.studies.replay import run_with_images
from aras_visual_servo_bench.web import uplot
from aras_visual_servo_bench.web.report.page import to_script_json
from aras_visual_servo_bench.web.report.report_data import make_contents
from aras_visual_servo_bench.web.report.write import CHAPTERS, write_report

HOSTILE = '</script><img src=x onerror="window.hit=1">&amp;\'"<!--'


@pytest.fixture(scope="module")
def moments():
    """Run with joints, images, and a start that is rotated relative to the goal."""
    asked = Experiment(plant="chain", start="2016", duration=1.5, time_after_convergence=None)
    return run_with_images(asked, "moments")


@pytest.fixture(scope="module")
def flying():
    """Run of four points with a free camera and a drifting target."""
    return run_with_images({
        "plant": "free", "scheme": "numbered_points", "duration": 1.0,
        "time_after_convergence": None,
        "target": {"shape": "square", "size": [0.1, 0.1],
                   "motion": {"velocity": [0.02, -0.01, 0.0, 0.0, 0.0, 0.1]}},
        "start": {"pose": [0.05, -0.03, 0.4, 3.14159, 0.0, 0.5]},
        "goal": {"pose": [0.0, 0.0, 0.25, 3.14159, 0.0, 0.0]},
    }, "flying")  # fmt: skip


def of_page(runs):
    """The page's contents with its arrays read."""
    groups = [(p.name, p.title, p.text, p.panels(runs)) for row in CHAPTERS for p in row]
    told = json.loads(to_script_json(make_contents(runs, groups)))
    told["arrays"] = [np.frombuffer(base64.b64decode(text), "<f4") for text in told["arrays"]]
    return told


def test_curves_of_several_runs_know_their_run_and_what_one_lacks_is_left_out(moments, flying):
    lost = replace(moments, name="lost", goal_pose=np.full((4, 4), np.nan))
    found = panels.make_pose_panels([lost, moments, flying])
    assert [[(c.name, c.run, c.colour_index) for c in p.curves] for p in found] == [
        [("moments", 1, 1), ("flying", 2, 2)]
    ] * 2
    joints = panels.make_joint_panels([moments, flying])
    assert all(curve.run == 0 for p in joints for curve in p.curves)
    told = of_page([lost, moments, flying])
    assert [run["poses"] is not None for run in told["runs"]] == [True] * 3
    assert set(told["scene"]["shapes"]) == {"target", "0", "1", "2"}
    assert [name for name, _ in told["scene"]["shapes"]["0"]][0] == "path"
    assert not any(name.startswith("goal") for name, _ in told["scene"]["shapes"]["0"])


def test_the_film_has_the_cameras_pictures_and_where_the_goal_wants_the_target(moments, flying):
    for run in (moments, flying):
        told = of_page([run])
        shown = told["runs"][0]["film"]
        stamps = told["arrays"][shown["time"]] + run.start_stamp
        assert len(shown["frames"]) == len(stamps) == len(run.control_record.images)
        for i in (0, len(stamps) // 2):
            frame = np.frombuffer(base64.b64decode(shown["frames"][i]), np.uint8)
            picture = cv2.imdecode(frame, cv2.IMREAD_COLOR)[..., ::-1]
            original = run.control_record.find_nearest_image(float(stamps[i]))
            assert picture.shape == original.shape == (shown["height"], shown["width"], 3)
            assert np.abs(picture.astype(int) - original).mean() < 4.0
        rim = told["arrays"][shown["desired_outline"]].reshape(-1, 2)
        if run is flying:  # the features are its corners, wherever the target has drifted to
            wanted = np.column_stack(run.camera.project(*run.desired_features[0].reshape(-1, 2).T))
            np.testing.assert_allclose(sorted(rim.tolist()), sorted(wanted.tolist()), atol=0.02)
            corners = compute_tracks(replace(run, states=tuple(
                replace(s, scheme_output=None) for s in run.states)))  # fmt: skip
            np.testing.assert_allclose(sorted(corners.desired[:4].tolist()), sorted(rim.tolist()),
                                       atol=0.02)  # fmt: skip
        told_tracks = shown["tracks"]
        assert told_tracks["is_measured"] == (run is flying)
        assert len(told_tracks["pixels"]) == len(told_tracks["names"])
        centre = told["arrays"][told_tracks["pixels"][-1]].reshape(-1, 2)
        assert centre.shape == (len(run.stamp), 2)


def test_the_arm_in_space_carries_the_camera(moments, flying):
    told = of_page([moments, flying])
    poses = told["runs"][0]["poses"]
    places = told["arrays"][poses["arm"]].reshape(-1, poses["joints"], 3)
    assert poses["joints"] == len(moments.joint_names)
    camera = told["arrays"][poses["rows"]].reshape(-1, 3, 4)[:, :, 3]
    # Links are rigid: what turns keeps its distances, and the first joint slides with its value.
    for one, other in [*((places[:, i], places[:, i + 1]) for i in range(1, poses["joints"] - 1)),
                       (places[:, -1], camera)]:  # fmt: skip
        length = np.linalg.norm(one - other, axis=1)
        assert np.ptp(length) < 1e-5
    gantry = moments.measured_positions[moments.servoing, 0]
    moved = np.linalg.norm(places[:, 1] - places[0, 1], axis=1)
    np.testing.assert_allclose(moved, np.abs(gantry - gantry[0]), atol=1e-5)
    assert np.ptp(gantry) > 0.02 and "arm" not in told["runs"][1]["poses"]


def test_the_arm_of_the_physics_stands_in_its_world(moments):
    run = run_with_images(Experiment(duration=0.1), "bullet")
    reach = [np.linalg.norm(one.joint_origins[:, -1] - one.true_pose[:, :3, 3], axis=1)
             for one in (run, moments)]  # fmt: skip
    assert np.ptp(np.concatenate(reach)) < 1e-6
    assert (run.joint_origins[:, 1, 2] > run.true_pose[:, 2, 3] + 0.3).all()  # it hangs above


def test_the_words_change_when_the_loops_do(moments):
    found = of_page([moments])["runs"][0]["events"]
    assert found[0][0] == 0.0 and found[0][1] == moments.phases[0]
    for time, phase, outcome, reason in found:
        i = int(np.argmin(np.abs(moments.time - time)))
        assert (phase, outcome, reason) == (
            moments.phases[i], moments.outcomes[i], moments.reasons[i])  # fmt: skip
    assert all(a[1:] != b[1:] for a, b in zip(found, found[1:], strict=False))


def test_no_name_is_markup(moments, tmp_path):
    decision = moments.states[0].scheme_output
    names = tuple(f"{HOSTILE}{i}" for i in range(len(decision.names)))
    states = tuple(
        state if state.scheme_output is None else
        replace(state, reason=HOSTILE, scheme_output=replace(state.scheme_output, names=names))
        for state in moments.states
    )  # fmt: skip
    joints = tuple(f"{HOSTILE}{name}" for name in moments.joint_names)
    bad = replace(moments, name=HOSTILE, states=states, reason=HOSTILE, remedy=HOSTILE,
                  source=HOSTILE, notes=[HOSTILE], settings={HOSTILE: HOSTILE}, yaml=HOSTILE,
                  joint_names=joints)  # fmt: skip
    for runs in ([bad], [bad, bad]):
        page = write_report(runs, tmp_path, ())[0].read_text()
        assert "<img" not in page and "onerror" in page
        inside = re.search(r'id="contents">(.*?)</script>', page, re.DOTALL)[1]
        assert json.loads(inside)["runs"][0]["name"] == HOSTILE
        assert html.escape(HOSTILE, quote=False)[:20] in page


def test_of_ten_thousand_curves_a_panel_shows_those_that_change_most(moments):
    time = np.arange(5.0)
    curves = [
        Curve(f"pixel {i}", time, (1e-3 * i) * time, colour_index=i) for i in range(10_000)
    ]
    (found,) = make_panel("error", "error", "", curves)
    assert len(found.curves) == MAX_CURVES and found.omitted_curves == 10_000 - len(
        found.curves
    )
    assert [c.name for c in found.curves] == [f"pixel {i}" for i in range(9976, 10_000)]
    empty = replace(curves[0], values=np.full(5, np.nan))
    assert make_panel("nothing", "nothing", "", [empty]) == []


def test_of_thousands_of_numbers_a_table_shows_some_and_says_how_many_more(moments, tmp_path):
    def wide(state):
        decision = state.scheme_output
        names, zeros = tuple(f"p{i}" for i in range(400)), (0.0,) * 400
        return state if decision is None else replace(state, scheme_output=replace(
            decision, names=names, features=zeros, desired=zeros, error=zeros,
            filtered_error=zeros))  # fmt: skip

    many = replace(moments, states=tuple(map(wide, moments.states)), units=(), tolerances=())
    page = write_report([many], tmp_path, ())[0].read_text()
    rows = page.partition('id="numbers"')[2].partition("</section>")[0]
    count = len((tmp_path / "summary.csv").read_text().splitlines()) - 1
    assert rows.count("<tr>") == 251
    assert f"lists {count - 250} more quantities" in rows
    assert "24 curves of" not in page and '"omitted_curves":376' in page


def read_section(page, name):
    """The rows of the tables of a section, as texts of their cells."""
    section = page.partition(f'<section id="{name}"')[2].partition("</section>")[0]
    rows = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL)
            for row in section.split("<tr")[1:]]  # fmt: skip
    return [[html.unescape(re.sub(r"<[^>]*>", "", cell)).strip() for cell in row] for row in rows]


def read_title(page):
    titles = re.findall(r"<title>(.*?)</title>|<h1>(.*?)</h1>", page)
    assert titles[0][0] == titles[1][1]
    return html.unescape(titles[0][0])


def test_a_report_is_titled_after_its_experiment(moments, tmp_path):
    page = write_report([replace(moments, name="out/run.bag")], tmp_path, ())[0].read_text()
    outcome = moments.outcome.replace("_", " ")
    verdict = moments.verdict.name.replace("_", " ")
    assert read_title(page) == f"moments, plant chain, target aras: {outcome}, {verdict}"
    assert '<p class="meta">out/run.bag · ' in page


def test_few_runs_are_compared_by_their_main_results_first(tmp_path):
    runs = [made_run(1, 1.6), replace(
        made_run(2, 2.3), outcome="target_lost", reason="over the <left> border",
        remedy="start nearer",
        verdict=Verdict("goal_missed", 0.083, 0.2), settings={"plant": "free"}, notes=["cut off"])]
    page = write_report(runs, tmp_path, ())[0].read_text()
    assert read_title(page) == (
        "Comparison of 2 runs: made, plant chain and free, target aras; 1 of 2 succeeded")
    assert page.index('id="headline"') < page.index('id="bar"')
    times = [f"{settled.measure(run):.3g}" for run in runs]
    assert read_section(page, "headline") == [
        ["run", "outcome", "goal reached", "final distance (mm)", "final angle (°)",
         "settling time (s)", "reason and remedy"],
        ["run 1", "converged", "yes", "0.417", "0.299", times[0], "–"],
        ["run 2", "target_lost", "no", "83", "11.5", times[1],
         "over the <left> border; start nearer"],
    ]  # fmt: skip
    assert "<b>run 2:</b> cut off" in page


def test_many_runs_are_compared_by_groups_of_equal_settings(tmp_path):
    runs = []
    for i in range(12):
        reached = i % 5 != 4
        runs.append(replace(
            made_run(1, 2.3), name=f"study:{i}", settings={"gain": f"{i % 2}", "seed": f"{i}"},
            outcome="converged" if reached else "target_lost",
            verdict=Verdict("goal_reached" if reached else "goal_missed", 1e-3 * i, 1e-3)))
    page = write_report(runs, tmp_path, ())[0].read_text()
    assert read_title(page).startswith("Comparison of 12 runs: made, plant chain, target aras; 10")
    rows = read_section(page, "headline")
    assert [row[0] for row in rows[:3]] == ["group", "gain 0", "gain 1"]
    even, odd = proportion(5, 6), proportion(5, 6)
    assert [row[1] for row in rows[1:3]] == [
        f"5 of 6 [{100 * one.low:.0f}, {100 * one.high:.0f}] %" for one in (even, odd)]
    assert [float(row[2].split()[0]) for row in rows[1:3]] == [5.0, 6.0]  # medians, mm
    assert [row[-1] for row in rows[1:3]] == ["5 of 6", "5 of 6"]
    assert [row[0] for row in rows[4:]] == [run.name for run in runs]
    alone = [replace(run, settings={"gain": f"{i}"}) for i, run in enumerate(runs)]
    page = write_report(alone, tmp_path, ())[0].read_text()
    assert [row[0] for row in read_section(page, "headline")[:2]] == ["group", "all runs"]


@pytest.mark.parametrize(("change", "told"), [
    (lambda run: {"states": (), "pose": run.pose[:0]},
     "No curve: the loop has processed no image."),

    (lambda run: {"pose": np.tile(run.pose[:1], (len(run.pose), 1, 1))},
     "The camera has not moved."),
])  # fmt: skip
def test_what_a_run_lacks_is_explained(change, told, tmp_path):
    run = made_run(1, 1.6)
    lacking = replace(run, **change(run), cameras={}, joint_names=(), joint_units=(),
                      measured_positions=run.measured_positions[:, :0],
                      measured_velocities=run.measured_velocities[:, :0],
                      joint_commands=run.joint_commands[:, :0],
                      position_limits=(np.zeros(0), np.zeros(0)), speed_limits=np.zeros(0))
    page = html.unescape(write_report([lacking], tmp_path, ())[0].read_text())
    assert told in page and "No image is stored" in page
    assert "Joints (needs joints that move the camera)" in page
    if not lacking.names:
        assert "Errors (needs images that the scheme has measured)" in page


def test_the_library_is_the_one_that_is_meant():
    assert "var uPlot=" in uplot.read_uplot(uplot.SCRIPT)
    assert ".u-over" in uplot.read_uplot(uplot.STYLE)
    with pytest.raises(BenchError, match="uplot.min.css is missing or .*: pip install"):
        uplot.read_uplot((uplot.STYLE[0], "0" * 64))
