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
    asked = Experiment(plant="chain", start="2016", duration=1.5, time_after_convergence=None)
    return run_with_images(asked, "moments")


@pytest.fixture(scope="module")
def flying():
    return run_with_images({
        "plant": "free", "scheme": "numbered_points", "duration": 1.0,
        "time_after_convergence": None,
        "target": {"shape": "square", "size": [0.1, 0.1],
                   "motion": {"velocity": [0.02, -0.01, 0.0, 0.0, 0.0, 0.1]}},
        "start": {"pose": [0.05, -0.03, 0.4, 3.14159, 0.0, 0.5]},
        "goal": {"pose": [0.0, 0.0, 0.25, 3.14159, 0.0, 0.0]},
    }, "flying")  # fmt: skip


def of_page(runs):
    groups = [(p.name, p.title, p.text, p.panels(runs)) for row in CHAPTERS for p in row]
    told = json.loads(to_script_json(make_contents(runs, groups)))
    told["arrays"] = [np.frombuffer(base64.b64decode(text), "<f4") for text in told["arrays"]]
    return told


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


def test_words_change_when_the_loops_do(moments, flying):
    told = of_page([moments, flying])
    found = told["runs"][0]["events"]
    assert found[0][0] == 0.0 and found[0][1] == moments.phases[0]
    for time, *words in found:
        i = int(np.argmin(np.abs(moments.time - time)))
        assert words == [moments.phases[i], moments.outcomes[i], moments.reasons[i]]
    rows = list(zip(moments.phases, moments.outcomes, moments.reasons, strict=True))
    assert len(found) == 1 + sum(a != b for a, b in zip(rows, rows[1:], strict=False)) > 2
    assert [set(run["poses"]) >= {"arm"} for run in told["runs"]] == [True, False]


def test_no_name_is_markup(moments, tmp_path):
    decision = moments.states[0].scheme_output
    names = tuple(f"{HOSTILE}{i}" for i in range(len(decision.names)))
    states = tuple(
        replace(s, reason=HOSTILE, scheme_output=s.scheme_output and replace(
            s.scheme_output, names=names)) for s in moments.states)  # fmt: skip
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
    curves = [Curve(f"pixel {i}", time, (1e-3 * i) * time, colour_index=i) for i in range(10_000)]
    (found,) = make_panel("error", "error", "", curves)
    assert found.omitted_curves == 10_000 - MAX_CURVES
    names = [f"pixel {i}" for i in range(10_000 - MAX_CURVES, 10_000)]
    assert [c.name for c in found.curves] == names
    empty = replace(curves[0], values=np.full(5, np.nan))
    assert make_panel("nothing", "nothing", "", [empty]) == []


def read_section(page, name):
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
         "over the <left> border; start nearer"]]  # fmt: skip
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
    rate = proportion(5, 6)
    for row, median in zip(rows[1:3], (5.0, 6.0), strict=True):  # mm
        assert row[1] == f"5 of 6 [{100 * rate.low:.0f}, {100 * rate.high:.0f}] %"
        assert float(row[2].split()[0]) == median and row[-1] == "5 of 6"
    assert [row[0] for row in rows[4:]] == [run.name for run in runs]
    alone = [replace(run, settings={"gain": f"{i}"}) for i, run in enumerate(runs)]
    page = write_report(alone, tmp_path, ())[0].read_text()
    assert [row[0] for row in read_section(page, "headline")[:2]] == ["group", "all runs"]


def test_what_a_run_lacks_is_explained(tmp_path):
    run = made_run(1, 1.6)
    lacking = replace(run, states=(), pose=run.pose[:0], cameras={}, joint_names=(),
                      joint_units=(), measured_positions=run.measured_positions[:, :0],
                      measured_velocities=run.measured_velocities[:, :0],
                      joint_commands=run.joint_commands[:, :0],
                      position_limits=(np.zeros(0), np.zeros(0)), speed_limits=np.zeros(0))
    page = html.unescape(write_report([lacking], tmp_path, ())[0].read_text())
    for told in ("No curve: the loop has processed no image.", "No image is stored",
                 "Joints (needs joints that move the camera)",
                 "Errors (needs images that the scheme has measured)"):  # fmt: skip
        assert told in page


def test_the_library_is_the_one_that_is_meant():
    assert "var uPlot=" in uplot.read_uplot(uplot.SCRIPT)
    assert ".u-over" in uplot.read_uplot(uplot.STYLE)
    with pytest.raises(BenchError, match="uplot.min.css is missing or .*: pip install"):
        uplot.read_uplot((uplot.STYLE[0], "0" * 64))
