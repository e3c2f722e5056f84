"""Targets in the simulated world: drawn files agree with the geometry."""

import contextlib
import runpy
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from frames import take_frames

from aras_sim_bridge.description import parse_urdf
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment, TargetSpec
from aras_visual_servo_bench.ros.move_target import parse_motion
from aras_visual_servo_bench.runner.loop import run
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
SQUARE = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]
PLACE = [0.01, -0.02, 0.591, 0.0, 0.0, 0.4]


def on_the_arm(shape, size=(0.1, 0.1), motion=None, **changes):
    target = {"shape": shape, "size": list(size), "pose": PLACE, "motion": motion or {}}
    occluder = changes.pop("occluder", None)
    return Experiment.from_mapping({
        "target": {**target, "occluder": occluder}, "goal": list(GOAL), "start": START,
        "duration": 5.0, **changes,
    })  # fmt: skip


def seen(experiment, wanted=1):
    """Return image (rows, columns) number `wanted`, its stamp, and the poses of target and camera.
    """
    parts = assemble(experiment)
    with contextlib.closing(parts.plant) as plant:
        reading = take_frames(plant, wanted)[-1]
        return FeatureExtractor.decode_image(reading).grey, reading.stamp, parts, plant.read_pose()


def missed(parts, found, pose, stamp):
    """Greatest distance, px, of points (n, 2) found from where the geometry has them."""
    x, y = parts.target.shape.points(parts.target.target_T_camera(pose, stamp)).T
    exact = np.column_stack(parts.plant.camera.project(x, y))
    if len(found) == 4 and parts.target.shape is make_target("four_dots", (0.1, 0.1), None, ""):
        offset = exact - exact.mean(axis=0)
        exact = exact[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]
    return np.linalg.norm(found - exact, axis=1).max()


STILL = {"scheme": "gravity_centre"}


@pytest.mark.parametrize(
    "motion",
    [
        {"velocity": [0.05, 0.0, 0.0, 0.0, 0.0, 0.3]},
        {"circle": 0.02, "frequency": 0.4},
        {"step": [0.0, 0.02, 0.0], "begin": 0.3},
    ],
)
def test_a_moving_target_is_in_every_picture_where_it_belongs(motion):
    grey, stamp, parts, pose = seen(on_the_arm("four_dots", motion=motion, **STILL), wanted=20)
    assert stamp > 0.4
    found = DotTracker().find(grey)
    assert missed(parts, found, pose, stamp) < 0.15
    assert missed(parts, found, pose, 0.0) > 2.0


def test_an_occluder_hides_what_is_below_it():
    dark = [
        (seen(on_the_arm("square", occluder=occluder, **STILL))[0] < 100).sum()
        for occluder in (None, [[-0.05, -0.05], [0.0, 0.05]])
    ]
    assert dark[1] == pytest.approx(0.5 * dark[0], rel=0.05)


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


def test_under_a_low_sun_the_target_is_not_told_from_the_table_and_that_is_said():
    lit = run(on_the_arm("l_shape", (0.05, 0.05), sun={"direction": [-1, 0, -1]}))
    assert lit.outcome == "converged" and lit.verdict.is_reached
    dark = {"sun": {"direction": [-1, 0, -0.05]}, "goal": "2016", "scheme": "moments"}
    found = run(on_the_arm("l_shape", (0.05, 0.05), **{**dark, "duration": 1.0}))
    assert found.outcome in ("target_lost", "wrong_object")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"shape": "four_dots"}, "whose top is at z = 0.59"),
        ({"shape": SQUARE, "motion": {"step": [0.01, 0, 0]}}, "set target.shape, too"),
        ({"shape": "square", "pose": PLACE, "size": [3, 1]}, "the size of the table"),
        ({"shape": "nowhere.png", "pose": PLACE}, "there is no file"),
    ],
)
def test_what_cannot_lie_on_the_table_is_told(changes, told):
    with pytest.raises(ExperimentError, match=told):
        assemble(Experiment.from_mapping({"target": changes, "goal": list(GOAL), "start": START}))


def test_a_target_without_a_picture_cannot_be_perturbed():
    spec = TargetSpec("square", (0.1, 0.1), tuple(PLACE))
    with pytest.raises(ExperimentError, match="no texture that could be perturbed"):
        write_description(spec, 3)
    poster = replace(spec, shape="poster")
    one, other = (
        cv2.imread(str(write_description(poster, seed).with_suffix(".png"))) for seed in (3, None)
    )
    assert (one != other).any()


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
        areas = [np.linalg.det([given[b] - given[a], given[c] - given[a]]) / 2
                 for a, b, c in parts]
        assert len(parts) == len(given) - 2 and min(areas) > 0.0
        assert sum(areas) == pytest.approx(
            abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2, abs=1e-9)
    with pytest.raises(ExperimentError, match="edges cross"):
        triangulate(np.array([(0, 0), (1, 0), (0, 0), (1, 0)], float))


