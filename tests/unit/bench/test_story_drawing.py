"""3-D drawing of a run: widths, colours, positions and lengths as literal numbers."""

import cv2
import numpy as np
import pytest
from page_host import told
from scipy.spatial.transform import Rotation

from aras_sim_bridge.description import parse_urdf
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.meshes.mesh import Mesh
from aras_visual_servo_bench.drawing import model_drawing
from aras_visual_servo_bench.drawing import robot_visuals as parts_module
from aras_visual_servo_bench.drawing.robot_visuals import collect_visuals
from aras_visual_servo_bench.drawing.run_trace import RunTrace
from aras_visual_servo_bench.drawing.shapes import FACES, Shape, compute_image_border
from aras_visual_servo_bench.drawing.track import RealTimeFactor, Track
from aras_visual_servo_bench.web.live import robot_model as model_module
from aras_visual_servo_bench.web.live.robot_model import make_robot_model
from aras_visual_servo_camera.undistortion import CameraModel

STRAIGHT = np.array([0.1, 0.0, 0.3, -0.2, -0.1, 0.4])
BENT = np.array([0.05, 0.1, 0.2, -0.2, -0.1, 0.2])
TWIST = (0.05, -0.025, 0.1, 0.3, -0.2, 0.5)
# Name, width (m), opacity.
DRAWN = (
    ("path", 0.006, 1.0), ("ideal path", 0.003, 0.9), ("desired x", 0.0035, 0.9),
    ("camera x", 0.0025, 1.0), ("desired camera picture", 0.003, 0.9),
    ("camera picture", 0.003, 0.9), ("camera edges", 0.002, 0.9),
    ("desired outline", 0.002, 1.0), ("trajectory centre", 0.002, 1.0),
    ("desired velocity", 0.008, 1.0), ("desired turn", 0.008, 1.0),
    ("achieved velocity", 0.012, 0.55), ("achieved turn", 0.012, 0.55),
    ("words", 0.023, 1.0), ("legend camera", 0.023, 1.0), ("legend desired rotation", 0.023, 1.0),
)  # fmt: skip


@pytest.fixture
def story(arm, pinhole):
    found = RunTrace(arm)
    found.camera, found.goal = pinhole, np.array(arm.pose(BENT))
    found.outline = np.array([[0.1, 0.2], [-0.1, 0.2], [0.0, -0.3]])
    for q, x in ((BENT, 0.1), (STRAIGHT, 0.3)):
        found.add_state(told(asked=TWIST, achieved=TWIST), q)
        found.add_image_point("centre", x, 0.1)
    found.set_joints(STRAIGHT)
    return found


def shapes(story):
    return {shape.name: shape for shape in story.make_shapes()}


@pytest.mark.parametrize(("name", "width", "opacity"), DRAWN)
def test_widths_and_opacities(story, name, width, opacity):
    shape = shapes(story)[name]
    assert len(shape.points) and shape.colour[3] == opacity
    assert shape.width == pytest.approx(width)


def test_axes_are_red_green_and_blue(story):
    for i, name in enumerate("xyz"):
        colour = [0.25, 0.25, 0.25]
        colour[i] = 0.95
        assert list(shapes(story)[f"desired {name}"].colour) == [*colour, 0.9]


def test_the_camera_is_a_pyramid_of_sixteen_centimetres_of_the_camera_there_is(story, pinhole):
    for camera in (pinhole, CameraModel(200, 100, (150.0, 0, 80.0, 0, 140.0, 60.0, 0, 0, 1))):
        story.camera = camera
        (fx, _, cx), (_, fy, cy), _ = np.reshape(camera.K, (3, 3))
        w, h = camera.width, camera.height
        corners = np.array([[(u - cx) / fx, (v - cy) / fy, 1.0] for u, v in (
            (-0.5, -0.5), (w - 0.5, -0.5), (w - 0.5, h - 0.5), (-0.5, h - 0.5))])  # fmt: skip
        corners *= 0.16 / np.linalg.norm(corners, axis=1).max()
        found, pose = shapes(story), story.pose
        edges, border = ((found[f"camera {part}"].points - pose[:3, 3]) @ pose[:3, :3]
                         for part in ("edges", "picture"))  # fmt: skip
        np.testing.assert_allclose(edges[::2], np.zeros((4, 3)), atol=1e-12)
        np.testing.assert_allclose(edges[1::2], corners, atol=1e-9)
        np.testing.assert_allclose(border[::8], [*corners, corners[0]], atol=1e-9)
        assert len(border) == 4 * 8 + 1
    assert len(found["desired outline"].points) == len(story.outline) + 1


