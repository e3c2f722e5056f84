"""Every number of a report, recomputed from the arrays of the run by independent code."""

from __future__ import annotations

import base64
import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from made_run import (
    GOAL,
    JOINT_UNITS,
    JOINTS,
    LOWER,
    NAMES,
    UNITS,
    UPPER,
    K,
    corners_seen,
    made_run,
)
from scipy import integrate

from aras_visual_servo_bench.cli.analyze import write_reports
from aras_visual_servo_bench.metrics import metrics


@pytest.fixture(scope="module")
def runs():
    return [made_run(3, 1.6), made_run(4, 2.3)]


@pytest.fixture(scope="module")
def written(runs, tmp_path_factory):
    path = tmp_path_factory.mktemp("recomputed")
    write_reports(runs[:1], path / "one", ())
    write_reports(runs, path / "both", ())
    return path


def ways(run):
    """Return time (s), distance (m) and angle (rad) to the goal at the joint states of servoing."""
    after = run.joint_stamp >= run.states[0].stamp
    poses = run.true_pose[after]
    distance = np.sqrt(((poses[:, :3, 3] - GOAL[:3, 3]) ** 2).sum(axis=1))
    cosine = (np.einsum("nij,ij->n", poses[:, :3, :3], GOAL[:3, :3]) - 1) / 2
    return pd.DataFrame({"t": run.joint_stamp[after] - run.states[0].stamp, "distance": distance,
                         "angle": np.arccos(np.clip(cosine, -1, 1))})  # fmt: skip


def errors(run):
    table = {
        s.stamp - run.states[0].stamp: s.scheme_output.error for s in run.states if s.scheme_output}
    return pd.DataFrame.from_dict(table, orient="index", columns=list(NAMES))


def stays(series, bound):
    last = series[series > bound].index.max()
    return series.index[series.index > last].min()


