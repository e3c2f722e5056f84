"""The protocols that ship: published figures to the iteration, starts where they say, tables."""

import csv
import json
import pickle
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from aras_visual_servo_base.poses import pose_difference, transform
from aras_visual_servo_bench.asked.experiment import CameraPose, Experiment
from aras_visual_servo_bench.asked.protocol_starts import Placing, placed
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.pictures import schemes_pictures
from aras_visual_servo_bench.pictures.schemes_page import main as page
from aras_visual_servo_bench.pictures.schemes_page import speed_part, succeeded
from aras_visual_servo_bench.running.loop import run
from aras_visual_servo_bench.study import protocol as protocols
from aras_visual_servo_bench.study.protocol import Protocol, main, met

PROTOCOLS = Path(__file__).parents[3] / "src" / "aras_visual_servo_bench" / "protocols"
SHIPPED = sorted(PROTOCOLS.glob("*.yaml"))
SQUARE = ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))
GOAL = CameraPose((0.0, 0.0, -0.75, 0.0, 0.0, 0.0))
FLIGHT = Experiment.from_mapping({
    "plant": "ideal", "features": "exact", "target": {"shape": SQUARE}, "goal": GOAL,
    "camera": {"width": 640, "height": 480, "horizontal_fov": 0.761, "update_rate": 25.0},
    "start": {"pose": [0.05, 0.02, -0.9, 0.0, 0.1, 0.3]}, "scheme": "numbered_points",
    "gain": 0.5, "duration": 30.0, "reached": [1e-3, 0.01],
})  # fmt: skip


def table(folder):
    with open(folder / "table.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_visp_four_points_to_the_iteration(tmp_path):
    assert main(["visp_four_points", "--out", str(tmp_path)]) == 0
    rows = table(tmp_path)
    assert [int(row["iterations"]) for row in rows] == [191, 91, 98, 211, 203]
    assert {row["outcome"] for row in rows} == {"converged"}
    assert all(row["met"] == "True" for row in rows)


def test_camera_retreat(tmp_path):
    cases = ["--case", "L current, 40 ms", "--case", "L mean", "--case", "L desired"]
    assert main(["camera_retreat", "--out", str(tmp_path), *cases]) == 0
    rows = table(tmp_path)
    assert len(rows) == 18
    assert [row["start"] for row in rows if row["met"] != "True"] == []
    depth = {row["start"]: float(row["largest_depth"]) for row in rows[:6]}
    assert depth["120"] == pytest.approx(1.519, rel=0.01)
    assert rows[5]["outcome"] == "camera_retreat"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_file_is_checked_before_its_first_run(path):
    protocol = Protocol.load(str(path))
    assert protocol.source
    assert protocol.chosen
    assert next(iter(protocol.runs()))


@pytest.mark.parametrize("name", ["visp_four_points", "canonical"])
def test_blocks_go_to_other_processes_as_they_are(name):
    for block in protocols.blocks(replace(Protocol.load(name), seeds=1)):
        assert pickle.loads(pickle.dumps(block)) == block


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"source": "", "experiment": {"plnt": "ideal"}}, "plant"),
        ({"source": "", "experiment": {}, "starts": [{"kind": "turnd"}]}, "turned"),
        ({"source": "", "experiment": {}, "seeds": 0}, "seeds"),
        ({"source": "", "experimnt": {}}, "experiment"),
    ],
)
def test_a_wrong_key_is_one_line(tmp_path, capsys, values, named):
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(values))
    assert main([str(tmp_path / "mine.yaml"), "--out", str(tmp_path)]) == 1
    told = capsys.readouterr().err
    assert named in told
    assert told.count("\n") == 1


def test_an_unknown_protocol_names_the_nearest(tmp_path, capsys):
    assert main(["visp_four_point", "--out", str(tmp_path)]) == 1
    assert "did you mean 'visp_four_points'?" in capsys.readouterr().err