def test_before_anything_is_known_all_that_is_drawn_is_without_a_point(arm):
    story = RunTrace(arm)
    assert story.state.stamp == 0.0 and story.outline.shape == (0, 2)
    story.set_joints(STRAIGHT)
    assert {s.points.shape for s in story.make_shapes() if s.kind in ("strip", "arrow")} == {(0, 3)}


def test_places_nearer_than_half_a_millimetre_are_one(arm):
    story = RunTrace(arm)
    slide = np.eye(len(STRAIGHT))[np.argmax(arm.is_prismatic)]
    for shift in (0.0, 0.45e-3, 0.55e-3):
        story.add_state(told(), STRAIGHT + shift * slide)
    assert np.ptp(story.path, axis=0).max() == pytest.approx(0.55e-3) and len(story.path) == 2
    for x in (0.0, 1.9e-3, 2.1e-3):
        story.add_image_point("centre", x, 0.0)
    assert story._trajectories["centre"].points.tolist() == [[0.0, 0.0], [2.1e-3, 0.0]]


def test_a_shape_is_told_in_hundredths_of_a_millimetre():
    plain = Shape("a", FACES, np.array([[0.123456, -1.0, 2e-6]]), (0.1, 0.2, 0.3, 1.0)).to_json()
    assert plain == {"kind": "faces", "points": [0.12346, -1.0, 0.0],
                     "colour": [0.1, 0.2, 0.3, 1.0], "width": 0.004}  # fmt: skip


def test_words_stand_beside_the_camera_and_the_legend_above_them(story):
    found = shapes(story)
    words, camera = found["words"], story.pose[:3, 3]
    np.testing.assert_allclose(words.points, [camera + [0.24, -0.2, 0.19]])
    assert words.colour == (1.0, 1.0, 1.0, 1.0)
    legend = [s for s in found.values() if s.name.startswith("legend ")]
    up = np.array([s.points[0] - words.points[0] for s in legend])
    np.testing.assert_allclose(up[:, :2], 0.0, atol=1e-12)
    lines = words.text.count("\n") + 1
    np.testing.assert_allclose(up[:, 2], 0.028 * (lines / 2 + np.arange(1, len(legend) + 1)))


@pytest.mark.parametrize(("speed", "length"), [
    (0.9e-3, None), (1e-3, None), (1.1e-3, 2.2e-3), (0.14, 0.28), (0.2, 0.3)])
def test_an_arrow_is_two_seconds_or_a_tenth_of_the_angle_long_within_its_bounds(
    story, speed, length
):
    story.add_state(told(asked=(0.0, speed, 0.0, 0.0, 0.0, -20.0 * speed)), STRAIGHT)
    for name in ("desired velocity", "desired turn"):
        points = shapes(story)[name].points
        assert len(points) == (0 if length is None else 2)
        if length is not None:
            assert np.linalg.norm(points[1] - points[0]) == pytest.approx(length)


def test_the_straight_path_is_unknown_without_start_or_goal(arm):
    story = RunTrace(arm)
    assert story.compute_ideal_path().shape == (0, 3)
    story.add_state(told(), STRAIGHT)
    assert story.compute_ideal_path().shape == (0, 3)
    story.goal = np.array(arm.pose(BENT))
    assert len(story.compute_ideal_path()) == 24


def test_the_border_goes_around_the_picture_in_even_steps(pinhole):
    u, v = pinhole.project(*compute_image_border(pinhole).T)
    assert len(u) == 4 * 8
    w, h = pinhole.width, pinhole.height
    on_sides = (np.isclose(u, -0.5) | np.isclose(u, w - 0.5)
                | np.isclose(v, -0.5) | np.isclose(v, h - 0.5))  # fmt: skip
    assert on_sides.all()
    steps = np.abs(np.diff(np.stack([u, v]), axis=1, append=[[u[0]], [v[0]]]))
    np.testing.assert_allclose(steps[0], np.repeat([w / 8, 0, w / 8, 0], 8), atol=1e-6)
    np.testing.assert_allclose(steps[1], np.repeat([0, h / 8, 0, h / 8], 8), atol=1e-6)


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