def decays(gain, tau, period):
    """Decay of the loop, stepped: each exposure's velocity holds from tau after it on."""
    n = int(tau // period)
    rest = tau - n * period
    s = [1.0] * (n + 2)
    for _ in range(600):
        s.append(s[-1] - gain * ((period - rest) * s[-1 - n] + rest * s[-2 - n]))
    return -math.log(s[-1] / s[-201]) / (200 * period)


def recomputed(run):
    way, error = ways(run), errors(run)
    after = run.joint_stamp >= run.states[0].stamp
    path = np.sqrt((np.diff(run.true_pose[after][:, :3, 3], axis=0) ** 2).sum(axis=1)).sum()
    since = way.set_index(way.t - way.t[0])  # the first joint state of the run
    settled = max(stays(since[name], 0.02 * since[name].iloc[0]) for name in ("distance", "angle"))
    seen, depth = corners_seen(run)
    pixel = np.stack([K[0] * seen[..., 0] / seen[..., 2] + K[2] + 0.5,
                      K[4] * seen[..., 1] / seen[..., 2] + K[5] + 0.5])  # fmt: skip
    half = np.array([320.0, 200.0])[:, None, None]
    parts = error / error.abs().max()
    norm = (parts**2).sum(axis=1) ** 0.5
    of_first = ((error / error.iloc[0].abs()) ** 2).sum(axis=1) ** 0.5
    of_first /= of_first.iloc[0]
    begin, end = (of_first[of_first < part].index[0] for part in (0.8, 0.15))
    line = of_first[begin:end].iloc[:-1]
    speed = run.measured_velocities[after]
    q, lasting = run.measured_positions[after], np.append(np.diff(run.joint_stamp[after]), 0.0)
    margin = 1e-3 * (UPPER - LOWER)
    at_limit = ((q <= LOWER + margin) | (q >= UPPER - margin)).any(axis=1)
    L, LJ = (np.array([getattr(s.ik_solution, name) for s in run.states])
             for name in ("singular_values_L", "singular_values"))  # fmt: skip
    record = run.cameras["camera"]
    gaps = pd.Series(record.stamp).diff().dropna()
    waited = record.arrival - record.stamp
    pace = pd.DataFrame(run.real_time_factors, columns=["stamp", "factor"])
    pace = pace[pace.stamp >= run.states[0].stamp]
    stamp = np.array([s.stamp for s in run.states])
    return {
        "success": 1.0, "reached": 1.0, "contradicts": 0.0,
        "reduced": float(way.distance[0] >= 10 * 4.17e-4 and way.angle[0] >= 10 * 0.00521),
        "iterations": len(run.states) - 1, "settled": settled,
        "overshoot": max((-np.sign(error.iloc[0]) * error / error.iloc[0].abs()).max().max(), 0),
        "final_distance": 4.17e-4, "final_angle": 0.00521,
        "open_distance": 3.1e-4, "open_angle": 0.0123,
        "start_distance": way.distance[0], "start_angle": way.angle[0],
        "path_length": path, "path_ratio": path / way.distance[0], "largest_depth": depth.max(),
        "image_excursion": np.abs(pixel / half - 1).max(),
        "energy": integrate.trapezoid((speed**2).sum(axis=1), run.joint_stamp[after]),
        "limit_time": lasting[at_limit].sum(),
        "decay_rate": -np.polynomial.Polynomial.fit(line.index, np.log(line), 1).convert().coef[1],
        "decay_predicted": decays(1.7, 0.043 + 0.005 + run.experiment.lag,
                                  pd.Series(stamp).diff().median()),
        "error_settled": stays(norm, 0.02 * norm.iloc[0]),
        "servoing_time": stamp[-1] - stamp[0],
        "top_speed": max(math.hypot(*s.ik_solution.achieved_twist[:3]) for s in run.states),
        "smallest_singular_value": LJ.min(), "condition_L": (L.max(axis=1) / L.min(axis=1)).max(),
        "manipulability": LJ.prod(axis=1).min(),
        "scale": min(s.ik_solution.scale for s in run.states),
        "images": len(record.stamp), "image_rate": 1 / gaps.mean(),
        "images_late": 3 + (waited > 1.5 * gaps.median()).sum(),
        "delay": 1e3 * waited.mean(),
        "computing": 1e3 * np.mean([s.computation_time for s in run.states]),
        "real_time_factor": pace.factor.mean(),
        **{f"final_error_{n}": error[n][error.index >= error.index[-1] - 1.0].mean()
           for n in NAMES},
        **{f"worst_error_{n}": error[n][error.index >= error.index[-1] - 2.0].abs().max()
           for n in NAMES}}  # fmt: skip


def shows(text, value, digits):
    """Return whether a printed number is this value, rounded to its digits; yes is 1, no is 0."""
    if text in ("yes", "no"):
        return value == (text == "yes")
    if value == 0:
        return text == "0"
    step = 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)
    return abs(float(text) - value) <= 0.50001 * max(step, 1e-12)


def test_every_number_of_the_files_is_recomputed(runs, written):
    wanted = recomputed(runs[0])
    text = (written / "one/summary.json").read_text()
    told = json.loads(text)
    assert text == json.dumps(told, indent=2, ensure_ascii=False) + "\n"  # a line a number
    rows = pd.read_csv(written / "one/summary.csv").set_index("quantity")
    assert set(wanted) == set(rows.index) - {"outcome", "verdict", "reason", "remedy"}
    for name, value in wanted.items():
        assert told[name] == pytest.approx(value, rel=1e-6, abs=1e-9), name
        assert float(rows.value[name]) == told[name], name
    units = {name: "s" for name in ("settled", "error_settled", "limit_time", "servoing_time")}
    units |= {f"{at}_{what}": unit for at in ("start", "final", "open")
              for what, unit in (("distance", "m"), ("angle", "rad"))}  # fmt: skip
    units |= {"path_length": "m", "largest_depth": "m", "energy": "rad²/s", "decay_rate": "1/s",
              "decay_predicted": "1/s", "top_speed": "m/s", "image_rate": "Hz", "delay": "ms",
              "computing": "ms"}  # fmt: skip
    units |= {f"{at}_error_{name}": unit for at in ("final", "worst")
              for name, unit in zip(NAMES, UNITS, strict=True) if unit}  # fmt: skip
    assert told["units"] == units and rows.unit.dropna().to_dict() == units


