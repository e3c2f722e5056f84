"""Shapes of targets by their corners: named ones, the demo's plates, solids, SVG outlines."""


import cv2
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.shape_meshes import make_meshes
from aras_sim_bridge.description.types import Geometry
from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError, OutOfViewError
from aras_visual_servo_bench.targets.geometry import (
    ARAS,
    PlacedTarget,
    PolygonTarget,
    RoundTarget,
    project,
)
from aras_visual_servo_bench.targets.rendering import render_target
from aras_visual_servo_bench.targets.solids import make_solid, read_solid_target
from aras_visual_servo_bench.targets.svg_outlines import read_svg
from aras_visual_servo_bench.targets.target_factory import make_target
from aras_visual_servo_bench.targets.target_files import write_description, write_target
from aras_visual_servo_bench.targets.target_spec import TargetSpec
from aras_visual_servo_bench.targets.temporary_folders import make_scratch_folder
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import TrackingModelError
from aras_visual_servo_camera.model_tracker import read_solid

SIZE = (0.3, 0.2)
CAMERA = CameraModel(320, 240, (301.0, 0, 163.2, 0, 285.0, 114.7, 0, 0, 1))


def above(x, y, z):
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = x, y, z
    return pose


@pytest.mark.parametrize(("name", "corners"), [
    ("square", [(-0.15, -0.1), (0.15, -0.1), (0.15, 0.1), (-0.15, 0.1)]),
    ("triangle", [(-0.15, -0.08), (0.15, -0.06), (-0.03, 0.1)]),
    ("l_shape", [(-0.15, -0.1), (0.15, -0.1), (0.15, -0.02), (-0.03, -0.02), (-0.03, 0.1),
                 (-0.15, 0.1)]),
    *((name, [(0.15 * np.cos(a), 0.1 * np.sin(a)) for a in 2 * np.pi * np.arange(n) / n])
      for name, n in (("heptagon", 7), ("circle", 180)))])  # fmt: skip
def test_named_outlines_have_their_corners_in_their_size(name, corners):
    target = make_target(name, SIZE)
    flat = np.column_stack([corners, np.zeros(len(corners))])
    np.testing.assert_allclose(target.vertices(), flat, atol=1e-12)
    pose = above(0.05, -0.02, 0.5)
    seen_at = np.column_stack([np.array(corners)[:, 0] - 0.05, -0.02 - np.array(corners)[:, 1]])
    np.testing.assert_allclose(target.outline(pose), seen_at / 0.5, atol=1e-12)
    if name == "circle":
        assert target.points(pose) is None and isinstance(target, RoundTarget)
    else:
        np.testing.assert_array_equal(target.points(pose), target.outline(pose))
    assert target.height == 0.0 and target.depth(pose) == pytest.approx(0.5)
    assert target.outline_plane(pose) == target.plane(pose)


# x and y, m, of the plates' outline seen from above, and its height: the small plate lies on the
# rim of the large one.
PLATES = [(-0.025, -0.025, 0.5905), (-0.0175, -0.025, 0.59075), (-0.0175, -0.0375, 0.59075),
          (0.0075, -0.0375, 0.59075), (0.0075, -0.025, 0.59075), (0.025, -0.025, 0.5905),
          (0.025, 0.025, 0.5905), (-0.025, 0.025, 0.5905)]  # fmt: skip


def test_the_demo_s_plates_are_where_the_robot_s_description_has_them(tmp_path):
    corners = ARAS.vertices()
    begin = int(np.argmin(np.abs(corners[:, :2] - PLATES[0][:2]).sum(axis=1)))
    round_ = np.roll(corners, -begin, axis=0)
    if abs(round_[1, 0] - PLATES[1][0]) > 1e-9:
        round_ = np.roll(round_[::-1], 1, axis=0)
    np.testing.assert_allclose(round_, PLATES, atol=1e-12)
    pose = above(0.5, 0.1, 0.9)
    assert ARAS.depth(pose) == pytest.approx(0.9 - 0.5905)
    np.testing.assert_allclose(ARAS.plane(pose), [0.0, 0.0, 1.0 / 0.3095], atol=1e-9)
    # From aside the large plate's side is seen down to the table, z = 0.59.
    x, _ = ARAS.outline(pose).T
    assert x.max() == pytest.approx((0.025 - 0.5) / 0.31, abs=1e-9)
    assert x.min() == pytest.approx((-0.025 - 0.5) / 0.3095, abs=1e-9)
    point = np.array([[2e-4, 1e-4, 0.0]])  # what is nearer than a millimetre has no view
    np.testing.assert_allclose(project(point, above(0.0, 0.0, 1.1e-3)), [(2 / 11, -1 / 11)])
    for look in (lambda: ARAS.outline(above(0.0, 0.0, 0.3)),
                 lambda: project(point, above(0.0, 0.0, 0.9e-3))):  # fmt: skip
        with pytest.raises(OutOfViewError):
            look()
    assert make_target("aras", SIZE) is ARAS
    with pytest.raises(ExperimentError, match="'aras' is part of the robot description and has no"):
        write_target(ARAS, tmp_path)