def test_files_by_command(tmp_path, capsys):
    assert main(["triangle", "--out", str(tmp_path)]) == 0
    corners, *_ = mesh_of(tmp_path / "triangle.obj")  # of 0.1 m, where nothing is said
    np.testing.assert_allclose(corners[:, :2], [(-0.05, -0.04), (0.05, -0.03), (-0.01, 0.05)])
    assert main(["triangel", "--out", str(tmp_path)]) == 1
    assert "did you mean 'triangle'" in capsys.readouterr().err


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
        write_target(make_target("square", (0.1, 0.2)), tmp_path, "thing", box=box).read_text()
    )
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


def test_what_covers_a_target_always_is_part_of_it():
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


# -- the launch files' script ----------------------------------------------------------------------

SCRIPT = runpy.run_path(str(GAZEBO.parent / "aras_visual_servo_bench/scripts/target_description"))
SHIPPED = {path.stem: path for path in (GAZEBO / "targets").glob("*.urdf")}


def describe(target, size, folder):
    return SCRIPT["describe"](target, SHIPPED, size, folder)


@pytest.mark.parametrize(("name", "faces"), [("mine.png", 2), ("mine.svg", 4)])
def test_a_file_by_its_path_is_a_plane_of_that_size(tmp_path, name, faces):
    cv2.imwrite(str(tmp_path / "mine.png"), np.full((20, 30), 90, np.uint8))
    (tmp_path / "mine.svg").write_text(
        '<svg><polygon points="0,0 40,0 40,20 20,20 20,40 0,40"/></svg>')
    text = describe(str(tmp_path / name), (0.3, 0.2), tmp_path / "made")
    assert parse_urdf(text).static
    lines = next((tmp_path / "made").rglob("*.obj")).read_text().split("\n")
    corners = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    assert np.ptp(corners, axis=0) == pytest.approx([0.3, 0.2, 0.0])
    assert sum(line.startswith("f ") for line in lines) == faces


def test_a_name_comes_as_it_ships_or_in_another_size(tmp_path):
    shipped = (GAZEBO / "targets" / "poster.urdf").read_text()
    assert describe("poster", None, tmp_path) == shipped
    assert parse_urdf(describe("circle", (0.04, 0.06), tmp_path)).static
    lines = next(tmp_path.rglob("*.obj")).read_text().split("\n")
    corners = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    assert np.ptp(corners, axis=0) == pytest.approx([0.04, 0.06, 0.0])
    with pytest.raises(ExperimentError, match="'aras' has one size"):
        describe("aras", (0.1, 0.1), tmp_path)


@pytest.mark.parametrize(
    ("given", "told"),
    [("four_dot", "did you mean 'four_dots'"), ("/none.png", "there is no file"),
     ("{}/text.png", "is not a readable image"), ("{}/a.svg", "has no outline"),
     ("{}/b.SVG", "is no SVG: ")],
)  # fmt: skip
def test_what_cannot_be_a_target_is_told(given, told, tmp_path):
    (tmp_path / "text.png").write_text("no picture at all")
    (tmp_path / "a.svg").write_text("<svg/>")
    (tmp_path / "b.SVG").write_text("no tree at all")
    with pytest.raises(ExperimentError, match=told):
        describe(given.format(tmp_path), (0.1, 0.1), tmp_path)


def test_a_picture_too_large_is_told_before_anything_is_written(tmp_path, monkeypatch, capsys):
    picture = tmp_path / "huge.bmp"
    header = struct.pack("<2sIHHIIiiHHIIiiII", b"BM", 0, 0, 0, 54, 40, 9000, 8000, 1, 24, *6 * (0,))
    picture.write_bytes(header)
    monkeypatch.setattr("sys.argv", ["target_description", str(picture), "--targets=."])
    assert SCRIPT["main"]() == 1
    said = capsys.readouterr().err
    assert said == f"target_description: {picture} has more than 64000000 pixels: make it smaller\n"


# -- the node that moves one -----------------------------------------------------------------------


def test_a_motion_by_words():
    words = ["circle=0.02", "frequency=0.2", "velocity=[0.1, 0, 0, 0, 0, 0]"]
    assert parse_motion(words) == TargetMotion((0.1, 0, 0, 0, 0, 0), frequency=0.2, circle=0.02)
    assert parse_motion(["path=[[2, 0.05, 0, 0], [4, 0, 0.03, 0]]"]) == TargetMotion(
        path=((2.0, 0.05, 0.0, 0.0), (4.0, 0.0, 0.03, 0.0))
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [(["circl=0.02"], "did you mean 'circle'"), (["circle=0.02"], "need a frequency"),
     ([], "the target does not move"), (["circle"], "key=value"),
     (["hold=-1"], "motion.hold is -1.0, must be >= 0")],
)  # fmt: skip
def test_a_wrong_motion_is_told(words, told):
    with pytest.raises(ExperimentError, match=told):
        parse_motion(words)