SIZES = {"mm": 1e-3, "µm": 1e-6, "ms": 1e-3, "µs": 1e-6, "mm/s": 1e-3, "µm/s": 1e-6,
         "°": math.pi / 180, "°/s": math.pi / 180}  # fmt: skip


def divide(name, value, shown, folder):
    stored = json.loads((folder / "summary.json").read_text())["units"].get(name, "")
    return value * SIZES.get(stored, 1.0) / SIZES.get(shown, 1.0)


def test_every_number_of_the_page_is_recomputed(runs, written):
    wanted = recomputed(runs[0])
    page = (written / "one/report.html").read_text()
    both = (written / "both/report.html").read_text()
    assert 'id="comparison"' not in page and 'class="tile"' not in both
    cells = r"<tr><td><code>(\w+)</code></td>\n<td class=\"(?:number)?\">(.*?)</td><td>(.*?)</td>"
    numbers = {name: (text, unit) for name, text, unit in re.findall(cells, page)}
    for name, value in wanted.items():
        text, unit = numbers[name]
        assert shows(text, divide(name, value, unit, written / "one"), 4), (name, text, unit, value)
        is_binary = name in metrics.METRICS and metrics.METRICS[name].is_binary
        assert (text in ("yes", "no")) == is_binary, name
    assert [numbers[name][1] for name in ("final_distance", "final_angle")] == ["mm", "°"]
    tiles = dict((text, value) for value, text in re.findall(
        r'class="tile"><b>(.*?)</b><span>(.*?)</span>', page))  # fmt: skip
    assert len(tiles) == 8
    for text, key, factor, unit in (
        ("settling time (to 2 % of the initial distance)", "settled", 1, " s"),
        ("final position error", "final_distance", 1e3, " mm"),
        ("final orientation error", "final_angle", 180 / math.pi, "°"),
        ("path length / length of the straight path", "path_ratio", 1, ""),
        ("decay rate of the error", "decay_rate", 1, " 1/s"),
        ("largest condition number of L", "condition_L", 1, ""),
        ("image rate (simulated time)", "image_rate", 1, " Hz"),
        ("real-time factor", "real_time_factor", 1, " ×"),
    ):  # fmt: skip
        value = tiles[text]
        assert value.endswith(unit), text
        assert shows(value.removesuffix(unit), factor * wanted[key], 3), text


def test_a_comparison_s_cells_and_stars_are_recomputed(runs, written):
    both = [recomputed(run) for run in runs]
    assert {path.name for path in (written / "both/data").iterdir()} == {
        f"{run}_{kind}.csv" for run in (1, 2) for kind in ("images", "joints")}  # fmt: skip
    page = (written / "both/report.html").read_text()
    page = page.partition('id="comparison"')[2].partition("</section>")[0]
    headed = re.findall(r'<td title=".*?">(\w+)(?: \((.*?)\))?</td>\n(.*?)</tr>', page, re.S)
    rows = {name: (unit, re.findall(r'class="number( best)?" data-run="\d">(.*?)</td>', cells))
            for name, unit, cells in headed}  # fmt: skip
    for name in both[0]:
        unit, ((star, text), (other_star, other)) = rows[name]
        values = [divide(name, one[name], unit, written / "one") for one in both]
        assert shows(text, values[0], 4) and shows(other, values[1], 4), (name, text, other)
        if text != other and name in metrics.METRICS and metrics.METRICS[name].better:
            first = (values[0] < values[1]) == (metrics.METRICS[name].better == "smaller")
            assert (bool(star), bool(other_star)) == (first, not first), name
        else:
            assert not star and not other_star


