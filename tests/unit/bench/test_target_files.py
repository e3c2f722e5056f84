"""Targets in the simulated world: drawn files agree with the geometry."""

import contextlib
import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest
from frames import take_frames

from aras_sim_bridge.description import parse_urdf
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment, TargetSpec
from aras_visual_servo_bench.ros.move_target import parse_motion
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.targets.geometry import TargetMotion
from aras_visual_servo_bench.targets.target_factory import make_target
from aras_visual_servo_bench.targets.target_files import (
    main,
    triangulate,
    write_description,
    write_occluder,
    write_target,
)
from aras_visual_servo_bench.targets.target_spec import SupportBoxSpec
from aras_visual_servo_camera.trackers.dots import DotTracker
from aras_visual_servo_controller.observation.feature_extractor import FeatureExtractor

GAZEBO = Path(__file__).parents[3] / "src" / "aras_visual_servo_gazebo"
GOAL = (0.05, 0.0, -0.09, 0.045, 0.045, 0.0)
START = [0.07, 0.0, -0.09, 0.045, 0.045, 0.3]
PLACE = [0.01, -0.02, 0.591, 0.0, 0.0, 0.4]


def on_the_arm(shape, size=(0.1, 0.1), motion=None, **changes):
    target = {"shape": shape, "size": list(size), "pose": PLACE, "motion": motion or {}}
    occluder = changes.pop("occluder", None)
    return Experiment.from_mapping({
        "target": {**target, "occluder": occluder}, "goal": list(GOAL), "start": START,
        "duration": 5.0, **changes})  # fmt: skip


def seen(experiment, wanted=1):
    """Return image (rows, columns) number `wanted`, its stamp, and the poses of target and camera.
    """
    parts = assemble(experiment)
    with contextlib.closing(parts.plant) as plant:
        reading = take_frames(plant, wanted)[-1]
        return FeatureExtractor.decode_image(reading).grey, reading.stamp, parts, plant.read_pose()


STILL = {"scheme": "gravity_centre"}


@pytest.mark.parametrize("motion", [
    {"velocity": [0.05, 0.0, 0.0, 0.0, 0.0, 0.3]}, {"circle": 0.02, "frequency": 0.4},
    {"step": [0.0, 0.02, 0.0], "begin": 0.3}])  # fmt: skip
def test_a_moving_target_is_in_every_picture_where_it_belongs(motion):
    grey, stamp, parts, pose = seen(on_the_arm("four_dots", motion=motion, **STILL), wanted=20)
    assert stamp > 0.4
    found, off = DotTracker().find(grey), []
    for time in (stamp, 0.0):
        points = parts.target.shape.points(parts.target.target_T_camera(pose, time))
        exact = np.column_stack(parts.plant.camera.project(*points.T))
        off.append(np.linalg.norm(found[:, None] - exact, axis=2).min(axis=1).max())
    assert off[0] < 0.15 and off[1] > 2.0


@pytest.mark.parametrize(("direction", "diffuse", "exposure"), [
    ((0.1, 0, -1), 0.8, "unclipped"), ((0.1, 0, -1), 0.8, "gazebo"),
    ((0, 0.5, -1), 0.3, "unclipped")])
def test_the_table_is_as_bright_as_its_sun_makes_it(direction, diffuse, exposure):
    sun = {"direction": list(direction), "diffuse": diffuse, "exposure": exposure}
    grey, *_ = seen(on_the_arm("l_shape", (0.05, 0.05), sun=sun, **STILL))
    lit = min(0.4 + diffuse / np.linalg.norm(direction), 1.0)
    if exposure == "unclipped":
        lit = (0.4 + diffuse / np.linalg.norm(direction)) / max(0.4 + diffuse, 1.0)
    assert np.median(grey) == pytest.approx(255 * lit, abs=1.5)
    assert grey.min() < 5


@pytest.mark.parametrize("name", sorted(
    path.stem for path in (GAZEBO / "targets").glob("*.urdf") if path.stem != "aras"))
def test_what_ships_is_what_is_made(name, tmp_path):
    size = (0.4, 0.3) if name == "poster" else (0.1, 0.1)
    write_target(make_target(name, size), tmp_path, name, "package://aras_visual_servo_gazebo/targets")
    for made in sorted(tmp_path.iterdir()):
        kept = GAZEBO / "targets" / made.name
        if made.suffix == ".png":
            assert (cv2.imread(str(made)) == cv2.imread(str(kept))).all()
        else:
            assert made.read_text() == kept.read_text()


