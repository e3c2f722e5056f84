"""Data sets: images and numbers of every image of a study's runs."""

from __future__ import annotations

import dataclasses
import re
import shutil
from collections import namedtuple

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from made_studies import write_study

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.studies import data_card, image_table, replay
from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.studies import study_execution as engine
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_folder import TRACES, StudyFolder
from aras_visual_servo_camera.images import Image

MOVING = {"pose": [0.01, 0.02, 0.591, 0.0, 0.0, 0.3], "shape": "l_shape", "size": [0.08, 0.06],
          "motion": {"velocity": [0.01, 0.004, 0.0, 0.0, 0.0, 0.0]}}  # fmt: skip
SEVERAL = {
    "plant": "free", "features": "images", "duration": 0.2, "scheme": "points@right",
    "target": {"shape": "square", "size": [0.1, 0.1]},
    "goal": {"pose": [0.0, 0.0, 0.4, 3.14159265, 0.0, 0.0]},
    "start": {"pose": [0.01, 0.02, 0.45, 3.14159265, 0.0, 0.1]},
    "cameras": {"left": {"model": {"width": 200, "height": 100}},
                "right": {"xyz": [0.05, 0.0, 0.0]}},
}  # fmt: skip


def study_of(experiment, **more):
    return Study.from_mapping({"experiment": experiment, "pictures": "all", **more})


def pixels(png):
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.fixture(scope="module")
def arm():
    """A run of the arm before a target that moves, whose answers come late: its images."""
    study = study_of({
        "plant": "bullet", "duration": 0.5, "time_after_convergence": None, "target": MOVING,
        "delay": 0.1, "scheme": "points",
        "goal": {"pose": [0.01, 0.02, 0.85, 3.14159265, 0.0, 0.0]},
        "start": {"pose": [0.03, 0.0, 0.9, 3.14159265, 0.0, 0.2]},
    })  # fmt: skip
    return study, rows.compute_row(study, 0)


def test_poses_are_those_of_the_exposures(arm):
    """Corners of the target, by the poses that are kept, are where the picture has them."""
    study, done = arm
    assert len(done.images) == done.values[0]["images"] >= 10
    parts = assemble(study.make_experiment(0))
    parts.plant.close()
    shape, camera = parts.target.shape, parts.cameras["camera"].true_camera
    speed = 0.0
    for row in done.images:
        T = np.reshape(row["camera_T_target"], (4, 4))
        outline = np.column_stack(camera.project(*shape.outline(np.linalg.inv(T)).T))
        grey = pixels(row["picture"]).astype(float).mean(axis=2)
        low = np.floor(outline.min(axis=0)).astype(int) - 2
        high = np.ceil(outline.max(axis=0)).astype(int) + 3
        there = np.s_[low[1] : high[1], low[0] : high[0]]
        dark = np.median(grey) - grey[there]
        v, u = np.mgrid[there]
        found = [(dark * of).sum() / dark.sum() for of in (u, v)]
        wanted = _centre(outline)
        np.testing.assert_allclose(found, wanted, atol=0.005)
        speed = max(speed, np.abs(row["achieved_twist"]).max())
    assert speed > 0.02  # at which a pose of the answer, 0.1 s later, would be 1 px off


def _centre(polygon):
    x, y = polygon.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    return [((of + np.roll(of, -1)) * cross).sum() / (3.0 * cross.sum()) for of in (x, y)]


def test_the_goal_moves_with_the_target(arm):
    _, done = arm
    first, last = done.images[0], done.images[-1]
    goals = [np.reshape(row["pose"], (4, 4)) @ np.reshape(row["camera_T_goal"], (4, 4))
             for row in (first, last)]
    np.testing.assert_allclose(
        goals[1][:3, 3] - goals[0][:3, 3],
        (last["stamp"] - first["stamp"]) * np.array([0.01, 0.004, 0.0]), atol=1e-9)  # fmt: skip
    at_zero = matrix_from_xyz_rpy((0.01, 0.02, 0.85), (3.14159265, 0.0, 0.0))
    at_zero[:3, 3] += first["stamp"] * np.array([0.01, 0.004, 0.0])
    np.testing.assert_allclose(goals[0], at_zero, atol=2e-5)