def test_a_view_that_is_none_is_none():
    square = make_target("square", SIZE)
    placed = PlacedTarget(square, matrix_from_xyz_rpy((0.1, 0.2, 0.3), (0.0, 0.0, 0.4)))
    pose = matrix_from_xyz_rpy((0.1, 0.2, 0.9), (np.pi, 0.1, 0.2))
    found = placed.project(square.outline, pose)
    np.testing.assert_allclose(found, square.outline(np.linalg.inv(placed.pose) @ pose), atol=1e-12)
    for none in (np.full((4, 4), np.nan), matrix_from_xyz_rpy((0.1, 0.2, 0.9), (0.0, 0.0, 0.0))):
        assert placed.project(square.outline, none) is None


@pytest.mark.parametrize(("name", "share", "rel"), [
    ("box", 1.0, 1e-9), ("cylinder", np.pi / 4, 0.03), ("sphere", np.pi / 6, 0.06)])
def test_a_primitive_fills_its_size_about_its_origin(name, share, rel):
    size = (0.3, 0.2, 0.16)
    target = make_target(name, size)
    corners = target.solid.vertices
    np.testing.assert_allclose(corners.max(axis=0), 0.5 * np.array(size), rtol=0.01)
    np.testing.assert_allclose(corners.min(axis=0), -0.5 * np.array(size), rtol=0.01)
    assert ConvexHull(corners).volume == pytest.approx(share * np.prod(size), rel=rel)
    assert target.is_temporary and not target.has_colour and make_target(name, size) is target
    again = read_solid_target(target.path)  # what was written is what it is
    assert not again.is_temporary
    np.testing.assert_allclose(ConvexHull(again.solid.vertices).volume, ConvexHull(corners).volume)


def test_a_solid_s_outline_is_the_hull_of_its_view():
    target = make_target("box", (0.3, 0.2, 0.16))
    pose = matrix_from_xyz_rpy((0.4, -0.3, 0.5), (-2.4, 0.3, 0.5))
    corners = (target.solid.vertices - pose[:3, 3]) @ pose[:3, :3]
    flat = corners[:, :2] / corners[:, 2:]
    hull = flat[ConvexHull(flat).vertices]
    found = target.outline(pose)
    assert len(found) == len(hull)
    away = np.linalg.norm(found[:, None] - hull[None], axis=2)
    assert away.min(axis=0).max() < 1e-9
    with pytest.raises(OutOfViewError, match="behind the camera"):
        target.outline(matrix_from_xyz_rpy((0.0, 0.0, 0.05), (0.0, 0.0, 0.0)))
    plane = target.outline_plane(above(0.0, 0.0, 0.9))
    # Square from above only the rim of the top, at 0.9 - 0.08 m, bounds the view.
    assert pytest.approx(1 / 0.82, rel=1e-3) == plane.C
    assert {round(z, 9) for z in target.vertices()[:, 2]} == {0.0}


def test_what_is_no_closed_solid_is_refused(tmp_path):
    with pytest.raises(ExperimentError, match="^target: m::l is not a closed surface"):
        make_solid(np.array([[(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)]], float), "m::l")
    with pytest.raises(ExperimentError, match=f"there is no file {tmp_path}/a.stl"):
        read_solid_target(tmp_path / "a.stl")
    (tmp_path / "b.stl").write_text("nothing")
    with pytest.raises(ExperimentError, match="^target.shape: .*b.stl"):
        read_solid_target(tmp_path / "b.stl")


