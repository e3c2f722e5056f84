"""How a run is drawn: widths, colours, places and lengths, by literal numbers."""

import numpy as np
import pytest
from page_host import told
from scipy.spatial.transform import Rotation

from aras_sim_bridge.description import parse_urdf
from aras_visual_servo_base.meshes.mesh import Mesh
from aras_visual_servo_bench.live import outlines
from aras_visual_servo_bench.live.robot_model import parts, robot_model
from aras_visual_servo_bench.live.shapes import picture_border
from aras_visual_servo_bench.live.story import Story
from aras_visual_servo_bench.live.track import Pace
from aras_visual_servo_camera.undistortion import CameraModel

STRAIGHT = np.array([0.1, 0.0, 0.3, -0.2, -0.1, 0.4])
BENT = np.array([0.05, 0.1, 0.2, -0.2, -0.1, 0.2])
TWIST = (0.05, -0.025, 0.1, 0.3, -0.2, 0.5)
# Name, width (m), opacity.
DRAWN = (
    ("path", 0.006, 1.0), ("ideal path", 0.003, 0.9), ("desired x", 0.0035, 0.9),
    ("camera x", 0.0025, 1.0), ("desired camera picture", None, 0.9), ("camera picture", None, 0.9),
    ("desired outline", 0.002, 1.0), ("trajectory centre", 0.002, 1.0),
    ("asked velocity", 0.008, 1.0), ("asked turn", 0.008, 1.0),
    ("achieved velocity", 0.012, 0.55), ("achieved turn", 0.012, 0.55),
    ("words", 0.023, 1.0), ("legend camera", 0.023, 1.0), ("legend turn asked", 0.023, 1.0),
)  # fmt: skip


@pytest.fixture
def story(arm, pinhole):
    found = Story(arm)
    found.camera, found.goal = pinhole, np.array(arm.pose(BENT))
    found.outline = np.array([[0.1, 0.2], [-0.1, 0.2], [0.0, -0.3]])
    for q, x in ((BENT, 0.1), (STRAIGHT, 0.3)):
        found.say(told(asked=TWIST, achieved=TWIST), q)
        found.see("centre", x, 0.1)
    found.joints(STRAIGHT)
    return found


def shapes(story):
    return {shape.name: shape for shape in story.shapes()}


@pytest.mark.parametrize(("name", "width", "opacity"), DRAWN)
def test_widths_and_opacities(story, name, width, opacity):
    shape = shapes(story)[name]
    assert len(shape.points) and shape.colour[3] == opacity
    assert width is None or shape.width == pytest.approx(width)


def test_words_stand_beside_the_camera_and_the_legend_above_them(story):
    found = shapes(story)
    words, camera = found["words"], story.pose[:3, 3]
    np.testing.assert_allclose(words.points, [camera + [-0.29, 0.24, 0.19]])
    assert words.colour == (1.0, 1.0, 1.0, 1.0)
    legend = [s for s in found.values() if s.name.startswith("legend ")]
    up = np.array([s.points[0] - words.points[0] for s in legend])
    np.testing.assert_allclose(up[:, :2], 0.0, atol=1e-12)
    lines = words.text.count("\n") + 1
    np.testing.assert_allclose(up[:, 2], 0.028 * (lines / 2 + np.arange(1, len(legend) + 1)))


@pytest.mark.parametrize(("speed", "length"), [
    (0.9e-3, None), (1.1e-3, 2.2e-3), (0.14, 0.28), (0.2, 0.3)])
def test_an_arrow_is_two_seconds_or_a_tenth_of_the_angle_long_within_its_bounds(
    story, speed, length
):
    story.say(told(asked=(0.0, speed, 0.0, 0.0, 0.0, -20.0 * speed)), STRAIGHT)
    for name in ("asked velocity", "asked turn"):
        points = shapes(story)[name].points
        assert len(points) == (0 if length is None else 2)
        if length is not None:
            assert np.linalg.norm(points[1] - points[0]) == pytest.approx(length)


def test_the_straight_path_is_unknown_without_start_or_goal(arm):
    story = Story(arm)
    assert story.ideal().shape == (0, 3)
    story.say(told(), STRAIGHT)
    assert story.ideal().shape == (0, 3)
    story.goal = np.array(arm.pose(BENT))
    assert len(story.ideal()) == 24


def test_the_border_goes_around_the_picture_in_even_steps(pinhole):
    u, v = pinhole.project(*picture_border(pinhole).T)
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
    border = picture_border(camera)
    angle = np.degrees(np.arctan(np.hypot(*border.T)))
    below, beside = np.abs(border[:, 0]).argmin(), np.abs(border[:, 1]).argmin()
    assert angle.max() == pytest.approx(70.0) and angle[beside] == pytest.approx(70.0)
    assert np.abs(border[below]) == pytest.approx([0.0, 2.4], abs=1e-9)
    exact = angle < 69.9
    assert 0 < exact.sum() < len(border)
    u, v = camera.project(*border[exact].T)
    assert (np.isclose(v, -0.5) | np.isclose(v, 239.5)).all()


def test_pace_is_that_of_the_last_two_seconds():
    pace = Pace()
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
    assert len(outlines.mesh_edges(mesh)) == 2 * edges


URDF = """<robot name="r"><link name="a"><visual><geometry><box size="1 2 3"/></geometry></visual>
  </link><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>
  <origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_a_model_s_joints_lie_where_the_description_says_and_what_has_no_colour_is_grey():
    model = robot_model(URDF)
    placed = np.reshape(model["joints"][0]["origin"], (4, 4))
    np.testing.assert_allclose(placed[:3, 3], (0.1, -0.2, 0.3))
    turned = Rotation.from_euler("xyz", (0.4, -0.5, 0.6)).as_matrix()
    np.testing.assert_allclose(placed[:3, :3], turned, atol=1e-12)
    ((link, colour, _),) = parts(parse_urdf(URDF), URDF)
    assert (link, colour) == ("a", (0.7, 0.7, 0.72, 1.0))