def test_ears_are_cut_to_the_polygon_s_area():
    # A corner on an edge, or two, is the corner of no ear.
    straight = np.array([(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)], float)
    outlines = [np.roll(straight, k, axis=0) for k in range(6)]
    random = np.random.default_rng(2)
    while len(outlines) < 20:  # stars about a place off the origin, first corner anywhere
        around = np.sort(random.uniform(0.0, 2.0 * np.pi, 9))
        if np.diff(around, append=around[0] + 2 * np.pi).max() < 3.0:
            star = random.uniform(0.3, 1.0, 9)[:, None] * np.column_stack(
                [np.cos(around), np.sin(around)]) + random.uniform(-2.0, 2.0, 2)
            outlines += [star, star[::-1]]
    for given in outlines:
        x, y = given.T
        parts = triangulate(given)
        areas = [np.linalg.det([given[b] - given[a], given[c] - given[a]]) / 2 for a, b, c in parts]
        assert len(parts) == len(given) - 2 and min(areas) > 0.0
        assert sum(areas) == pytest.approx(
            abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2, abs=1e-9)
    with pytest.raises(ExperimentError, match="edges cross"):
        triangulate(np.array([(0, 0), (1, 0), (0, 0), (1, 0)], float))


def mesh_of(path):
    """Return corners (n, 3), texture coordinates (n, 2) and faces (m, 3), from 0, of an OBJ file.
    """
    lines = [line.split() for line in path.read_text().splitlines()]
    corners, places = (np.array([line[1:] for line in lines if line[0] == kind], float)
                       for kind in ("v", "vt"))
    faces = [[tuple(map(int, pair.split("/"))) for pair in line[1:]] for line in lines
             if line[0] == "f"]
    assert all(a == b for face in faces for a, b in face)
    return corners, places, np.array([[a - 1 for a, _ in face] for face in faces])


def test_a_loose_target_is_a_box_with_its_face_on_top(tmp_path):
    box = SupportBoxSpec(size=(0.1, 0.2, 0.3), mass=2.5, friction=0.7)
    made = parse_urdf(
        write_target(make_target("square", (0.1, 0.2)), tmp_path, "thing", box=box).read_text())
    link = made.links["thing"]
    assert not made.static and made.name == "thing" and link.mu == 0.7
    (body,) = link.collisions
    at = (0.0, 0.0, pytest.approx(-0.1505))  # half a millimetre below the face
    assert (body.geometry.size, body.origin_xyz) == ((0.1, 0.2, 0.3), at)
    assert [one.origin_xyz for one in link.visuals][1] == at
    inertial = link.inertial
    assert (inertial.mass, inertial.origin_xyz) == (2.5, at)
    ixx, _, _, iyy, _, izz = inertial.inertia
    assert (ixx, iyy, izz) == pytest.approx(
        (2.5 / 12 * (0.04 + 0.09), 2.5 / 12 * (0.01 + 0.09), 2.5 / 12 * (0.01 + 0.04)))


def test_a_picture_spans_its_rectangle_and_what_covers_it_lies_above(tmp_path):
    poster = make_target("poster", (0.4, 0.3))
    path = write_target(poster, tmp_path / "a" / "b", "p", occluder=((-0.1, -0.05), (0.02, 0.15)))
    folder = tmp_path / "a" / "b"
    corners, places, faces = mesh_of(folder / "p.obj")
    np.testing.assert_array_equal(corners, poster.vertices())
    np.testing.assert_array_equal(places, [(0, 1), (1, 1), (1, 0), (0, 0)])
    normals = np.cross(*(corners[faces[:, k]] - corners[faces[:, 0]] for k in (1, 2)))
    np.testing.assert_allclose(normals, [[0, 0, 0.12]] * 2)
    assert (cv2.imread(str(folder / "p.png"), 0) == poster.pixels).all()
    assert (folder / "p.mtl").read_text() == "newmtl face\nKd 1 1 1\nmap_Kd p.png\n"
    made = parse_urdf(path.read_text())
    face, cover = made.links["p"].visuals
    assert made.static and face.geometry.filename == str(folder / "p.obj")
    assert cover.geometry.filename == str(folder / "p_occluder.obj")
    assert cover.origin_xyz == (0.0, 0.0, 5e-4)
    corners, _, faces = mesh_of(folder / "p_occluder.obj")
    np.testing.assert_array_equal(
        corners, [(-0.1, -0.05, 0), (0.02, -0.05, 0), (0.02, 0.15, 0), (-0.1, 0.15, 0)])
    np.testing.assert_array_equal(faces, [(0, 1, 2), (0, 2, 3)])
    assert "Kd 1 1 1" in (folder / "p_occluder.mtl").read_text()


def test_what_covers_a_target_always_is_part_of_it_and_only_a_picture_is_perturbed():
    covered = ((-0.01, -0.02), (0.03, 0.04))
    for occluded, count in ((None, 2), (((1.0, 2.0),), 1)):
        spec = TargetSpec("triangle", (0.1, 0.2), occluder=covered, occluded=occluded)
        made = parse_urdf(write_description(spec).read_text())
        assert len(made.links["target"].visuals) == count
        assert write_description(spec) == write_description(spec)
    alone = write_occluder(covered)
    (visual,) = parse_urdf(alone.read_text()).links["occluder"].visuals
    corners, _, _ = mesh_of(alone.with_suffix(".obj"))
    assert visual.origin_xyz == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal([corners.min(axis=0)[:2], corners.max(axis=0)[:2]], covered)
    with pytest.raises(ExperimentError, match="no texture that could be perturbed"):
        write_description(TargetSpec("square", (0.1, 0.1), tuple(PLACE)), 3)
    poster = TargetSpec("poster", (0.1, 0.1), tuple(PLACE))
    one, other = (cv2.imread(str(write_description(poster, seed).with_suffix(".png")))
                  for seed in (3, None))  # fmt: skip
    assert (one != other).any()


