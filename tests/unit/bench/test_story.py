"""3-D drawing of a run: positions of shapes, and restart of the trace."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_host import told

from aras_sim_bridge.description import parse_urdf
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.meshes.mesh import Mesh
from aras_visual_servo_bench.ros.real_time_factor import RealTimeFactor
from aras_visual_servo_bench.visualization import model_drawing
from aras_visual_servo_bench.visualization.drawing_shapes import (
    FACES,
    LINES,
    STRIP,
    compute_image_border,
    place_on_image_plane,
)
from aras_visual_servo_bench.visualization.feature_units import find_feature_units
from aras_visual_servo_bench.visualization.model_drawing import draw_model
from aras_visual_servo_bench.visualization.point_trajectory import MAX_POINTS, PointTrajectory
from aras_visual_servo_bench.visualization.robot_visuals import collect_visuals
from aras_visual_servo_bench.visualization.run_drawing import (
    ARROW_SECONDS,
    FRUSTUM_SIZE,
    RunDrawing,
)
from aras_visual_servo_bench.web.live.robot_model import make_robot_model
from aras_visual_servo_camera.camera_model import CameraModel

GAZEBO = Path(__file__).parents[3] / "src" / "aras_visual_servo_gazebo"
STRAIGHT = np.array([0.1, 0.0, 0.3, -0.2, -0.1, 0.4])
BENT = np.array([0.05, 0.1, 0.2, -0.2, -0.1, 0.2])
SERVOING = told()


@pytest.fixture
def story(arm, pinhole):
    found = RunDrawing(arm)
    found.camera, found.goal = pinhole, np.array(arm.pose(BENT))
    found.outline = np.array([[0.1, 0.2], [-0.1, 0.2], [0.0, -0.3]])
    found.set_joints(STRAIGHT)
    return found


def shape(story, name):
    found = [entry for entry in story.make_shapes() if entry.name == name]
    assert len(found) == 1, name
    return found[0]


@pytest.mark.parametrize(("between", "kept"), [
    ("stopped", False), ("approaching", False), ("waiting", True), ("holding", True),
    ("converged", True)])  # fmt: skip
def test_what_ends_a_run_begins_another(story, arm, between, kept):
    story.add_state(replace(SERVOING, phase="approaching"), BENT)
    assert len(story.path) == len(story.compute_ideal_path()) == 0
    story.add_state(SERVOING, STRAIGHT)
    story.add_image_point("centre", 0.1, 0.1)
    story.add_state(replace(SERVOING, phase=between), STRAIGHT)
    story.add_state(SERVOING, BENT)
    story.add_image_point("centre", 0.3, 0.1)
    way = [arm.pose(q)[:3, 3] for q in (STRAIGHT, BENT)][not kept:]
    np.testing.assert_allclose(story.path, way)
    assert len(shape(story, "trajectory centre").points) == 2 * kept
    ideal = story.compute_ideal_path()
    straight = np.linspace(story.path[0], story.goal[:3, 3], len(ideal))
    np.testing.assert_allclose(ideal, straight, atol=1e-12)
    story.clear()  # a clock that goes back leaves nothing of the run
    assert len(story.path) == len(story.compute_ideal_path()) == 0
    assert story.state.phase == ""
    assert not [entry for entry in story.make_shapes() if entry.name.startswith("trajectory")]


def test_frames_and_arrows_stand_where_the_camera_is_and_is_to_go(story, arm):
    pose = arm.pose(STRAIGHT)
    for name, at in (("camera", pose), ("desired", story.goal)):
        for i, axis in enumerate("xyz"):
            origin, tip = shape(story, f"{name} {axis}").points
            np.testing.assert_allclose(origin, at[:3, 3])
            along = (tip - origin) / np.linalg.norm(tip - origin)
            np.testing.assert_allclose(along, at[:3, i], atol=1e-12)
    twist = (0.05, -0.025, 0.1, 0.0, 0.0, 0.5)
    story.add_state(told(asked=twist), STRAIGHT)
    tail, tip = shape(story, "desired velocity").points
    np.testing.assert_allclose(tail, pose[:3, 3])
    np.testing.assert_allclose(tip - tail, pose[:3, :3] @ twist[:3] * ARROW_SECONDS)
    turn = shape(story, "desired turn").points
    assert np.cross(turn[1] - turn[0], pose[:3, 2]) == pytest.approx(np.zeros(3), abs=1e-12)
    assert (turn[1] - turn[0]) @ pose[:3, 2] > 0.0
    # what is not there is taken away, not left standing
    assert len(shape(story, "achieved velocity").points) == 0


def test_points_in_the_picture_leave_trajectories_and_the_desired_outline_lies_on_it(story):
    names = ("x0", "y0", "x1", "y1", "theta")
    for shift in (0.0, 0.1):
        story.add_state(told(names=names, error=(shift, 0.0, 0.5, shift, 1.0)), STRAIGHT)
    drawn = [s.name for s in story.make_shapes() if s.name.startswith("trajectory")]
    assert drawn == ["trajectory point 0", "trajectory point 1"]
    border = compute_image_border(story.camera)
    outline = [*story.outline, story.outline[0]]
    assert shape(story, "desired outline").kind == STRIP
    for name, seen in (("trajectory point 1", [[0.5, 0.0], [0.5, 0.1]]),
                       ("desired outline", outline)):  # fmt: skip
        local = (shape(story, name).points - story.pose[:3, 3]) @ story.pose[:3, :3]
        expected = place_on_image_plane(border, np.array(seen), FRUSTUM_SIZE)
        np.testing.assert_allclose(local, expected, atol=1e-12)
        np.testing.assert_allclose(local[:, :2] / local[:, 2:], seen, atol=1e-12)
        farthest = np.linalg.norm(local[0, 2] * np.c_[border, np.ones(len(border))], axis=1).max()
        assert farthest == pytest.approx(FRUSTUM_SIZE)


def test_words_say_scheme_phase_reason_error_and_pace(story):
    story.factor = 0.987
    limited = replace(SERVOING, outcome="joint_limit", reason="stop " * 40)
    story.add_state(limited, STRAIGHT)
    text = "\n".join(story.make_text_lines())
    wrapped = 3 * f"{' '.join(['stop'] * 9)}\n"
    for part in (f"moments - servoing\njoint limit\n{wrapped}xn +0.0100", "yn -0.0200",
                 "real-time factor 0.99"):
        assert part in text


@pytest.mark.parametrize(("scheme", "count", "units"), [
    ("moments", 4, ("m", "m", "m", "rad")), ("points", 8, ("",) * 8),
    ("luminance", 3, ("grey level",) * 3), ("moments", 2, ()), ("none", 1, ()), ("", 0, ()),
    ("os:system", 1, ()),  # it is not called
])  # fmt: skip
def test_words_and_page_have_the_units_of_what_ships_and_load_nobodys_class(scheme, count, units):
    assert find_feature_units(scheme, count) == units


def drawn(name):
    urdf = (GAZEBO / "targets" / f"{name}.urdf").read_text()
    return draw_model(urdf, lambda package: str(GAZEBO))


def test_a_target_is_drawn_by_its_edges_and_faces(story):
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
    ((colour, face),) = drawn("marker").faces.items()  # a picture, its mean
    assert 0.2 < colour[0] < 0.8 and colour[0] == pytest.approx(colour[2], abs=0.02)
    assert face.shape == (6, 3)
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.2, 0.591  # where it lies
    story.target = found, faces = plates.make_shapes(pose)
    assert (found.name, found.kind, faces.kind) == ("target", LINES, FACES)
    np.testing.assert_allclose(found.points, edges + pose[:3, 3])
    np.testing.assert_allclose(faces.points, corners + pose[:3, 3])
    assert shape(story, "target").points is found.points
    (gone,) = plates.make_shapes(None)
    assert gone.name == "target" and not len(gone.points)


def test_places_nearer_than_half_a_millimetre_are_one_and_a_track_keeps_its_ends(story, arm):
    slide = np.eye(len(STRAIGHT))[np.argmax(arm.is_prismatic)]
    for shift in (0.0, 0.45e-3, 0.55e-3):
        story.add_state(told(), STRAIGHT + shift * slide)
    assert np.ptp(story.path, axis=0).max() == pytest.approx(0.55e-3) and len(story.path) == 2
    for x in (0.0, 1.9e-3, 2.1e-3):
        story.add_image_point("centre", x, 0.0)
    story.camera = CameraModel(200, 100, (100.0, 0, 99.5, 0, 100.0, 49.5, 0, 0, 1))
    assert len(shape(story, "trajectory centre").points) == 2
    track = PointTrajectory(2, 1e-6)
    for i in range(5 * MAX_POINTS):
        track.add(np.array([i, 0.0]))
    track.add(np.array([np.nan, 0.0]))
    x = track.points[:, 0]
    assert MAX_POINTS / 4 < len(x) <= MAX_POINTS
    assert x[0] == 0.0 and x[-1] > 4.9 * MAX_POINTS
    assert np.ptp(np.diff(x)) <= np.diff(x).max() / 2


@pytest.mark.parametrize(("speed", "length"), [
    (0.9e-3, None), (1.1e-3, 2.2e-3), (0.14, 0.28), (0.2, 0.3)])
def test_an_arrow_is_two_seconds_or_a_tenth_of_the_angle_long_within_its_bounds(
        story, speed, length):
    turn = -20.0 * speed if length else np.nan
    story.add_state(told(asked=(0.0, speed, 0.0, 0.0, 0.0, turn)), STRAIGHT)
    for name in ("desired velocity", "desired turn"):
        points = shape(story, name).points
        assert len(points) == (0 if length is None else 2)
        if length is not None:
            assert np.linalg.norm(points[1] - points[0]) == pytest.approx(length)


def test_the_border_of_a_wide_picture_is_narrowed_where_it_is_too_wide():
    """Half of 320 px at f = 50 is 72.6 degrees from the axis, half of 240 px 67.4."""
    camera = CameraModel(320, 240, (50.0, 0, 159.5, 0, 50.0, 119.5, 0, 0, 1))
    border = compute_image_border(camera)
    angle = np.degrees(np.arctan(np.hypot(*border.T)))
    below, beside = np.abs(border[:, 0]).argmin(), np.abs(border[:, 1]).argmin()
    assert angle.max() == pytest.approx(70.0) and angle[beside] == pytest.approx(70.0)
    assert np.abs(border[below]) == pytest.approx([0.0, 2.4], abs=1e-9)
    exact = angle < 69.9
    assert 0 < exact.sum() < len(border)
    u, v = camera.project(*border[exact].T)
    assert (np.isclose(v, -0.5) | np.isclose(v, 239.5)).all()
    way = (np.stack(camera.project(*border.T), 1) - (159.5, 119.5)) / (160.0, 120.0)
    side, low = np.arange(-1.0, 1.0, 0.25), np.full(8, -1.0)
    np.testing.assert_allclose(way / np.abs(way).max(axis=1, keepdims=True), np.concatenate([
        np.stack(pair, 1) for pair in ((side, low), (-low, side), (-side, -low), (low, -side))
    ]), atol=1e-9)  # fmt: skip


def test_pace_looks_back_two_seconds_and_needs_three_tenths():
    pace = RealTimeFactor()
    for wall, simulated, factor in (
        (0.0, 0.0, None), (0.29, 0.29, None), (0.3, 0.15, None),  # its clock went back
        (0.6, 0.15, 0.0),  # it is at rest
        (1.3, 0.65, 0.5), (2.3, 1.65, 0.75), (2.31, 1.65, 1.5 / 1.71),
    ):  # fmt: skip
        pace.add(wall, simulated)
        assert pace.factor == (factor and pytest.approx(factor))
    pace = RealTimeFactor()
    pace.add(0.0, 0.0)
    pace.add(0.3, 0.3)
    assert pace.factor == 1.0


@pytest.mark.parametrize(("degrees", "edges"), [(0.0, 4), (25.0, 4), (35.0, 5), (120.0, 5)])
def test_an_edge_is_drawn_where_faces_bend_by_more_than_thirty_degrees(degrees, edges):
    """Of triangles with corners of their own, a third of a µm away, which are as good as one."""
    bend = np.radians(degrees)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-np.cos(bend), 0, np.sin(bend)]])
    apart = corners[[0, 1, 2, 0, 2, 3]] + np.linspace(0, 3e-7, 6)[:, None]
    for places, faces in ((corners, [[0, 1, 2], [0, 2, 3]]), (apart, [[0, 1, 2], [3, 4, 5]])):
        mesh = Mesh(places, np.zeros_like(places), np.array(faces))
        assert len(model_drawing.find_mesh_edges(mesh)) == 2 * edges


URDF = """<robot name="r"><link name="a"><visual><geometry><box size="1 2 3"/></geometry></visual>
  </link><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>
  <origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_a_colour_is_the_visuals_or_that_of_its_name_and_four_numbers():
    given = (
        ('<material name="m"><color rgba="0.1 0.2 0.3 0.4"/></material>', (0.1, 0.2, 0.3, 0.4)),
        ('<material name="m"/>', (0.5, 0.6, 0.7, 0.8)),
        *((f'<material name="n">{colour}</material>', (0.7, 0.7, 0.72, 1.0)) for colour in (
            "", "<color/>", '<color rgba="red"/>', '<color rgba="1 1 1"/>',
            '<color rgba="1 1 1 1 1"/>')))  # fmt: skip
    known = '<material name="m"><color rgba="0.5 0.6 0.7 0.8"/></material>'
    for material, colour in given:
        urdf = URDF.replace("</visual>", f"{material}</visual>")
        urdf = urdf.replace("<link", f"{known}<link", 1)
        ((_, found, _),) = collect_visuals(parse_urdf(urdf), urdf)
        assert found == colour, material


