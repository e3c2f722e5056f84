"""Shipped protocols: published numbers, start poses, tables."""

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import CameraPoseSpec, Experiment
from aras_visual_servo_bench.experiment.starts import RelativeStart
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.studies.results import is_met
from aras_visual_servo_bench.studies.study import Study

sys.path.insert(0, str(Path(__file__).parents[3] / "docs"))  # the page of schemes is made there
import schemes_pictures
from schemes_page import main as page
from schemes_page import read, speed_part

STUDIES = Path(__file__).parents[3] / "src/aras_visual_servo_bench/config/studies"
SHIPPED = {path.stem: path for path in STUDIES.glob("*.yaml")}
SQUARE = ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))
GOAL = CameraPoseSpec((0.0, 0.0, -0.75, 0.0, 0.0, 0.0))
FLIGHT = Experiment.from_mapping({
    "plant": "ideal", "features": "exact", "target": {"shape": SQUARE}, "goal": GOAL,
    "camera": {"width": 640, "height": 480, "horizontal_fov": 0.761, "update_rate": 25.0},
    "start": {"pose": [0.05, 0.02, -0.9, 0.0, 0.1, 0.3]}, "scheme": "numbered_points",
    "gain": 0.5, "duration": 30.0, "reached": [1e-3, 0.01],
})  # fmt: skip


