"""3-D drawing of a run: positions of shapes, and restart of the trace."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_host import told

from aras_visual_servo_base.meshes.mesh import Mesh
from aras_visual_servo_bench.drawing import model_drawing
from aras_visual_servo_bench.drawing.feature_units import find_feature_units
from aras_visual_servo_bench.drawing.model_drawing import draw_model
from aras_visual_servo_bench.drawing.run_trace import (
    ARROW_SECONDS,
    FRUSTUM_SIZE,
    MAX_ARROW,
    RunTrace,
)
from aras_visual_servo_bench.drawing.shapes import (
    ARROW,
    FACES,
    LINES,
    MAX_VIEW_ANGLE,
    STRIP,
    compute_image_border,
    place_on_image_plane,
)
from aras_visual_servo_bench.drawing.track import MAX_POINTS, Track
from aras_visual_servo_camera.undistortion import CameraModel

GAZEBO = Path(__file__).parents[3] / "src" / "aras_visual_servo_gazebo"
STRAIGHT = np.array([0.1, 0.0, 0.3, -0.2, -0.1, 0.4])
BENT = np.array([0.05, 0.1, 0.2, -0.2, -0.1, 0.2])
SERVOING = told()


@pytest.fixture
def story(arm, pinhole):
    told = RunTrace(arm)
    told.camera = pinhole
    told.goal = np.array(arm.pose(BENT))
    return told


def shape(story, name):
    found = [entry for entry in story.make_shapes() if entry.name == name]
    assert len(found) == 1, name
    return found[0]


def test_the_path_begins_where_servoing_begins(story, arm):
    story.add_state(replace(SERVOING, phase="approaching"), BENT)
    assert len(story.path) == 0
    story.add_state(SERVOING, STRAIGHT)
    story.add_state(SERVOING, BENT)
    np.testing.assert_allclose(story.path, [arm.pose(q)[:3, 3] for q in (STRAIGHT, BENT)])
    ideal = story.compute_ideal_path()
    np.testing.assert_allclose(ideal[[0, -1]], [story.path[0], story.goal[:3, 3]])
    np.testing.assert_allclose(np.diff(ideal, axis=0), np.diff(ideal, axis=0)[:1].repeat(
        len(ideal) - 1, 0), atol=1e-12)  # fmt: skip


@pytest.mark.parametrize(("between", "kept"), [
    ("stopped", False), ("approaching", False), ("waiting", True), ("holding", True),
    ("converged", True),
])  # fmt: skip
def test_what_ends_a_run_begins_another(story, between, kept):
    story.set_joints(STRAIGHT)
    story.add_state(SERVOING, STRAIGHT)
    story.add_image_point("centre", 0.1, 0.1)
    story.add_state(replace(SERVOING, phase=between), STRAIGHT)
    story.add_state(SERVOING, BENT)
    story.add_image_point("centre", 0.3, 0.1)
    assert len(story.path) == 1 + kept
    assert len(shape(story, "trajectory centre").points) == 2 * kept


def test_a_clock_that_goes_back_leaves_nothing_of_the_run(story):
    story.set_joints(STRAIGHT)
    story.add_state(SERVOING, STRAIGHT)
    story.add_image_point("centre", 0.1, 0.1)
    story.clear()
    assert len(story.path) == len(story.compute_ideal_path()) == 0
    assert story.state.phase == ""
    assert not [entry for entry in story.make_shapes() if entry.name.startswith("trajectory")]


def test_arrows_point_where_the_camera_is_to_go(story, arm):
    story.set_joints(STRAIGHT)
    twist = (0.05, -0.025, 0.1, 0.0, 0.0, 0.5)
    story.add_state(told(asked=twist), STRAIGHT)
    tail, tip = shape(story, "desired velocity").points
    pose = arm.pose(STRAIGHT)
    np.testing.assert_allclose(tail, pose[:3, 3])
    np.testing.assert_allclose(tip - tail, pose[:3, :3] @ twist[:3] * ARROW_SECONDS)
    turn = shape(story, "desired turn").points
    assert np.cross(turn[1] - turn[0], pose[:3, 2]) == pytest.approx(np.zeros(3), abs=1e-12)
    assert (turn[1] - turn[0]) @ pose[:3, 2] > 0.0
    # what is not there is taken away, not left standing
    assert len(shape(story, "achieved velocity").points) == 0


def test_a_wild_twist_stays_in_the_room(story):
    story.set_joints(STRAIGHT)
    story.add_state(told(asked=(50.0, 0.0, 0.0, 0.0, np.nan, 0.0)), STRAIGHT)
    arrow = shape(story, "desired velocity")
    assert arrow.kind == ARROW
    assert np.linalg.norm(arrow.points[1] - arrow.points[0]) == pytest.approx(MAX_ARROW)
    assert len(shape(story, "desired turn").points) == 0


def test_the_desired_outline_lies_on_the_picture_where_it_is_to_be_seen(story, arm):
    story.set_joints(STRAIGHT)
    story.outline = np.array([[0.1, 0.2], [-0.1, 0.2], [0.0, -0.3]])
    drawn = shape(story, "desired outline")
    assert drawn.kind == STRIP
    camera = (drawn.points - arm.pose(STRAIGHT)[:3, 3]) @ arm.pose(STRAIGHT)[:3, :3]
    np.testing.assert_allclose(camera[:3, :2] / camera[:3, 2:], story.outline, atol=1e-12)
    np.testing.assert_allclose(camera[3], camera[0])
    assert np.ptp(camera[:, 2]) < 1e-12
    border = np.c_[
        compute_image_border(story.camera), np.ones(len(compute_image_border(story.camera)))
    ]
    farthest = np.linalg.norm(camera[0, 2] * border, axis=1).max()
    assert farthest == pytest.approx(FRUSTUM_SIZE)


def test_frames_stand_where_the_camera_is_and_where_it_is_to_be(story, arm):
    story.set_joints(STRAIGHT)
    for name, pose in (("camera", arm.pose(STRAIGHT)), ("desired", story.goal)):
        for i, axis in enumerate("xyz"):
            origin, tip = shape(story, f"{name} {axis}").points
            np.testing.assert_allclose(origin, pose[:3, 3])
            along = (tip - origin) / np.linalg.norm(tip - origin)
            np.testing.assert_allclose(along, pose[:3, i], atol=1e-12)


def test_points_in_the_picture_leave_trajectories(story):
    names = ("x0", "y0", "x1", "y1", "theta")
    for shift in (0.0, 0.1):
        values = (shift, 0.0, 0.5, shift, 1.0)
        story.add_state(told(names=names, error=values), STRAIGHT)
    story.set_joints(STRAIGHT)
    drawn = [s.name for s in story.make_shapes() if s.name.startswith("trajectory")]
    assert drawn == ["trajectory point 0", "trajectory point 1"]
    border = compute_image_border(story.camera)
    points = shape(story, "trajectory point 1").points
    expected = place_on_image_plane(border, np.array([[0.5, 0.0], [0.5, 0.1]]), FRUSTUM_SIZE)
    np.testing.assert_allclose(
        (points - story.pose[:3, 3]) @ story.pose[:3, :3], expected, atol=1e-12)


def test_border_of_a_fisheye_stays_in_front():
    fisheye = CameraModel(320, 240, (106.6, 0, 159.5, 0, 106.6, 119.5, 0, 0, 1.0), (0.0,) * 4,
                          "equidistant")  # fmt: skip
    border = compute_image_border(fisheye)
    assert np.isfinite(border).all()
    assert np.hypot(*border.T).max() == pytest.approx(np.tan(MAX_VIEW_ANGLE))
    corner = border[0]
    assert corner[0] < 0.0 and corner[1] < 0.0


def test_words_say_scheme_phase_reason_error_and_pace(story):
    story.factor = 0.987
    story.add_state(
        replace(SERVOING, outcome="joint_limit", reason="J2 stopped at its limit"), STRAIGHT
    )
    text = "\n".join(story.make_text_lines())
    for part in ("moments - servoing\njoint limit\n", "J2 stopped", "xn +0.0100", "yn -0.0200",
                 "real-time factor 0.99"):
        assert part in text


def test_a_track_keeps_its_ends_and_its_size():
    track = Track(2, 1e-6)
    for i in range(5 * MAX_POINTS):
        track.add(np.array([i, 0.0]))
    track.add(np.array([np.nan, 0.0]))
    points = track.points
    assert MAX_POINTS / 4 < len(points) <= MAX_POINTS
    assert points[0, 0] == 0.0
    assert points[-1, 0] > 4.9 * MAX_POINTS
    assert np.ptp(np.diff(points[:, 0])) <= np.diff(points[:, 0]).max() / 2


def test_words_and_page_have_the_units_of_what_ships_and_load_nobodys_class():
    assert find_feature_units("moments", 4) == ("m", "m", "m", "rad")
    assert find_feature_units("points", 8) == ("",) * 8
    assert find_feature_units("luminance", 3) == ("grey level",) * 3
    assert (
        find_feature_units("moments", 2)
        == find_feature_units("none", 1)
        == find_feature_units("", 0)
        == ()
    )
    assert find_feature_units("os:system", 1) == ()  # it is not called


def drawn(name):
    urdf = (GAZEBO / "targets" / f"{name}.urdf").read_text()
    return draw_model(urdf, lambda package: str(GAZEBO))


def test_corners_that_are_as_good_as_one_are_one():
    """A bent square of two triangles, each with corners of its own a third of a µm away."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0.05], [0, 1, 0]], float)
    mesh = Mesh(corners + np.linspace(0, 3e-7, 6)[:, None], np.zeros((6, 3)),
                np.array([[0, 1, 2], [3, 4, 5]]))
    assert model_drawing.find_mesh_edges(mesh).shape == (2 * 4, 3)