def write_mesh(folder, corners):
    """Write a binary STL file of these corners (3 n, 3), and return a description with it."""
    rows = np.zeros(len(corners) // 3, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)),
                                        ("", "<u2")])  # fmt: skip
    rows["corners"] = corners.reshape(-1, 3, 3)
    path = folder / "mesh.stl"
    path.write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())
    return URDF.replace('<box size="1 2 3"/>', f'<mesh filename="file://{path}"/>')


def test_a_page_draws_400_000_triangles_and_a_target_2000(tmp_path):
    corners = np.random.default_rng(5).random((3 * 2100, 3)).round(3).astype(np.float32)
    model = draw_model(write_mesh(tmp_path, corners))
    assert model.edges.shape == (2 * 2000, 3)
    ((_, faces),) = model.faces.items()
    np.testing.assert_allclose(faces, corners[:3 * 2000], atol=1e-6)
    urdf = write_mesh(tmp_path, np.tile(np.eye(3), (200_001, 1)))
    (visual,) = re.findall("<visual>.*?</visual>", urdf, re.S)
    assert len(make_robot_model(urdf)["links"]["a"]) == 1
    told = "the meshes of r have 400002 triangles, must be at most 400000"
    with pytest.raises(DescriptionError, match=told):
        make_robot_model(urdf.replace(visual, visual + visual))


def test_the_camera_is_a_pyramid_of_sixteen_centimetres_of_the_camera_there_is(story):
    for camera in (story.camera, CameraModel(200, 100, (150.0, 0, 80, 0, 140.0, 60, 0, 0, 1))):
        story.camera = camera
        (fx, _, cx), (_, fy, cy), _ = np.reshape(camera.K, (3, 3))
        w, h = camera.width, camera.height
        corners = np.array([[(u - cx) / fx, (v - cy) / fy, 1.0] for u, v in (
            (-0.5, -0.5), (w - 0.5, -0.5), (w - 0.5, h - 0.5), (-0.5, h - 0.5))])  # fmt: skip
        corners *= 0.16 / np.linalg.norm(corners, axis=1).max()
        pose = story.pose
        edges, border = ((shape(story, f"camera {part}").points - pose[:3, 3]) @ pose[:3, :3]
                         for part in ("edges", "picture"))  # fmt: skip
        np.testing.assert_allclose(edges[::2], np.zeros((4, 3)), atol=1e-12)
        np.testing.assert_allclose(edges[1::2], corners, atol=1e-9)
        np.testing.assert_allclose(border[::8], [*corners, corners[0]], atol=1e-9)
        assert len(border) == 4 * 8 + 1