def test_every_column_of_the_tables_is_of_the_records(runs, written):
    run, began = runs[0], runs[0].states[0].stamp
    images = pd.read_csv(written / "one/data/images.csv")
    axes = ["vx", "vy", "vz", "wx", "wy", "wz"]
    wanted = {"time [s]": [s.stamp - began for s in run.states],
              "stamp [s]": [s.stamp for s in run.states]}  # fmt: skip
    for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        unit = f" [{unit}]" if unit else ""
        for field, word in (("features", ""), ("desired", " desired"), ("error", " error"),
                            ("filtered_error", " filtered error")):  # fmt: skip
            wanted[f"{name}{word}{unit}"] = [
                getattr(s.scheme_output, field)[i] if s.scheme_output else math.nan
                for s in run.states]
    for i, axis in enumerate(axes):
        unit = "m/s" if i < 3 else "rad/s"
        wanted[f"{axis} desired [{unit}]"] = [s.ik_solution.desired_twist[i] for s in run.states]
        wanted[f"{axis} achieved [{unit}]"] = [s.ik_solution.achieved_twist[i] for s in run.states]
    told = [s.ik_solution.recorded_singular_values for s in run.states]
    wanted |= {"condition of L": [max(L) / min(L) for L, _ in told],
               "condition of L J": [max(LJ) / min(LJ) for _, LJ in told],
               "manipulability": [math.prod(LJ) for _, LJ in told],
               "scale": [s.ik_solution.scale for s in run.states],
               "computing [s]": [s.computation_time for s in run.states]}  # fmt: skip
    wanted |= {f"camera {axis} [m]": run.pose[:, i, 3] for i, axis in enumerate("xyz")}
    same(images, wanted, {"phase", "outcome", "reason"})
    joints = pd.read_csv(written / "one/data/joints.csv")
    wanted = {"time [s]": run.joint_stamp - began, "stamp [s]": run.joint_stamp}
    for i, (name, unit) in enumerate(zip(JOINTS, JOINT_UNITS, strict=True)):
        wanted |= {f"{name} [{unit}]": run.measured_positions[:, i],
                   f"{name} speed [{unit}/s]": run.measured_velocities[:, i],
                   f"{name} command [{unit}]": run.joint_commands[:, i]}  # fmt: skip
    wanted |= {f"camera {axis} [m]": run.true_pose[:, i, 3] for i, axis in enumerate("xyz")}
    same(joints, wanted, set())


def same(table, wanted, words):
    assert set(table) == {*wanted, *words}
    for name, values in wanted.items():
        np.testing.assert_allclose(table[name], values, rtol=1e-8, atol=1e-12, err_msg=name)