def test_a_solid_s_description_names_its_mesh_and_makes_what_has_no_colour_grey(tmp_path):
    made = make_target("box", (0.1, 0.2, 0.3))
    text = write_target(made, tmp_path / "new" / "a", "crate").read_text()
    assert write_target(made, tmp_path / "new" / "a", "crate").read_text() == text
    robot = parse_urdf(text)
    assert robot.static and "Gazebo/Grey" in text and 'reference="crate"' in text
    (visual,) = robot.links["crate"].visuals
    assert visual.geometry.filename == str(tmp_path / "new" / "a" / "crate.obj")
    assert (tmp_path / "new" / "a" / "crate.obj").read_text() == made.path.read_text()
    (tmp_path / "own.mtl").write_text("newmtl red\nKd 0.7 0.1 0.1\n")
    (tmp_path / "own.obj").write_text("mtllib own.mtl\nusemtl red\n" + made.path.read_text())
    own = read_solid_target(tmp_path / "own.obj")
    text = write_target(own, tmp_path / "b", "mine").read_text()
    assert own.has_colour and "Grey" not in text and f"file://{tmp_path}/own.obj" in text
    assert not (tmp_path / "b" / "mine.obj").exists()


def test_what_is_made_for_one_process_lies_in_folders_of_its_own():
    one, other = make_scratch_folder(), make_scratch_folder()
    assert one != other and one.is_dir() and one.parent == other.parent
    assert one.parent.name.startswith("aras_targets_")
    spec = TargetSpec("poster", (0.2, 0.1))
    assert write_description(spec).parent.parent == one.parent