def test_a_track_of_more_than_600_points_is_thinned_and_grows_in_longer_steps():
    even, folded, far = Track(2, 1.0), Track(2, 1.0), Track(2, 1.0)
    for i in range(601):
        if i == 600:
            assert len(even.points) == len(folded.points) == len(far.points) == 600
        even.add(np.array([i, 0.0]))
        folded.add(np.array([i % 2, 0.0]))
        far.add(np.array([3.0 * i, 0.0]))
    even.add(np.zeros(3))
    np.testing.assert_array_equal(even.points, np.c_[np.arange(0, 601, 2), np.zeros(301)])
    # the next: twice as far as before, or as far as those that are left lie from each other
    for track, last, step in ((even, 600.0, 2.0), (folded, 0.0, 2.0), (far, 1800.0, 6.0)):
        track.add(np.array([last + step - 0.01, 0.0]))
        assert len(track.points) == 301
        track.add(np.array([last + step, 0.0]))
        assert track.points[-1].tolist() == [last + step, 0.0]


def test_pace_looks_back_two_seconds_and_needs_three_tenths():
    pace = RealTimeFactor()
    pace.add(0.0, 0.0)
    pace.add(0.29, 0.29)
    assert pace.factor is None
    pace.add(0.3, 0.15)
    assert pace.factor is None  # its clock went back
    pace.add(0.6, 0.15)
    assert pace.factor == 0.0  # it stands
    pace.add(1.3, 0.65)
    pace.add(2.3, 1.65)
    assert pace.factor == pytest.approx(0.75)
    pace.add(2.31, 1.65)
    assert pace.factor == pytest.approx(1.5 / 1.71)
    pace = RealTimeFactor()
    pace.add(0.0, 0.0)
    pace.add(0.3, 0.3)
    assert pace.factor == 1.0


def test_pace_is_that_of_the_last_two_seconds():
    pace = RealTimeFactor()
    for i in range(61):  # 1.0 up to the third second, then 0.4
        pace.add(0.1 * i, min(0.1 * i, 3.0) + 0.4 * max(0.1 * i - 3.0, 0.0))
        if i == 2:
            assert pace.factor is None  # after 0.2 s there is nothing to tell
        if i == 40:
            assert pace.factor == pytest.approx((1.0 + 0.4) / 2)
    assert pace.factor == pytest.approx(0.4)
    pace.add(10.0, 0.0)  # the clock went back
    assert pace.factor is None


@pytest.mark.parametrize(("degrees", "edges"), [(0.0, 4), (25.0, 4), (35.0, 5), (120.0, 5)])
def test_an_edge_is_drawn_where_faces_bend_by_more_than_thirty_degrees(degrees, edges):
    bend = np.radians(degrees)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-np.cos(bend), 0, np.sin(bend)]])
    mesh = Mesh(corners, np.zeros((4, 3)), np.array([[0, 1, 2], [0, 2, 3]]))
    assert len(model_drawing.find_mesh_edges(mesh)) == 2 * edges


def test_an_edge_that_bends_by_just_that_angle_is_none(monkeypatch):
    monkeypatch.setattr(model_drawing, "CREASE_COSINE", 0.0)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    mesh = Mesh(corners, np.zeros((4, 3)), np.array([[0, 1, 2], [0, 2, 3]]))
    assert len(model_drawing.find_mesh_edges(mesh)) == 2 * 4


def test_of_a_large_model_2000_edges_and_triangles_are_drawn(monkeypatch):
    corners = np.random.default_rng(5).random((3 * 2100, 3)).round(6)
    mesh = Mesh(corners, corners, np.arange(len(corners)).reshape(-1, 3))
    monkeypatch.setattr(
        model_drawing, "collect_visuals", lambda robot, _: [(robot.root, (1.0,), mesh)]
    )
    model = model_drawing.draw_model(URDF)
    assert model.edges.shape == (2 * 2000, 3)
    np.testing.assert_array_equal(model.faces[1.0,], corners[:3 * 2000])