def table(folder):
    with open(folder / "table.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def rows_of(name, out, *arguments):
    """Return the rows that the command of a protocol writes."""
    assert main(["protocol", name, "--out", str(out), "--in-process", *arguments]) == 0
    return table(out)


def test_visp_four_points_to_the_iteration(tmp_path):
    rows = rows_of("visp_four_points", tmp_path)
    assert [int(row["iterations"]) for row in rows] == [191, 91, 98, 211, 203]
    assert {row["outcome"] for row in rows} == {"converged"}
    assert all(row["met"] == "true" for row in rows)
    # As the engine of the protocols had them that went before this one.
    lengths = [0.369218, 0.369984, 0.365715, 0.421304, 0.350941]
    assert [float(row["path_length"]) for row in rows] == pytest.approx(lengths, abs=1e-6)
    depths = [1.011355, 1.011082, 1.008578, 1.0, 1.0]
    assert [float(row["largest_depth"]) for row in rows] == pytest.approx(depths, abs=1e-6)


@pytest.mark.parametrize(("start", "steps"), [
    ([0.0, 0.0, -3.0, 0.0, 0.0, 0.6], 82), ([1.0, 1.0, -3.0, 0.0, 0.0, 1.0], 86),
])  # fmt: skip
def test_corke_s_four_points_take_as_many_steps_as_in_his_toolbox(start, steps):
    """His example (machinevision-toolbox-python 2.4.1, class IBVS with exact depth): a focal length
    of 800 px, gain 0.08 a step, until the error's norm is below 0.5 px. It takes the same steps."""
    keys = {
        "plant": "ideal", "features": "exact", "scheme": "numbered_points", "gain": 2.0,
        "camera": {"width": 1024, "height": 1024, "update_rate": 25.0,
                   "camera_matrix": {"fx": 800.0, "fy": 800.0, "cx": 512.0, "cy": 512.0}},
        "ideal": {"speed": None, "stop": (0.5 / 800.0) ** 2, "unbounded": True},
        "target": {"shape": [[-0.25, -0.25], [-0.25, 0.25], [0.25, 0.25], [0.25, -0.25]],
                   "pose": [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]},
        "goal": {"pose": [0.0, 0.0, 2.0, 0.0, 0.0, 0.0]}, "start": {"pose": start},
        "duration": 20.0, "reached": [1e-3, 1e-3],
    }  # fmt: skip
    result = run(Experiment.from_mapping(keys))
    assert result.outcome == "converged" and result.verdict.is_reached
    assert len(result.stamp) == steps


def test_camera_retreat(tmp_path):
    rows = rows_of("camera_retreat", tmp_path, "--case", "L current, 40 ms")
    assert len(rows) == 6
    assert [row["start"] for row in rows if row["met"] != "true"] == []
    depth = {row["start"]: float(row["largest_depth"]) for row in rows}
    assert depth["120"] == pytest.approx(1.519, rel=0.01)
    assert rows[5]["outcome"] == "camera_retreat"


@pytest.mark.parametrize("name", [
    "camera_retreat", "canonical", "convergence_domain", "paper_basin", "visp_four_points",
])  # fmt: skip
def test_a_published_protocol_says_its_source_and_what_was_chosen(name):
    study = Study.from_yaml(SHIPPED[name])
    assert study.source and study.chosen and study.make_experiment(0).seed == 0


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"experiment": {}, "cases": {"start": [{"name": "a", "set": {"strt": 1}}]}}, "start"),
        ({"cases": {"start": [{"name": "a", "set": {"start": {"kind": "turnd"}}}]}}, "turned"),
        ({"cases": {"start": [{"name": "a"}, {"name": "a"}]}}, "two cases are named 'a'"),
        ({"cases": {"start": [{"name": "a", "cases": {"strt": []}}]}}, "cases.strt: it has no"),
        ({"cases": {"start": [{"name": "a", "cases": {"strt": [{"name": "b"}]}}],
                    "other": [{"name": "c"}]}}, "cases.start.a.cases"),
        ({"cases": {"gain": [{"name": "a"}]}, "vary": {"gain": [1.0]}}, "both under vary and in"),
        ({"repeats": 0}, "repeats"),
        ({"sourc": ""}, "source"),
    ],
)  # fmt: skip
def test_a_wrong_key_is_one_line(tmp_path, capsys, values, named):
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(values))
    assert main(["protocol", str(tmp_path / "mine.yaml"), "--out", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert named in told
    assert told.count("\n") == 1


def test_an_unknown_protocol_names_the_nearest(tmp_path, capsys):
    assert main(["protocol", "visp_four_point", "--out", str(tmp_path)]) == 1
    assert "did you mean 'visp_four_points'?" in capsys.readouterr().err
    assert main(["protocol", "visp_four_points", "--out", str(tmp_path), "--case", "lambda 5"]) == 1
    assert "case 'lambda 5': " in capsys.readouterr().err


MINE = {
    "repeats": 3, "seeds": "counted", "seed": 4, "metrics": ["reached", "start_distance",
                                                             "start_angle"],
    "experiment": {
        "plant": "ideal", "features": "exact", "scheme": "numbered_points", "duration": 0.2,
        "target": {"shape": [list(corner) for corner in SQUARE]},
        "goal": {"pose": [0.0, 0.0, -0.75, 0.0, 0.0, 0.0]},
    },
    "cases": {
        "scheme": [
            {"name": "slow", "set": {"gain": 0.5}, "published": {"outcome": "timed_out"}},
            {"name": "fast", "set": {"gain": 2.0}, "published": {"start_angle": 0.1},
             "cases": {"start": [{"name": "back", "set": {"start": {"kind": "back",
                                                                    "distance": 0.2}}}]}},
        ],
        "start": [
            {"name": "turned", "set": {"start": {"kind": "turned", "angle": 5.0}}},
            {"name": "fast", "set": {"start": {"kind": "turned", "angle": 9.0}, "gain": 4.0}},
        ],
    },
}  # fmt: skip


def test_axes_of_cases_are_multiplied_and_a_case_may_have_its_own(tmp_path):
    study = Study.from_mapping(MINE)
    names = [tuple(case.names.values()) for case in study.combinations]
    assert names == [("slow", "turned"), ("slow", "fast"), ("fast", "back")]
    assert study.keys == ("scheme", "start")
    # Of what two cases set, the later axis' holds.
    assert [study.make_experiment(3 * point).gain for point in range(3)] == [0.5, 4.0, 2.0]
    assert [study.compute_seed(run) for run in range(9)] == [4, 5, 6] * 3
    assert [study.make_experiment(run).seed for run in (0, 4, 8)] == [4, 5, 6]
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(MINE))
    rows = rows_of(str(tmp_path / "mine.yaml"), tmp_path / "out")
    assert [(row["scheme"], row["start"], row["seed"]) for row in rows[2:4]] == [
        ("slow", "turned", "6"), ("slow", "fast", "4")]  # fmt: skip
    assert [row["met"] for row in rows] == ["true"] * 6 + ["false"] * 3
    assert rows[0]["published"] == "outcome timed_out"
    assert float(rows[3]["start_angle"]) == pytest.approx(np.radians(9.0))
    assert float(rows[6]["start_distance"]) == pytest.approx(0.2)


def test_words_about_a_study_change_nothing_of_it():
    other = Study.from_mapping({**MINE, "source": "a paper", "chosen": ["this"]})
    assert other.digest == Study.from_mapping(MINE).digest
    assert Study.from_mapping({**MINE, "seed": 5}).digest != other.digest


@pytest.mark.parametrize(
    ("value", "published", "expected"),
    [(191, 191, True), (190, 191, False), (0.869, 0.868, True), (0.88, 0.868, False),
     (252.0, 250.0, True), (0.00399, 0.004, True), (0.0041, 0.004, False),
     (3.0, [2.9, 3.0], True), (3.01, [2.9, 3.0], False), (2.9, [2.9, 3.0], True),
     ("converged", "converged", True),
     ("x", "converged", False), (None, 3, False), (None, 1.5, False)],
)  # fmt: skip
def test_met(value, published, expected):
    assert is_met(value, published) is expected


# -- the ideal plant ---------------------------------------------------------------------------


def test_the_error_decays_as_the_law_says():
    result = run(FLIGHT)
    assert result.converged
    assert result.verdict.is_reached
    # In the small, e shrinks by exp(-lambda dt) an image.
    late = np.linalg.norm(result.error, axis=1)[150:200]
    assert late[1:] / late[:-1] == pytest.approx(np.exp(-0.5 * 0.04), rel=2e-3)
    assert result.compute_settling_time() == pytest.approx(np.log(50.0) / 0.5, rel=0.15)


def test_a_mounting_believed_elsewhere_moves_the_camera_otherwise():
    askew = FLIGHT.with_changes(calibration_offset={"rpy": [0.0, 0.0, 0.3]}, duration=0.1)
    first = run(askew)
    moved = np.linalg.inv(first.pose[0]) @ first.pose[1]
    # The twist asked for is that of a frame turned by 0.3 rad about the optical axis.
    turned = matrix_from_xyz_rpy((0, 0, 0), (0, 0, 0.3))[:3, :3] @ first.desired_twist[0, 3:]
    rate = np.array([moved[2, 1], moved[0, 2], moved[1, 0]]) / 0.04
    assert rate == pytest.approx(turned, abs=1e-3)


@pytest.mark.parametrize("interaction", ["desired", "mean"])
def test_another_interaction_matrix_is_no_wrong_camera(interaction):
    turned = CameraPoseSpec((0.0, 0.0, -0.75, 0.0, 0.0, 1.5))
    result = run(FLIGHT.with_changes(
        gain=2.0, start=turned, controller_parameters={"interaction": interaction},
        ideal={"unbounded": True},
    ))  # fmt: skip
    assert set(result.outcomes) <= {"running", "converged"}


def test_a_moving_target_stays_behind_by_speed_over_gain():
    motion = {"velocity": [0.01, 0.0, 0.0, 0.0, 0.0, 0.0]}
    result = run(FLIGHT.with_changes(target={"shape": SQUARE, "motion": motion}, duration=15.0))
    assert result.verdict.distance == pytest.approx(0.01 / 0.5, rel=0.05)


FOUR = ((-0.1, -0.1), (0.1, -0.08), (0.08, 0.1), (-0.06, 0.06))  # without symmetry
ASKEW = RelativeStart("plane", angle=40.0, scatter=(0.01, 2.0))
TURNED = RelativeStart("turned", angle=90.0, scatter=(0.01, 2.0))
SKEWED = FLIGHT.with_changes(
    target={"shape": FOUR}, gain=2.0, duration=12.0,
    ideal={"unbounded": True, "speed": [1.0, 1.57]},
    goal={"pose": [0.0, 0.0, -0.6, 0.0, 0.0, 0.0]}, reached=[5e-3, 0.02],
    controller_parameters={"hold": 0.4},
)  # fmt: skip


@pytest.mark.parametrize(
    ("scheme", "start", "outcome"),
    [
        ("moments_six", TURNED, "ambiguous"),  # told by the third order alone
        ("gravity_centre_normalised+area_normalised+invariants+alpha", ASKEW, "converged"),
        ("ellipse+alpha", ASKEW, "converged up to 1 direction"),  # the ellipse tells alpha
        ("gravity_centre+area", ASKEW, "ambiguous"),
        ("numbered_points", ASKEW, "converged"),
    ],
)
def test_equal_features_of_another_pose_are_not_called_the_goal(scheme, start, outcome):
    result = run(SKEWED.with_changes(scheme=scheme, start=start, seed=0))
    assert result.outcome == outcome, result.reason
    assert result.verdict.is_reached is (outcome == "converged")


def test_a_flight_that_measures_nothing_any_more_has_lost_its_target():
    turned = SKEWED.with_changes(scheme="ellipse+alpha", start=replace(TURNED, angle=180.0), seed=0)
    result = run(turned)
    assert result.outcome == "target_lost"
    assert "alpha_full" in result.reason


def test_enough_by_the_truth_ends_the_run_and_so_does_too_far():
    near = run(FLIGHT.with_changes(ideal={"enough": 0.1}))
    assert near.outcome == "converged"
    way = near.pose_error_history()
    assert way[0][-1] <= 0.1 * way[0][0] < way[0][-3]
    back = FLIGHT.with_changes(
        start=CameraPoseSpec((0.0, 0.0, -0.8, 0.0, 0.0, 3.0)), ideal={"farthest": 2.0}
    )
    far = run(back)
    assert not far.converged
    assert len(far.stamp) < 200


# -- the page --------------------------------------------------------------------------------------


HEADS = ("scheme,condition,start,seed,verdict,outcome,settled,final_distance,final_angle,"
         "path_ratio,image_excursion,reached")  # fmt: skip


def test_the_page_is_made_of_the_tables(tmp_path, capsys):
    lines, angle = [HEADS], np.radians(0.2)
    lines += [f"one,clean,turn 90,{n},goal_reached,converged,1.5,0.001,{angle},1.1,0.2,1"
              for n in "012"]  # fmt: skip
    lines += ["one,clean,turn 90,3,goal_missed,camera_retreat,nan,2,9,nan,0.3,0"]
    lines += [f"two,clean,turn 90,{n},goal_missed,ambiguous,nan,2,9,nan,0.3,0" for n in "0123"]
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    heads = "scheme,condition,start,seed,verdict,outcome,reduced,iterations,path_ratio"
    rows = ["feature points,clean,box,0,goal_missed,converged,1,40,1.2",
            "feature points,clean,box,1,goal_missed,target_lost,0,9,1.4"]  # fmt: skip
    (tmp_path / "domain.csv").write_text("\n".join([heads, *rows]) + "\n")
    out = tmp_path / "page.md"
    tables = ["--canonical", str(tmp_path / "table.csv"), "--domain", str(tmp_path / "domain.csv")]
    assert page([*tables, "--out", str(out), "--no-pictures"]) == 0
    text = out.read_text()
    first = text.split("Every visual servoing scheme")[0].splitlines()
    assert first[4:7] == [
        "- *Canonical tasks, clean*: 3 of 4 runs reach the goal with each of these schemes: one. "
        "The median success rate of all 2 schemes is 38 %.",
        "- In the canonical tasks, all schemes together reach the goal in 38 % (turn 90) of the "
        "runs; the task 'turn 90' is the hardest.",
        "- *Rendered, clean*: 1 of 2 runs converge with each of these schemes: feature points. The "
        "median success rate of all 1 schemes is 50 %. The published rate is 89.6 % (ViT-VS, "
        "SIFT).",
    ]
    assert "| one | clean | 3/4 |" in text
    assert "| 3 of 4 (30-95 %) | 1.50 | 1.000 | 0.200 | 1.10 | 0.20 | camera_retreat 1 |" in text
    assert "| two | 4 | -75.0 | 0 | 3 | 0.250 |" in text
    assert "| 1 of 2 (9-91 %) | 89.6 % (ViT-VS, SIFT) | 40 | 1.20 | target_lost 1 |" in text
    assert "### `polar_points`" in text
    assert "Iwatsuki" in text
    assert page(["--canonical", str(tmp_path / "none.csv"), "--out", str(out)]) == 1
    assert "cannot read" in capsys.readouterr().err


def test_its_pictures_are_drawn(tmp_path):
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(MINE))
    rows_of(str(tmp_path / "mine.yaml"), tmp_path / "out")
    schemes_pictures.draw_paths(Study.from_mapping(MINE), "turned", tmp_path / "ways.png")
    rows = [{"condition": "", **row} for row in read(tmp_path / "out" / "table.csv", "reached")]
    schemes_pictures.draw_success_map(rows, tmp_path / "map.png")
    for name in ("ways.png", "map.png"):
        drawn = cv2.imread(str(tmp_path / name))
        assert min(drawn.shape[:2]) > 100
        assert drawn.std() > 10.0


def test_what_a_measure_costs_stands_beside_visps(tmp_path):
    told = {"ours": {"lines": 91.4, "alpha": 52.9}, "visp": {"lines": 0.94, "moments_all": 111.9}}
    file = tmp_path / "speed.txt"
    file.write_text("lines   91.4 us\n" + json.dumps(told) + "\n")
    table = [line for line in speed_part(file).splitlines() if line.startswith("|")]
    assert table[2:] == ["| lines | 91 | 0.9 |", "| alpha | 53 |  |", "| moments_all |  | 111.9 |"]
    file.write_text("not that program\n")
    with pytest.raises(ExperimentError, match="run it with --visp"):
        speed_part(file)