def test_of_each_camera_the_latest_image_is_kept_with_its_colours_and_depth():
    """The other camera, at a lower rate, delivers made images: red grows, and so does depth."""
    experiment = study_of({**SEVERAL, "cameras": {
        "left": {"rate": 15.0}, "right": {"xyz": [0.05, 0.0, 0.0]}}}).make_experiment(0)
    kept, stamps = image_table.ImageRecorder(records_images=True), []

    def add(loop, frame):
        if frame.name == "left":
            stamps.append(frame.stamp)
            rgb = np.array([[[len(stamps), 130, 40]]], np.uint8)
            most = 65535 * image_table.DEPTH_STEP
            depth = np.array([[0.5 * len(stamps), most, 6.6, np.inf, np.nan]])
            frame = dataclasses.replace(frame, image=rgb, encoding="rgb8", depth=depth)
        else:
            frame = dataclasses.replace(
                frame, image=np.array([[90]], np.uint8), encoding="mono8", depth=None)
        kept.add_frame(loop, frame)

    loop = Loop(experiment, assemble(experiment), on_frame=add)
    loop.run_to_end()
    found = kept.make_rows(3, loop.make_run(), 0.2)
    loop.close()
    counts = [sum(stamp < row["stamp"] + 1e-6 for stamp in stamps) for row in found]
    assert len(found) > 4 and len(set(counts)) > 2 and len(counts) > len(set(counts))
    for row, count in zip(found, counts, strict=True):
        assert pixels(row["picture_right"]).tolist() == [[90]] and row["depth_right"] is None
        if not count:
            assert row["picture_left"] is row["depth_left"] is None
            continue
        assert pixels(row["picture_left"]).tolist() == [[[40, 130, count]]]  # OpenCV's order
        assert pixels(row["depth_left"]).tolist() == [[5000 * count, 65535, 0, 0, 0]]


def test_numbers_are_the_loops_own_and_what_is_kept_changes_no_run(arm):
    study, done = arm
    experiment = study.make_experiment(0)
    seen = []
    loop = Loop(experiment, assemble(experiment), on_frame=lambda of, one: seen.append(one))
    loop.run_to_end()
    run = loop.make_run()
    loop.close()
    for row, state in zip(done.images, run.states, strict=True):
        assert (row["stamp"], row["phase"]) == (state.stamp, state.phase)
        np.testing.assert_array_equal(row["joints"], state.joints.positions)
        if state.scheme_output is not None:
            np.testing.assert_array_equal(row["error"], state.scheme_output.error)
            np.testing.assert_array_equal(row["desired_twist"], state.desired_twist)
        reading = next(one for one in seen if one.stamp == state.stamp)
        rgb = Image(reading.image, reading.encoding).rgb
        np.testing.assert_array_equal(pixels(row["picture"])[..., ::-1], rgb)
    plain = Study.from_mapping({**study.to_mapping(), "pictures": "none"})
    without = rows.compute_row(plain, 0)
    assert without.images == []
    for name, value in without.values[0].items():
        assert value == done.values[0][name] or value != value, name


@pytest.mark.parametrize(("place", "frame", "row"), [
    ({}, "the first camera's frame", "1, 0, 0, -0.01, 0, 1, 0, 0.02, 0, 0, 1, -0.05"),
    ({"pose": [0.1, 0.2, 0.6, 3.141592653589793, 0.0, 0.0]},
     "the frame of the first camera's target (world or link)", "1, 0, 0, 0.1, 0, -1, "),
])  # fmt: skip
def test_the_card_says_of_each_camera_what_it_is_and_where(tmp_path, place, frame, row):
    lens = {"width": 200, "height": 100, "horizontal_fov": 1.047, "distortion_model": "plumb_bob",
            "distortion_coefficients": [0.1, -0.02, 0.003, 0.0, 0.0]}  # fmt: skip
    left = place or {"xyz": [-0.05, 0.01, -0.02]}
    several = {**SEVERAL, "cameras": {"left": {"model": lens, **left}, "right": {"rate": 15.0}}}
    study = study_of(several, repeats=5)
    ends = ("joint_limit", "timed_out", "timed_out", "converged", "timed_out")
    folder = StudyFolder.open(
        write_study(tmp_path, study, lambda _, run: {"outcome": ends[run]}))
    told = data_card.make_card(folder)
    assert "Outcomes: timed_out 3, converged 1, joint_limit 1." in told
    assert f"```\n\nCode {folder.labels['code']}; {folder.labels['versions']}.\n" in told
    made = re.search(r"## Study\n\n```yaml\n(.*?)```", told, re.S).group(1)
    assert yaml.safe_load(made) == study.to_mapping()
    first, other = (line for line in told.splitlines() if "pixels, " in line)
    assert first.startswith("- right: 320 x 240 pixels, 15 Hz, K row by row 102.735, 0, 159.5, 0, ")
    assert first.endswith(", plumb_bob with coefficients 0, 0, 0, 0, 0")
    assert other.startswith("- left: 200 x 100 pixels, 30 Hz, K row by row 173.245, 0, 99.5, 0, ")
    assert f"coefficients 0.1, -0.02, 0.003, 0, 0; its pose in {frame} row by row {row}" in other