def test_a_target_is_drawn_by_its_edges_and_faces():
    plates = drawn("aras")
    edges = plates.edges
    assert edges.shape == (2 * 2 * 12, 3)  # two boxes of twelve edges: no diagonal of a face
    np.testing.assert_allclose(np.ptp(edges[:24], axis=0), (0.05, 0.05, 0.001), atol=1e-6)
    np.testing.assert_allclose(edges[24:].mean(axis=0), (-0.005, -0.025, -0.0005), atol=1e-6)
    way = np.diff(edges.reshape(-1, 2, 3), axis=1)[:, 0]
    assert ((np.abs(way) > 1e-6).sum(axis=1) == 1).all()
    ((colour, corners),) = plates.faces.items()
    assert colour == (0.0, 0.0, 0.0, 1.0) and corners.shape == (3 * 2 * 12, 3)
    assert len(drawn("l_shape").edges) == 2 * 6
    ((colour, corners),) = drawn("marker").faces.items()  # a picture, its mean
    assert 0.2 < colour[0] < 0.8 and colour[0] == pytest.approx(colour[2], abs=0.02)
    assert corners.shape == (6, 3)


def test_a_target_stands_where_it_lies_and_is_taken_away_when_it_is_gone(story):
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.2, 0.591
    plates = drawn("aras")
    story.target = edges, faces = plates.make_shapes(pose)
    assert (edges.name, edges.kind, faces.kind) == ("target", LINES, FACES)
    np.testing.assert_allclose(edges.points, plates.edges + pose[:3, 3])
    (corners,) = plates.faces.values()
    np.testing.assert_allclose(faces.points, corners + pose[:3, 3])
    assert shape(story, "target").points is edges.points
    (gone,) = plates.make_shapes(None)
    assert gone.name == "target" and not len(gone.points)