def test_a_target_has_grey_edges_of_a_millimetre():
    for pose in (np.eye(4), None):
        edges = model_drawing.draw_model(URDF).make_shapes(pose)[0]
        assert (edges.colour, edges.width) == ((0.55, 0.58, 0.64, 1.0), 0.001)
        assert edges.points.shape == (0 if pose is None else 2 * 12, 3)
    assert model_drawing.draw_model('<robot name="r"><link name="a"/></robot>').edges.shape == (
        0,
        3,
    )


URDF = """<robot name="r"><link name="a"><visual><geometry><box size="1 2 3"/></geometry></visual>
  </link><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>
  <origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_a_model_s_joints_lie_where_the_description_says_and_what_has_no_colour_is_grey():
    model = make_robot_model(URDF)
    placed = np.reshape(model["joints"][0]["origin"], (4, 4))
    np.testing.assert_allclose(placed[:3, 3], (0.1, -0.2, 0.3))
    turned = Rotation.from_euler("xyz", (0.4, -0.5, 0.6)).as_matrix()
    np.testing.assert_allclose(placed[:3, :3], turned, atol=1e-12)
    ((link, colour, _),) = collect_visuals(parse_urdf(URDF), URDF)
    assert (link, colour) == ("a", (0.7, 0.7, 0.72, 1.0))


def test_a_colour_is_the_visuals_or_that_of_its_name_and_four_numbers():
    """Of each material what it says itself comes first."""
    given = (
        ('<material name="m"><color rgba="0.1 0.2 0.3 0.4"/></material>', (0.1, 0.2, 0.3, 0.4)),
        ('<material name="m"/>', (0.5, 0.6, 0.7, 0.8)),
        *((f'<material name="n">{colour}</material>', (0.7, 0.7, 0.72, 1.0)) for colour in (
            "", "<color/>", '<color rgba="red"/>', '<color rgba="1 1 1"/>',
            '<color rgba="1 1 1 1 1"/>')),
    )  # fmt: skip
    known = '<material name="m"><color rgba="0.5 0.6 0.7 0.8"/></material>'
    for material, colour in given:
        urdf = URDF.replace("</visual>", f"{material}</visual>")
        urdf = urdf.replace("<link", f"{known}<link", 1)
        ((_, found, _),) = collect_visuals(parse_urdf(urdf), urdf)
        assert found == colour, material


def test_the_colour_of_a_picture_is_its_mean_and_of_none_the_models(tmp_path, monkeypatch):
    picture = np.zeros((2, 3, 3), np.uint8)
    picture[0] = 51, 102, 255  # blue, green, red; the other row is black
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    colours = []
    for texture, rgba in (("a.png", None), ("none.png", None), (None, (0.1, 0.2, 0.3, 1.0))):
        mesh = Mesh(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((1, 3), int), rgba=rgba,
                    texture=texture and str(tmp_path / texture))  # fmt: skip
        monkeypatch.setattr(parts_module, "make_meshes", lambda _, mesh=mesh: (mesh,))
        colours += [colour for _, colour, _ in collect_visuals(parse_urdf(URDF), URDF)]
    assert colours[0] == pytest.approx((0.5, 0.2, 0.1, 1.0))
    assert colours[1:] == [(0.7, 0.7, 0.72, 1.0), (0.1, 0.2, 0.3, 1.0)]


def test_a_page_draws_400_000_triangles(monkeypatch):
    for count in (400_000, 400_001):
        half = Mesh(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((count - 200_000, 3), np.int8))
        rest = Mesh(half.positions, half.normals, np.zeros((200_000, 3), np.int8))
        monkeypatch.setattr(model_module, "collect_visuals", lambda *_, both=(half, rest): [
            ("a", (1.0,), mesh) for mesh in both])  # fmt: skip
        monkeypatch.setattr(model_module, "_encode_mesh", lambda mesh: "")
        if count == 400_000:
            assert len(make_robot_model(URDF)["links"]["a"]) == 2
            continue
        with pytest.raises(
            DescriptionError, match="the meshes of r have 400001 triangles, must be at most 400000"
        ):
            make_robot_model(URDF)


def test_joints_are_told_with_what_they_join():
    (joint,) = make_robot_model(URDF)["joints"]
    assert (joint["parent"], joint["child"], joint["axis"]) == ("a", "b", [0.0, 0.0, 1.0])