def test_first_keeps_a_view_of_each_start():
    start = {"height": [0.2, 0.3], "side": 0.05}
    study = study_of({"plant": "free", "features": "images", "start": start}, repeats=3,
                     pictures="first")  # fmt: skip
    found = [rows.compute_row(study, run) for run in range(3)]
    assert [len(one.images) for one in found] == [1, 1, 1]
    poses = np.array([one.images[0]["pose"] for one in found])
    assert np.ptp(poses[:, 11]) > 0.01  # drawn anew
    whole = rows.compute_row(study_of(dict(study.experiment) | {"duration": 0.1}), 0)
    assert whole.images[0] == found[0].images[0] and len(whole.images) > 2


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"experiment": {"plant": "free"}}, "set features to images"),
    ({"pictures": "none", "depth": True}, "set pictures to all or first"),
    ({"pictures": "some"}, "use one of none, first, all"),
    ({"experiment": SEVERAL, "vary": {"cameras": [SEVERAL["cameras"], {"right": {}}]}},
     "one run has left, right and another right"),
])  # fmt: skip
def test_what_cannot_be_kept_is_refused(changes, complaint):
    with pytest.raises(StudyError, match=complaint):
        engine.check_study(study_of(**{"experiment": {"plant": "free"}, **changes}))


def test_each_camera_has_columns_of_its_own():
    study = study_of(SEVERAL)
    row = rows.compute_row(study, 0).images[2]
    assert pixels(row["picture_left"]).shape == (100, 200)
    assert pixels(row["picture_right"]).shape == (240, 320)
    assert image_table.make_schema(study_of(SEVERAL, depth=True)).names[-4:] == [
        "picture_left", "depth_left", "picture_right", "depth_right"]
    short = study.make_experiment(0).with_changes(duration=0.05)
    run = replay.run_with_images(short, "again", "here")
    assert (run.name, run.source) == ("again", "here")
    assert run.cameras["left"].film and not run.cameras["left"].images
    assert len(run.control_record.images) == len(run.stamp)


def test_a_data_set_larger_than_the_disk_is_refused(monkeypatch, tmp_path):
    study = study_of({"plant": "free", "features": "images", "duration": 0.99}, repeats=100)
    told = image_table.check_room(study, tmp_path / "not" / "there")
    size = float(re.match(r"([\d.]+) MB at most: 100 runs of up to 32 images", told).group(1))
    assert 3.0 < size < 20.0
    deep = image_table.check_room(dataclasses.replace(study, depth=True), tmp_path)
    assert float(deep.partition(" MB")[0]) > size + 1.0
    first = Study.from_mapping({**study.to_mapping(), "pictures": "first"})
    assert "100 runs of up to 1 image of" in image_table.check_room(first, tmp_path)
    quick = study_of({**study.experiment, "camera": {"update_rate": 60.0}})
    assert "up to 62 images" in image_table.check_room(quick, tmp_path)
    Usage = namedtuple("Usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(0, 0, int(0.99e6 * size)))
    with pytest.raises(StudyError, match="needs .* MB at most: 100 runs"):
        image_table.check_room(study, tmp_path)
    image_table.check_room(study, tmp_path, finished_runs=50)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(0, 0, 0))
    assert image_table.check_room(Study.from_mapping({}), tmp_path) == ""


def test_the_command_makes_a_data_set_and_its_card(tmp_path, monkeypatch, capsys):
    file, out = tmp_path / "study.yaml", tmp_path / "out"
    file.write_text("experiment: {plant: free, features: images, duration: 0.2}\n"
                    "vary: {gain: [1.0, 2.0]}\n")  # fmt: skip
    words = ["dataset", str(file), "--out", str(out), "--in-process"]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "MB at most" in told or "kB at most" in told
    assert "2 of 2 runs" in told and "README.md describes" in told
    table = StudyFolder.open(out).read_results(TRACES)
    assert table.num_rows == sum(pq.read_table(out / "parts")["images"].to_pylist())
    card = (out / "README.md").read_text()
    for name in table.schema.names:
        kind = str(table.schema.field(name).type)
        word = {"int64": "whole number", "double": "number", "string": "text", "binary": "bytes",
                "list<element: double>": "list of numbers"}[kind]  # fmt: skip
        assert f"| {name} | {word} |" in card
    assert f"2 runs, {table.num_rows} images" in card
    assert "K row by row 102.735, 0, 159.5" in card
    reading = re.search(r"```python\n(import cv2, numpy, pandas\n.*?)```", card, re.S).group(1)
    assert len(reading.splitlines()) == 5
    monkeypatch.chdir(out)
    space: dict = {}
    exec(reading, space)
    assert space["picture"].shape == (240, 320)
    assert set(space["images"].outcome) <= set(space["runs"].outcome) and len(space["runs"]) == 2
    # Once more: nothing is left to do, and no room is needed; --views is another study.
    monkeypatch.chdir(tmp_path)
    Usage = namedtuple("Usage", "total used free")
    with monkeypatch.context() as full:
        full.setattr(shutil, "disk_usage", lambda path: Usage(0, 0, 0))
        assert main(words) == 0
    capsys.readouterr()
    assert main(words) == 0
    assert "all 2 runs are in" in capsys.readouterr().out
    assert main([*words, "--views"]) == 1
    assert "pictures was all, is first" in capsys.readouterr().err
    assert main(["dataset", str(file), "features=exact", "--out", str(tmp_path / "no")]) == 1
    assert "set features to images" in capsys.readouterr().err and not (tmp_path / "no").exists()