def test_every_word_of_the_command_counts(tmp_path, capsys):
    given = ["l_shape", "--size", "0.3", "0.2", "--out", str(tmp_path), "--name", "mine",
             "--meshes", "package://p/q", "--occluder", "-0.1", "-0.2", "0.01", "0.02"]
    assert main(given) == 0
    path = tmp_path / "mine.urdf"
    assert capsys.readouterr().out == f"wrote {path}: roslaunch ... target:={path}\n"
    text = path.read_text()
    assert 'filename="package://p/q/mine.obj"' in text and 'name="mine"' in text
    corners, _, _ = mesh_of(tmp_path / "mine.obj")
    np.testing.assert_allclose(corners, make_target("l_shape", (0.3, 0.2)).vertices())
    cover, _, _ = mesh_of(tmp_path / "mine_occluder.obj")
    assert cover.min(axis=0)[:2].tolist() == [-0.1, -0.2]
    assert cover.max(axis=0)[:2].tolist() == [0.01, 0.02]
    assert main(["triangle", "--out", str(tmp_path)]) == 0
    corners, *_ = mesh_of(tmp_path / "triangle.obj")  # of 0.1 m, where nothing is said
    np.testing.assert_allclose(corners[:, :2], [(-0.05, -0.04), (0.05, -0.03), (-0.01, 0.05)])
    assert main(["triangel", "--out", str(tmp_path)]) == 1
    assert "did you mean 'triangle'" in capsys.readouterr().err


SCRIPT = runpy.run_path(str(GAZEBO.parent / "aras_visual_servo_bench/scripts/target_description"))
SHIPPED = {path.stem: path for path in (GAZEBO / "targets").glob("*.urdf")}


def describe(target, size, folder):
    return SCRIPT["describe"](target, SHIPPED, size, folder)


@pytest.mark.parametrize(("name", "size", "faces"), [
    ("{}/mine.png", (0.3, 0.2), 2), ("{}/mine.svg", (0.3, 0.2), 4), ("circle", (0.04, 0.06), 178)])
def test_a_file_or_a_name_is_a_plane_of_that_size(tmp_path, name, size, faces):
    cv2.imwrite(str(tmp_path / "mine.png"), np.full((20, 30), 90, np.uint8))
    (tmp_path / "mine.svg").write_text(
        '<svg><polygon points="0,0 40,0 40,20 20,20 20,40 0,40"/></svg>')
    assert parse_urdf(describe(name.format(tmp_path), size, tmp_path / "made")).static
    corners, _, triangles = mesh_of(next((tmp_path / "made").rglob("*.obj")))
    assert np.ptp(corners, axis=0) == pytest.approx([*size, 0.0])
    assert len(triangles) == faces


def test_what_ships_comes_as_it_is_and_what_cannot_be_a_target_is_told(
        tmp_path, monkeypatch, capsys):
    assert describe("poster", None, tmp_path) == SHIPPED["poster"].read_text()
    (tmp_path / "a.svg").write_text("<svg/>")
    for given, why in (("aras", "'aras' has one size"), ("four_dot", "did you mean 'four_dots'"),
                       ("/none.png", "there is no file"),
                       (f"{tmp_path}/a.svg", "has no outline")):  # fmt: skip
        with pytest.raises(ExperimentError, match=why):
            describe(given, (0.1, 0.1), tmp_path)
    monkeypatch.setattr("sys.argv", ["target_description", str(tmp_path / "a.svg"), "--targets=."])
    assert SCRIPT["main"]() == 1
    said = capsys.readouterr().err
    assert said.startswith("target_description: ") and said.count("\n") == 1


def test_a_motion_is_read_from_words_and_a_wrong_one_is_told():
    words = ["circle=0.02", "frequency=0.2", "velocity=[0.1, 0, 0, 0, 0, 0]"]
    assert parse_motion(words) == TargetMotion((0.1, 0, 0, 0, 0, 0), frequency=0.2, circle=0.02)
    path = ((2.0, 0.05, 0.0, 0.0), (4.0, 0.0, 0.03, 0.0))
    assert parse_motion(["path=[[2, 0.05, 0, 0], [4, 0, 0.03, 0]]"]) == TargetMotion(path=path)
    for words, told in ((["circl=0.02"], "did you mean 'circle'"), ([], "the target does not move"),
                        (["circle=0.02"], "need a frequency"), (["circle"], "key=value"),
                        (["hold=-1"], "motion.hold is -1.0, must be >= 0")):  # fmt: skip
        with pytest.raises(ExperimentError, match=told):
            parse_motion(words)