def test_what_cannot_be_run_is_an_outcome(tmp_path):
    (tmp_path / "mine.yaml").write_text(
        "source: mine\nexperiment: {plant: ideal, scheme: vanishing_points, features: exact,\n"
        "  goal: {pose: [0,0,-1,0,0,0]}, start: {pose: [0,0,-1,0,0,0]},\n"
        "  target: {shape: [[0,0],[.1,0],[.1,.1]]}}\n"
    )
    assert main([str(tmp_path / "mine.yaml"), "--out", str(tmp_path)]) == 0
    row = table(tmp_path)[0]
    assert row["outcome"] == "not_run"
    assert "four corners" in row["reason"]


MINE = {
    "source": "mine", "seeds": 3, "starts": [{"kind": "turned", "angle": 5.0}],
    "experiment": {
        "plant": "ideal", "features": "exact", "scheme": "numbered_points", "duration": 0.2,
        "target": {"shape": [list(corner) for corner in SQUARE]},
        "goal": {"pose": [0.0, 0.0, -0.75, 0.0, 0.0, 0.0]},
    },
    "cases": [{"name": "slow", "set": {"gain": 0.5}}, {"name": "fast", "set": {"gain": 2.0}}],
}  # fmt: skip


class Counted:
    """In place of the runner: answers as it does, and notes what was run."""

    def __init__(self):
        self.gains = []

    def __call__(self, experiment):
        self.gains.append(experiment.gain)
        if len(self.gains) == self.stop:
            raise KeyboardInterrupt
        return run(experiment)

    stop = None


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Runs the protocol of that content into one folder; answers what was run and the table."""
    counted = Counted()
    monkeypatch.setattr(protocols, "run", counted)

    def carry_out(content=MINE, *arguments, stop=None):
        (tmp_path / "mine.yaml").write_text(yaml.safe_dump(content))
        counted.gains, counted.stop = [], stop
        status = main([str(tmp_path / "mine.yaml"), "--out", str(tmp_path / "out"), *arguments])
        return status, counted.gains, table(tmp_path / "out")

    return carry_out


def test_what_was_interrupted_goes_on_with_what_is_missing(mine):
    status, _, rows = mine(stop=5)
    assert status == 130
    assert [row["case"] for row in rows] == ["slow"] * 3
    status, ran, rows = mine()
    assert (status, ran) == (0, [2.0] * 3)
    assert [(row["case"], row["seed"]) for row in rows] == [
        (case, str(seed)) for case in ("slow", "fast") for seed in range(3)
    ]
    assert mine()[1] == []


def test_only_what_a_change_touches_is_run_again(mine):
    _, _, before = mine()
    changed = {**MINE, "cases": [MINE["cases"][0], {"name": "fast", "set": {"gain": 3.0}}]}
    status, ran, rows = mine(changed)
    assert (status, ran) == (0, [3.0] * 3)
    assert rows[:3] == before[:3]
    assert rows[3:] != before[3:]


def test_cases_one_by_one_come_into_one_table(mine):
    assert [row["case"] for row in mine(MINE, "--case", "fast")[2]] == ["fast"] * 3
    assert [row["case"] for row in mine(MINE, "--case", "slow")[2]] == ["slow"] * 3 + ["fast"] * 3


def test_rows_of_other_code_are_not_mixed_unasked(mine, monkeypatch, capsys):
    mine()
    versions = dict(protocols.versions.versions())
    monkeypatch.setattr(protocols.versions, "versions", lambda: {**versions, "numpy": "0.1"})
    assert mine()[0] == 1
    assert "numpy 0.1 here" in capsys.readouterr().err
    assert mine(MINE, "--mix")[0] == 0


def test_a_cut_off_block_is_run_again(mine, tmp_path):
    mine()
    kept = sorted((tmp_path / "out" / "blocks").iterdir())
    kept[0].write_text(kept[0].read_text()[:40])
    status, ran, rows = mine()
    assert (status, len(ran), len(rows)) == (0, 3, 6)


@pytest.mark.parametrize(
    ("value", "published", "is_met"),
    [(191, 191, True), (190, 191, False), (0.869, 0.868, True), (0.88, 0.868, False),
     (3.0, [2.9, 3.0], True), (3.01, [2.9, 3.0], False), ("converged", "converged", True),
     ("x", "converged", False), (None, 3, False)],
)  # fmt: skip
def test_met(value, published, is_met):
    assert met(value, published) is is_met


# -- starts ----------------------------------------------------------------------------------


def start_of(placing, seed=0):
    return transform(*np.split(np.array(placed(FLIGHT, placing, seed).start.pose), [3]))


GOAL_POSE = transform(GOAL.pose[:3], GOAL.pose[3:])


def test_turned_stands_on_the_spot():
    distance, angle = pose_difference(GOAL_POSE, start_of(Placing("turned", angle=70.0)))
    assert (distance, np.degrees(angle)) == pytest.approx((0.0, 70.0), abs=1e-9)


def test_back_goes_along_the_axis_away_from_the_target():
    start = start_of(Placing("back", distance=0.4))
    assert start[:3, 3] == pytest.approx([0.0, 0.0, -1.15])


def test_plane_keeps_the_distance_and_looks_at_the_target():
    start = start_of(Placing("plane", angle=40.0))
    assert np.linalg.norm(start[:3, 3]) == pytest.approx(0.75)
    assert start[:3, :3].T @ -start[:3, 3] == pytest.approx([0, 0, 0.75], abs=1e-9)
    assert np.degrees(pose_difference(GOAL_POSE, start)[1]) == pytest.approx(40.0)


def test_looking_is_in_its_box_looks_at_a_circle_and_turns_by_the_seed():
    placing = Placing("looking", of=11)
    turns = []
    for seed in range(11):
        start = start_of(placing, seed)
        offset = np.abs(start[:3, 3] - GOAL_POSE[:3, 3])
        assert (offset <= (0.6, 0.6, 0.15)).all()
        forward = start[:3, 2]
        hit = start[:3, 3] - forward * start[2, 3] / forward[2]
        assert min(abs(np.hypot(hit[0], hit[1]) - np.array(placing.radii))) < 1e-9
        right = np.array([1.0, 0, 0]) - forward[0] * forward
        right /= np.linalg.norm(right)
        turns.append(np.degrees(np.arctan2(start[:3, 0] @ np.cross(forward, right),
                                           start[:3, 0] @ right)))  # fmt: skip
    assert turns == pytest.approx(np.linspace(-120.0, 120.0, 11), abs=1e-6)


def test_scatter_is_the_seed_s_own():
    placing = Placing("turned", angle=20.0, scatter=(0.02, 3.0))
    one, same, other = (start_of(placing, seed) for seed in (1, 1, 2))
    assert (one == same).all()
    assert not np.allclose(one, other)


# -- the ideal plant ---------------------------------------------------------------------------


def test_the_error_decays_as_the_law_says():
    result = run(FLIGHT)
    assert result.converged
    assert result.verdict.reached
    # In the small, e shrinks by exp(-lambda dt) an image.
    late = np.linalg.norm(result.error, axis=1)[150:200]
    assert late[1:] / late[:-1] == pytest.approx(np.exp(-0.5 * 0.04), rel=2e-3)
    assert result.settled() == pytest.approx(np.log(50.0) / 0.5, rel=0.15)


def test_the_same_seed_is_the_same_flight():
    noisy = FLIGHT.with_(jitter=0.3, duration=2.0)
    one, same, other = (run(noisy.with_(seed=seed)) for seed in (3, 3, 4))
    assert (one.pose == same.pose).all()
    assert not np.allclose(one.pose, other.pose)


def test_what_leaves_the_picture_is_lost_unless_it_has_no_border():
    away = FLIGHT.with_(start=CameraPose((0.0, 0.0, -0.75, 0.0, 0.5, 0.0)), duration=3.0)
    lost = run(away)
    assert lost.outcome == "target_lost"
    assert len(lost.stamp) < 10
    assert run(away.with_(ideal={"unbounded": True})).outcome != "target_lost"


def test_a_mounting_believed_elsewhere_moves_the_camera_otherwise():
    askew = FLIGHT.with_(believed={"rpy": [0.0, 0.0, 0.3]}, duration=1.0)
    straight = FLIGHT.with_(duration=1.0)
    assert not np.allclose(run(askew).pose[-1], run(straight).pose[-1], atol=1e-3)
    first = run(askew)
    moved = np.linalg.inv(first.pose[0]) @ first.pose[1]
    # The twist asked for is that of a frame turned by 0.3 rad about the optical axis.
    turned = transform((0, 0, 0), (0, 0, 0.3))[:3, :3] @ first.asked[0, 3:]
    rate = np.array([moved[2, 1], moved[0, 2], moved[1, 0]]) / 0.04
    assert rate == pytest.approx(turned, abs=1e-3)


def test_a_believed_focal_length_scales_what_is_seen():
    believed = run(FLIGHT.with_(believed={"focal": 1.1}, duration=0.1)).features[0]
    true = run(FLIGHT.with_(duration=0.1)).features[0]
    assert believed == pytest.approx(true / 1.1)


def test_a_goal_is_shown_through_the_camera_as_believed():
    result = run(FLIGHT.with_(believed={"focal": 1.1, "depth": 1.2}))
    assert result.verdict.reached and result.outcome == "converged"
    assert "wrong_camera_model" in result.outcomes  # on the way, which is not the one asked for
    assert result.reason.startswith("at the goal as this camera has shown it; yet ")
    assert "calibrate" in result.mend


@pytest.mark.parametrize("interaction", ["desired", "mean"])
def test_another_interaction_matrix_is_no_wrong_camera(interaction):
    turned = CameraPose((0.0, 0.0, -0.75, 0.0, 0.0, 1.5))
    result = run(FLIGHT.with_(
        gain=2.0, start=turned, options={"interaction": interaction}, ideal={"unbounded": True},
    ))  # fmt: skip
    assert set(result.outcomes) <= {"running", "converged"}


def test_a_moving_target_stays_behind_by_speed_over_gain():
    motion = {"velocity": [0.01, 0.0, 0.0, 0.0, 0.0, 0.0]}
    result = run(FLIGHT.with_(target={"shape": SQUARE, "motion": motion}, duration=15.0))
    assert result.verdict.distance == pytest.approx(0.01 / 0.5, rel=0.05)


FOUR = ((-0.1, -0.1), (0.1, -0.08), (0.08, 0.1), (-0.06, 0.06))  # without symmetry
ASKEW = Placing("plane", angle=40.0, scatter=(0.01, 2.0))
TURNED = Placing("turned", angle=90.0, scatter=(0.01, 2.0))
SKEWED = FLIGHT.with_(
    target={"shape": FOUR}, gain=2.0, duration=12.0,
    ideal={"unbounded": True, "speed": [1.0, 1.57]},
    goal={"pose": [0.0, 0.0, -0.6, 0.0, 0.0, 0.0]}, reached=[5e-3, 0.02], options={"hold": 0.4},
)  # fmt: skip


@pytest.mark.parametrize(
    ("scheme", "start", "outcome"),
    [
        ("moments_six", ASKEW, "ambiguous"),
        ("moments_six", TURNED, "ambiguous"),  # told by the third order alone
        ("gravity_centre_normalised+area_normalised+invariants+alpha", ASKEW, "converged"),
        ("ellipse", ASKEW, "converged up to 1 direction"),
        ("ellipse+alpha", ASKEW, "converged up to 1 direction"),  # the ellipse tells alpha
        ("gravity_centre+area", ASKEW, "ambiguous"),
        ("numbered_points", ASKEW, "converged"),
    ],
)
def test_equal_features_of_another_pose_are_not_called_the_goal(scheme, start, outcome):
    result = run(placed(SKEWED.with_(scheme=scheme), start, 0))
    assert result.outcome == outcome, result.reason
    assert result.verdict.reached is (outcome == "converged")


def test_a_flight_that_measures_nothing_any_more_has_lost_its_target():
    turned = placed(SKEWED.with_(scheme="ellipse+alpha"), replace(TURNED, angle=180.0), 0)
    result = run(turned)
    assert result.outcome == "target_lost"
    assert "alpha_full" in result.reason


def test_controllers_of_joints_have_none(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "docs" / "examples"))
    with pytest.raises(ExperimentError, match="answers joints"):
        l_shape = {"shape": (*SQUARE[:3], (0.0, 0.0))}
        run(FLIGHT.with_(scheme="second_order:SecondOrder", target=l_shape))


def test_enough_by_the_truth_ends_the_run_and_so_does_too_far():
    near = run(FLIGHT.with_(ideal={"enough": 0.1}))
    assert near.outcome == "converged"
    way = near.way()
    assert way[0][-1] <= 0.1 * way[0][0] < way[0][-3]
    back = FLIGHT.with_(start=CameraPose((0.0, 0.0, -0.8, 0.0, 0.0, 3.0)), ideal={"farthest": 2.0})
    far = run(back)
    assert not far.converged
    assert len(far.stamp) < 200


# -- the page --------------------------------------------------------------------------------------


HEADS = "case,condition,start,seed,verdict,outcome,settled,distance,angle,path_ratio,excursion"


def test_the_page_is_made_of_the_tables(tmp_path, capsys):
    lines = [HEADS]
    lines += [f"one,clean,turn 90,{n},goal_reached,converged,1.5,0.001,0.2,1.1,0.2" for n in "012"]
    lines += ["one,clean,turn 90,3,goal_missed,camera_retreat,inf,2,9,,0.3"]
    lines += [f"two,clean,turn 90,{n},goal_missed,ambiguous,inf,2,9,,0.3" for n in "0123"]
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    heads = "case,condition,start,seed,verdict,outcome,reduced,iterations,path_ratio"
    rows = ["feature points,clean,box,0,goal_missed,converged,True,40,1.2",
            "feature points,clean,box,1,goal_missed,target_lost,False,9,1.4"]  # fmt: skip
    (tmp_path / "domain.csv").write_text("\n".join([heads, *rows]) + "\n")
    out = tmp_path / "page.md"
    tables = ["--canonical", str(tmp_path / "table.csv"), "--domain", str(tmp_path / "domain.csv")]
    assert page([*tables, "--out", str(out), "--no-pictures"]) == 0
    text = out.read_text()
    assert "| one | clean | 3/4 |" in text
    assert "| 3 of 4 (30-95 %) | 1.50 | 1.000 | 0.200 | 1.10 | 0.20 | camera_retreat 1 |" in text
    assert "| two | 4 | -75.0 | 0 | 3 | 0.250 |" in text
    assert "| 1 of 2 (9-91 %) | 89.6 % (ViT-VS, SIFT) | 40 | 1.20 | target_lost 1 |" in text
    assert "### `polar_points`" in text
    assert "Iwatsuki" in text
    assert page(["--canonical", str(tmp_path / "none.csv"), "--out", str(out)]) == 1
    assert "cannot read" in capsys.readouterr().err


def test_its_pictures_are_drawn(tmp_path, mine):
    rows = mine()[2]
    protocol = Protocol.load(str(tmp_path / "mine.yaml"))
    schemes_pictures.ways(protocol, "turned", tmp_path / "ways.png")
    schemes_pictures.success_map(rows, succeeded, tmp_path / "map.png")
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