def test_a_curve_of_an_svg_becomes_24_edges(tmp_path):
    file = tmp_path / "a.svg"
    file.write_text('<svg><path d="M0 0 C 0 2 4 2 4 0 Z"/></svg>')
    t = np.arange(25)[:, None] / 24.0
    b = [(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3]
    curve = sum(w * np.array(p) for w, p in zip(b, [(0, 0), (0, 2), (4, 2), (4, 0)], strict=True))
    wanted = (curve - [2.0, 0.75]) * (1.0, -1.0)  # about the middle, y up
    np.testing.assert_allclose(read_svg(file).corners, wanted, atol=1e-9)


def test_an_svg_has_bounds(tmp_path):
    file, body = tmp_path / "a.svg", '<svg><rect width="4" height="2"/>{}</svg>'
    square = [(-2.0, 1.0), (2.0, 1.0), (2.0, -1.0), (-2.0, -1.0)]
    for filling, why in (
        (" " * (1_000_000 - len(body) + 2), ""), ("<g/>" * 9_998, ""),
        (" " * (1_000_001 - len(body) + 2), "a.svg is larger than 1000000 bytes"),
        ("<g/>" * 9_999, "has more than 10000 elements"),  # with the two that are there
    ):  # fmt: skip
        file.write_text(body.format(filling))
        if not why:
            np.testing.assert_allclose(read_svg(file).corners, square)
            continue
        with pytest.raises(ExperimentError, match=why):
            read_svg(file)
    text = page("100mm", "100mm", "-20 -10 100 120")
    file.write_text(text)
    with pytest.raises(ExperimentError, match="another aspect ratio than the viewBox of 100 by 12"):
        read_svg(file)
    file.write_text(text.replace("<svg", "<svg preserveAspectRatio='none'"))
    width, height = np.ptp(read_svg(file).corners, axis=0)
    assert height / width == pytest.approx(100 / 60 * 100 / 120)


F = np.array([(0, 0), (60, 0), (60, 20), (20, 20), (20, 40), (45, 40), (45, 60), (20, 60),
              (20, 100), (0, 100)])  # mm, y down
F_PATH = f"<path {{}} d='M {' L '.join(f'{x} {y}' for x, y in F)} Z'/>"


def page(width, height, box="", how=""):
    """An SVG of an F of 60 x 100 mm, 20 mm from the left and 10 mm from the top of its page."""
    size = " ".join(f'{side}="{length}"' for side, length in (("width", width), ("height", height))
                    if length)  # fmt: skip
    box = f'viewBox="{box}"' if box else ""
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {box}>{F_PATH.format(how)}</svg>'


MM = 96.0 / 25.4  # px


@pytest.mark.parametrize(("text", "own"), [
    (page("100mm", "120mm", "-20 -10 100 120"), True),
    (page("10cm", "12cm", "0 0 100 120", "transform='translate(20 10)'"), True),
    (page("100mm", "", "-20 -10 100 120"), True),
    (page("", "4.7244094in", "-200 -100 1000 1200", "transform='scale(10)'"), True),
    (page(f"{100 * MM}px", f"{120 * MM}", "", f"transform='scale({MM}) translate(20,10)'"), True),
    (page(f"{7200 / 25.4}pt", f"{8640 / 25.4}pt", "-20 -10 100 120"), True),
    (page("100%", "100%", "-20 -10 100 120"), False),
    (page("", "", "0 0 100 120", "transform='matrix(1 0 0 1 20 10)'"), False)])  # fmt: skip
def test_png_svg_and_outline_of_one_drawing_look_alike(tmp_path, text, own):
    (tmp_path / "f.svg").write_text(text)
    image = np.full((1200, 1000), 255, np.uint8)  # ten pixels a mm
    cv2.fillPoly(image, [10 * (F + (20, 10))], 0)
    cv2.imwrite(str(tmp_path / "f.png"), image)
    size = (0.1, 0.12)
    outline = tuple(map(tuple, (F + (20, 10) - (50, 60)) * (1e-3, -1e-3)))
    shapes = [make_target(outline), make_target(str(tmp_path / "f.png"), size),
              make_target(str(tmp_path / "f.svg"), size)]  # fmt: skip
    shapes += [make_target(str(tmp_path / "f.svg"))] if own else []
    first, *others = (
        render_target(shape, CAMERA, above(0.01, -0.02, 0.4)).astype(int) for shape in shapes)
    assert (first < 128).sum() > 1500
    for other in others:
        assert np.abs(other - first).max() < 128 and np.abs(other - first).mean() < 0.3


def test_what_is_transparent_in_a_png_is_white(tmp_path):
    ink = np.zeros((100, 100), np.uint8)
    ink[20:40, 20:80] = 255
    ink[45:55, 20:80] = 128  # half
    expected = 255.0 - ink
    for depth, hidden in ((np.uint8, 0), (np.uint8, 90), (np.uint16, 0)):
        full = np.iinfo(depth).max
        image = np.full((100, 100, 4), hidden, depth)
        image[ink > 0, :3] = 0
        image[..., 3] = np.round(ink / 255.0 * full)
        path = str(tmp_path / f"ink_{full}_{hidden}.png")
        cv2.imwrite(path, image)
        target = make_target(path, (0.1, 0.1))
        assert np.abs(target.pixels - expected).max() <= 1.0


def test_a_mesh_gets_a_scale_or_a_size(tmp_path):
    """The description draws it so, the tracker's model is as large, and both are not given."""
    (mesh,) = make_meshes(Geometry("box", size=(60.0, 40.0, 20.0)))  # mm
    path = tmp_path / "part.obj"
    corners = mesh.positions[mesh.triangles].reshape(-1, 3)
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"f {k} {k + 1} {k + 2}" for k in range(1, len(corners), 3)]
    path.write_text("\n".join(lines))
    with pytest.raises(ExperimentError, match=r"is 60 m long.* by 0.001, .* \(target.scale\)"):
        make_target(str(path))
    for given, box in (({"scale": 0.001}, (0.06, 0.04, 0.02)),
                       ({"size": (0.1, 0.2, 0.3)}, (0.1, 0.2, 0.3))):  # fmt: skip
        target = make_target(str(path), **given)
        np.testing.assert_allclose(np.ptp(target.solid.vertices, axis=0), box)
        np.testing.assert_allclose(np.ptp(read_solid(str(target.path)).vertices, axis=0), box)
        urdf = parse_urdf(write_description(TargetSpec(str(path), **given)).read_text())
        drawn = np.concatenate([part.positions for visual in urdf.links["target"].visuals
                                for part in make_meshes(visual.geometry)])  # fmt: skip
        np.testing.assert_allclose(np.ptp(drawn, axis=0), box, rtol=1e-6)
    with pytest.raises(TrackingModelError, match=r"by 0.001, .* \(model_scale\)"):  # of the node
        read_solid(str(path))
    assert read_solid(str(path), 0.001).size == pytest.approx(0.06)
    for shape, given, words in (
        (str(path), {"scale": 0.1, "size": (1, 1, 1)}, "leave one out"),
        (str(path), {"size": (0.1, 0.1)}, "three lengths"),
        ("square", {"scale": 0.5}, "target.scale applies only to meshes"),
        ("squar", {"size": SIZE}, "target.shape is 'squar': did you mean 'square'"),
    ):  # fmt: skip
        with pytest.raises(ExperimentError, match=words):
            make_target(shape, **given)
    outline = ((0.0, 0.0), (0.1, 0.0), (0.0, 0.2))  # has its own size
    assert make_target(outline, (9.0,)) == PolygonTarget(outline)