def test_every_curve_of_the_page_is_of_the_records(runs, written):
    run, began = runs[0], runs[0].states[0].stamp
    page = (written / "one/report.html").read_text()
    told = json.loads(re.search(r'id="contents">(.*?)</script>', page, re.S)[1])
    arrays = [np.frombuffer(base64.b64decode(text), "<f4") for text in told["arrays"]]
    keys = [group["key"] for group in told["groups"]]
    assert keys == ["feature_errors", "pose_errors", "features", "camera_twist", "joint_positions",
                    "conditioning", "timing"]  # fmt: skip
    assert keys == re.findall(r'<section id="(\w+)"[^>]*>.*\n<div class="panels">', page)
    assert keys == re.findall(r'<a href="#(\w+)">', page)[:-2]
    panels = {p["title"]: p for group in told["groups"] for p in group["panels"]}
    curves = {(title, c["name"]): pd.Series(arrays[c["y"]], arrays[c["x"]]).dropna()
              for title, p in panels.items() for c in p["curves"]}  # fmt: skip
    seen = set()

    def check(title, name, time, values):
        known = np.isfinite(values)
        found = curves[title, name]
        np.testing.assert_allclose(found.index, np.asarray(time)[known], atol=1e-6, err_msg=title)
        np.testing.assert_allclose(found, np.asarray(values)[known], rtol=1e-5, atol=1e-6)
        seen.add((title, name))

    time = np.array([s.stamp - began for s in run.states])
    error = errors(run)
    for name, unit in zip(NAMES, UNITS, strict=True):
        tail = f" ({unit})" if unit else ""
        check(f"error{tail}", f"{name} as measured", error.index, error[name])
        check(f"error{tail}", name, error.index, 0.9 * error[name])
        wanted = error[name] + dict(zip(NAMES, (1.3, 0.34, -0.2), strict=True))[name]
        check(f"feature{tail}", name, error.index, wanted)
        check(f"feature{tail}", f"{name}*", error.index, wanted - error[name])
    norm = ((error / error.abs().max()) ** 2).sum(axis=1) ** 0.5
    check("norm of the errors, relative", "norm, relative", error.index, norm / norm.iloc[0])
    way = ways(run)
    check("distance to the goal (mm)", "distance", way.t, 1e3 * way.distance)
    check("angle to the goal (degrees)", "angle", way.t, np.degrees(way.angle))
    numbers = recomputed(run)
    for title, key in (("norm of the errors, relative", "error_settled"),
                       ("distance to the goal (mm)", "settled")):  # fmt: skip
        assert panels[title]["marks"] == [[pytest.approx(numbers[key]), "settled"]], title
    for i, name in enumerate(("vx", "vy", "vz", "ωx", "ωy", "ωz")):
        title = "linear velocity of the camera (m/s)" if i < 3 else (
            "angular velocity of the camera (rad/s)")  # fmt: skip
        check(title, name, time, [s.ik_solution.achieved_twist[i] for s in run.states])
        check(title, f"{name} desired", time, [s.ik_solution.desired_twist[i] for s in run.states])
    shown = run.joint_stamp >= began - 0.1
    at = run.joint_stamp[shown] - began
    for i, (name, unit) in enumerate(zip(JOINTS, JOINT_UNITS, strict=True)):
        check(f"{name} ({unit})", "measured", at, run.measured_positions[shown, i])
        check(f"{name} ({unit})", "commanded position", at, run.joint_commands[shown, i])
        check(f"{name}, speed ({unit}/s)", "measured", at, run.measured_velocities[shown, i])
        assert panels[f"{name} ({unit})"]["limits"] == [[LOWER[i], "least"], [UPPER[i], "greatest"]]
        top = (0.3, 1.9, 2.7)[i]
        assert panels[f"{name}, speed ({unit}/s)"]["limits"] == [[-top, "limit"], [top, "limit"]]
    told = [s.ik_solution.recorded_singular_values for s in run.states]
    check("condition number", "L", time, [max(L) / min(L) for L, _ in told])
    check("condition number", "L J", time, [max(LJ) / min(LJ) for _, LJ in told])
    check("manipulability", "manipulability", time, [math.prod(LJ) for _, LJ in told])
    title = "factor by which limits reduced the twist"
    check(title, "scale", time, [s.ik_solution.scale for s in run.states])
    record = run.cameras["camera"]
    after = record.stamp >= began
    gaps = pd.Series(record.stamp).diff().to_numpy()
    at = record.stamp[after] - began
    check("interval between images (ms)", "interval", at, 1e3 * gaps[after])
    waited = 1e3 * (record.arrival - record.stamp)
    check("delay (ms)", "exposure to recorder", at, waited[after])
    check("delay (ms)", "scheme computing", time, [1e3 * s.computation_time for s in run.states])
    pace = run.real_time_factors[np.isfinite(run.real_time_factors[:, 1])]
    pace = pace[pace[:, 0] >= began]
    check("real-time factor", "real-time factor", pace[:, 0] - began, pace[:, 1])
    assert seen == set(curves)
