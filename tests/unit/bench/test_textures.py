"""Textured targets, and points that trackers find on them, compared with the exact points."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from scipy.stats import kstest

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.experiment.loop_settings import make_loop_settings
from aras_visual_servo_bench.plants.imaging import ImagingSettings, capture
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble, check
from aras_visual_servo_bench.targets.geometry import PlacedTarget, project
from aras_visual_servo_bench.targets.rendering import render_target
from aras_visual_servo_bench.targets.shapes import SHAPES
from aras_visual_servo_bench.targets.svg_outlines import read_svg
from aras_visual_servo_bench.targets.target_factory import find_tracker, make_target
from aras_visual_servo_bench.targets.textures import TexturedTarget
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.trackers.dots import DotTracker
from aras_visual_servo_camera.trackers.lines import LineTracker
from aras_visual_servo_camera.trackers.marker import MarkerTracker
from aras_visual_servo_controller.features import FEATURES
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.schemes import FeatureScheme

PINHOLE_K, SIZE = (300.0, 0, 159.5, 0, 300.0, 119.5, 0, 0, 1), (0.2, 0.2)
CAMERA = CameraModel(320, 240, PINHOLE_K)
LENS = CameraModel(320, 240, PINHOLE_K, (-0.2, 0.05, 0, 0))
# the target's z towards the camera
FACING = matrix_from_xyz_rpy((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0))
FISHEYE = CameraModel(320, 240, (200.0, 0, 159.5, 0, 200.0, 119.5, 0, 0, 1), (0.0,) * 4,
                      "equidistant")  # fmt: skip
VIEW = matrix_from_xyz_rpy((0.02, -0.015, -0.5), (0.08, -0.06, 0.4))
NEAR = matrix_from_xyz_rpy((0.0, 0.01, -0.3), (0.0, 0.05, 0.1))
ASKEW = matrix_from_xyz_rpy((0.2, -0.1, -0.45), (-0.2, -0.4, 0.0)) @ matrix_from_xyz_rpy(
    (0, 0, 0), (0, 0, 0.7))
CLOSE = matrix_from_xyz_rpy((0.0, 0.0, -0.15), (0.0, 0.0, 0.0))
AWAY = matrix_from_xyz_rpy((0.0, 0.0, -8.0), (0.0, 0.0, 0.0))


def picture(target, camera=CAMERA, view=VIEW):
    sight = ImagingSettings(camera, target, has_images=True)
    return capture(sight, view, 0, np.random.default_rng(0)).image


def seen(name, camera=CAMERA, view=VIEW, size=SIZE):
    """Return the image of a target that faces the camera, and its points in it, normalised."""
    target = PlacedTarget(make_target(name, size), FACING)
    return picture(target, camera, view), target.shape.points(target.target_T_camera(view))


def averaged(target, camera, view, fine=5):
    """Return the image (rows, columns) of a pinhole camera; a pixel is the mean of fine x fine
    samples."""
    fx, _, cx, _, fy, cy, *_ = camera.K
    whole = CameraModel(
        camera.width * fine, camera.height * fine,
        (fine * fx, 0, fine * (cx + 0.5) - 0.5, 0, fine * fy, fine * (cy + 0.5) - 0.5, 0, 0, 1))
    parts = picture(target, whole, view).reshape(camera.height, fine, camera.width, fine)
    return np.round(parts.mean(axis=(1, 3))).astype(np.uint8)


@pytest.mark.parametrize(
    ("name", "tracker", "far", "size", "view"),
    [("marker", MarkerTracker(), 0.011, (0.08, 0.08), VIEW),
     ("marker", MarkerTracker(), 0.011, (0.25, 0.2), ASKEW),
     ("marker", MarkerTracker(), 0.011, (0.1, 0.12), NEAR),
     ("four_dots", DotTracker(), 0.02, (0.2, 0.15), VIEW),
     ("four_dots", DotTracker(), 0.02, (0.08, 0.1), NEAR)],
    ids=["small marker", "wide marker askew", "high marker", "wide dots", "small high dots"])
def test_points_are_found_to_a_hundredth_of_a_pixel(name, tracker, far, size, view):
    """No disc is seen askew: its middle is not that of its ellipse."""
    target = PlacedTarget(make_target(name, size), FACING)
    image = averaged(target, CAMERA, view)
    points = np.column_stack(CAMERA.project(*target.shape.points(target.target_T_camera(view)).T))
    for grain, exact in ((0.0, 1.0), (5.0, 4.0)):
        noise = np.random.default_rng(0).normal(0.0, grain, image.shape)
        found = tracker.find(np.clip(np.round(image + noise), 0, 255).astype(np.uint8))
        nearest = np.linalg.norm(found[:, None] - points[None], axis=2).min(axis=1)
        assert np.sqrt((nearest**2).mean()) < far * exact


LENSES = pytest.mark.parametrize("camera", [CAMERA, LENS, FISHEYE],
                                 ids=["pinhole", "lens", "fisheye"])  # fmt: skip


@pytest.mark.parametrize("view", [VIEW, ASKEW], ids=["view", "askew"])
@LENSES
def test_a_disc_is_the_ellipse_that_it_looks_like(camera, view):
    target = PlacedTarget(make_target("circle", (0.12, 0.12)), FACING)
    feature = FEATURES.create("ellipse")
    exactly = target.shape.outline(target.target_T_camera(view))
    plane = target.shape.plane(target.target_T_camera(view))
    observer = FeatureObserver(None, feature.needs)
    exact = observer.observe_exact_features(0.0, camera, contour=exactly, plane=plane)
    goal = Goal.teach(FeatureScheme(feature), exact, depth=0.5)
    observed = observer.observe_image(0.1, picture(target, camera, view), camera, plane=plane)
    found = feature.measure(observed, goal)
    assert np.abs(found.error[:2]).max() * camera.K[0] < 0.02  # px
    assert found.s[2:] == pytest.approx(found.desired[2:], rel=2e-3, abs=2e-6)


@LENSES
def test_a_marker_is_found_corner_by_corner(camera):
    """From its own first corner on, through any lens; a cell is 3 px wide."""
    image, exact = seen("marker", camera, size=(0.06, 0.06))
    found = MarkerTracker().find_normalised(image, camera)
    assert np.abs(found - exact).max() * camera.K[0] < 0.1  # px
    both = np.full((240, 480), 255, np.uint8)  # of two, the larger one is followed
    both[:, :320] = image
    both[:120, 320:] = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    assert np.abs(MarkerTracker().find(both) - MarkerTracker().find(image)).max() < 0.5


@pytest.mark.parametrize("view", [NEAR, ASKEW], ids=["near", "askew"])
@LENSES
def test_outermost_lines_cross_where_they_are_said(camera, view):
    grey, exact = seen("line_grid", camera, view)
    random = np.random.default_rng(3)
    slope = np.linspace(0.75, 1.0, grey.shape[1])
    noisy = np.clip(grey * slope + random.normal(0.0, 5.0, grey.shape), 0, 255).astype(np.uint8)
    for image, far in ((grey, 0.12), (noisy, 0.4))[:2 if view is NEAR else 1]:
        found = LineTracker().find_normalised(image, camera)
        away = np.linalg.norm(found[:, None] - exact[None], axis=2) * camera.K[0]
        assert away.min(axis=0).max() < far, away.min(axis=0)  # px
        assert sorted(away.argmin(axis=0)) == [0, 1, 2, 3]
        offset = found - found.mean(axis=0)
        assert (np.diff(np.arctan2(offset[:, 1], offset[:, 0])) > 0.0).all()


@pytest.mark.parametrize(("tracker", "shape", "view", "told"), [
    (DotTracker(), "square", VIEW, "only 0 of 4 dots are detected: move the camera"),
    (MarkerTracker(), "four_dots", VIEW, "no marker of DICT_4X4_50, DICT_APRIL"),
    (LineTracker(), "square", VIEW, "is not bounded by lines: use tracker 'outline'"),
    (LineTracker(), "circle", VIEW, "not bounded by lines|must be 4"),
    (LineTracker(), "line_grid", CLOSE, "touches the border of the image"),
    (LineTracker(), "line_grid", AWAY, "no dark drawing is in view")])  # fmt: skip
def test_what_is_not_there_is_said(tracker, shape, view, told):
    with pytest.raises(VisionError, match=told):
        tracker.find(seen(shape, view=view)[0])


def in_a_unit(folder, text):
    """Corners on a page whose longer side is 1, y down as in the file."""
    (folder / "a.svg").write_text(text)
    drawing = read_svg(folder / "a.svg")
    return drawing.corners * (1.0, -1.0) / max(drawing.page)


HALF = [(-0.5, -0.25), (0.5, -0.25), (0.5, 0.25)]


@pytest.mark.parametrize(("body", "corners"), [
    ('<polygon points="0,0 4,0 4,2"/>', HALF),
    ('<rect x="1" y="1" width="2" height="4"/>',
     [(-0.25, -0.5), (0.25, -0.5), (0.25, 0.5), (-0.25, 0.5)]),
    ('<path d="M0 0 h4 v2 l-4 0 z"/>', [*HALF, (-0.5, 0.25)]),
    ('<path d="M 0,0 L 4,0 4,2 H 0 Z"/>', [*HALF, (-0.5, 0.25)]),
    ('<g transform="rotate(90)"><polygon points="0,0 4,0 4,2" transform="scale(1 2)"/></g>',
     [(0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]),
    ('<path d="M0 0 m1 1 4 0v2z"/>', HALF), ('<line x2="9"/><path d="M0 0H4V2ZM7 7"/>', HALF)])
def test_an_outline_of_an_svg(tmp_path, body, corners):
    text = f'<svg xmlns="http://www.w3.org/2000/svg"><g>{body}</g></svg>'
    assert in_a_unit(tmp_path, text) == pytest.approx(np.array(corners))


@pytest.mark.parametrize("body", [
    '<circle cx="3" cy="1" r="2" transform="skewX(30)"/>',
    '<path d="M1 1 A2 2 0 0 1 5 1 A2 2 0 0 1 1 1 Z" transform="skewX(30)"/>',
    '<path d="M1 1 A2 2 0 0 0 5 1 A2 2 0 0 0 1 1 Z" transform="skewX(30)"/>'])  # fmt: skip
def test_arcs_of_an_svg_lie_where_their_transform_puts_them(tmp_path, body):
    points = in_a_unit(tmp_path, f"<svg>{body}</svg>")
    assert len(points) == 180
    # The circle about 0 that the shear by tan 30 degrees was done to.
    x, y = points.T
    radius = np.hypot(x - np.tan(np.pi / 6) * y, y)
    assert radius == pytest.approx(np.full(180, radius[0]), rel=1e-9)
    assert np.ptp(x) == pytest.approx(1.0) and np.ptp(y) == pytest.approx(np.sqrt(0.75), rel=1e-3)


LAUGHS = "<!DOCTYPE svg [<!ENTITY a 'ha'><!ENTITY b '&a;&a;&a;'><!ENTITY c '&b;&b;&b;'>]>"


def nested_uses(levels):
    groups = "".join(f"<g id='g{n}'>" + 10 * f"<use href='#g{n - 1}'/>" + "</g>"
                     for n in range(1, levels + 1))
    return ("<svg xmlns:xlink='http://www.w3.org/1999/xlink'><defs>"
            f"<rect id='g0' width='1' height='2'/>{groups}</defs><use href='#g{levels}'/></svg>")


def test_an_outline_may_be_a_copy_in_a_file_with_a_document_type(tmp_path):
    text = ("<!DOCTYPE svg PUBLIC '-//W3C//DTD SVG 1.1//EN' 'http://no.such/svg11.dtd'>"
            + nested_uses(0).replace("<use href", "<use xlink:href"))  # fmt: skip
    assert np.ptp(in_a_unit(tmp_path, text), axis=0) == pytest.approx([0.5, 1.0])


@pytest.mark.parametrize(("name", "content", "told"), [
    ("cut.png", "\x89PNG\r\n\x1a\n" + 50 * "0", "not a readable image"),
    ("a.svg", "<svg><path d='M0 0 L 4 0 4 4 X 2 2'/></svg>", "command 'X' is unknown"),
    ("a.svg", "<svg><path d='M0 0 L 4 0 4 4 2'/></svg>", "outline: numbers are missing"),
    ("a.svg", "<svg><path/></svg>", "invalid outline"),
    ("a.svg", "<svg><rect width='1e400' height='2'/></svg>", "has no area"),
    ("a.svg", "<svg><path d='M0 0h9v9zM5 1h2v2z'/></svg>", "has 2 outlines, must have one"),
    ("a.svg", "<html/>", "is no SVG: its root"),
    ("a.svg", "<svg><text>hm</text></svg>", "has no outline"),
    ("a.svg", "no xml", "is no SVG"),
    ("a.svg", LAUGHS + "<svg><path d='M0 0h9v9z' id='&c;'/></svg>", "entity declarations are"),
    ("a.svg", nested_uses(5), "more than 10000 elements, including copies by <use>"),
    ("a.svg", "<svg><g id='a'><use href='#a'/></g></svg>", "more than 10000 elements")])
def test_a_file_that_cannot_be_used_is_one_line(tmp_path, capfd, name, content, told):
    (tmp_path / name).write_text(content, encoding="latin-1", newline="")
    with pytest.raises(ExperimentError, match=told) as caught:
        make_target(str(tmp_path / name), SIZE)
    assert "\n" not in str(caught.value) and capfd.readouterr().err == ""
    with pytest.raises(ExperimentError, match="there is no file"):
        make_target(str(tmp_path / f"missing{name}"), SIZE)


RUN = {
    "plant": "ideal", "features": "images", "gain": 4.0, "duration": 4.0,
    "time_after_convergence": 0.0,
    "camera": {"width": 320, "height": 240, "horizontal_fov": 0.98, "update_rate": 12.5},
    "goal": {"pose": [0.0, 0.0, -0.35, 0.0, 0.0, 0.0]},
    "start": {"pose": [0.02, -0.015, -0.4, 0.05, -0.04, 0.2]},
    "controller_parameters": {"hold": 0.2}, "reached": [1e-3, 0.01]}  # fmt: skip
TURNED = [0.0, 0.0, 0.0, 3.141592653589793, 0.0, 0.0]


@pytest.mark.parametrize(("shape", "scheme", "size"), [
    ("four_dots", "numbered_points", (0.2, 0.2)), ("marker", "pose", (0.2, 0.2)),
    ("line_grid", "lines", (0.2, 0.2)), ("l_shape", "moments_six", (0.2, 0.2)),
    ("poster", "matches", (0.8, 0.6)), ("poster", "matches_pose", (0.8, 0.6)),
    ("marker", "points", (0.2, 0.2))])  # fmt: skip
def test_it_is_servoed_on_by_pictures(shape, scheme, size):
    target = {"shape": shape, "size": size, "pose": TURNED}
    result = run(Experiment.from_mapping({**RUN, "target": target, "scheme": scheme}))
    assert result.verdict.is_reached, (result.outcome, result.reason, result.verdict)


def test_a_disc_has_no_corners_and_says_so():
    """What is recommended converges, also before a circle seen square on, where ellipse lacks rank.
    """
    flat = {
        "plant": "chain", "features": "exact", "goal": {"pose": [0.0, 0.0, 0.86, np.pi, 0.0, 0.0]},
        "target": {"shape": "circle", "size": [0.08, 0.08], "pose": [0.01, 0.01, 0.591, 0, 0, 0]},
        "start": {"height": [0.2, 0.32], "side": 0.04, "turn": 0.5}, "seed": 3}  # fmt: skip
    with pytest.raises(ExperimentError, match="has no corners") as refused:
        run(Experiment.from_mapping({**flat, "scheme": "numbered_points"}))
    recommended = str(refused.value).rpartition(" ")[2]
    result = run(Experiment.from_mapping({**flat, "scheme": recommended}))
    assert result.outcome == "converged" and result.verdict.is_reached


def test_a_run_that_ends_early_says_what_it_waited_for():
    there = {"shape": "poster", "size": [0.8, 0.6], "pose": TURNED}
    away = {"pose": [3.0, 0.0, -0.4, 0.0, 0.0, 0.0]}
    spec = {**RUN, "plant": "free", "target": there, "scheme": "matches", "start": away}
    result = run(Experiment.from_mapping({**spec, "duration": 0.2}))
    assert result.outcome == "timed_out"
    assert result.reason == (
        "not converged after 0.2 s: 0 keypoints match the goal image, but 8 consistent matches "
        "are needed: bring the target into view, and use a textured target")


@pytest.mark.parametrize("side", [8001, 20_000])
def test_a_picture_too_large_is_refused_by_its_header(tmp_path, side):
    """Its first bytes are all that there is: who decoded it would say that it cannot be read."""
    header = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    file = tmp_path / "large.png"
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header
                     + struct.pack(">I", zlib.crc32(header)) + struct.pack(">I", 9) + b"IDAT")
    experiment = Experiment.from_mapping({**RUN, "target": {"shape": str(file)}})
    with pytest.raises(ExperimentError, match="has more than 64000000 pixels: make it smaller"):
        check(experiment)


def test_a_target_has_its_points_in_its_size_and_brings_their_tracker():
    for name, share in (("four_dots", 0.25), ("line_grid", 0.4)):
        known = [(-0.3 * share, 0.2 * share), (0.3 * share, 0.2 * share),
                 (0.3 * share, -0.2 * share), (-0.3 * share, -0.2 * share)]
        np.testing.assert_allclose(make_target(name, (0.3, 0.2)).known_points, known, atol=1e-12)
    for shape, kind in SHAPES.items():
        if not kind.is_solid:
            spec = {**RUN, "target": {"shape": shape, "pose": TURNED}}
            assert make_loop_settings(Experiment.from_mapping(spec)).tracker == kind.tracker
            own = {**spec, "controller_parameters": {"tracker": "outline"}}
            assert make_loop_settings(Experiment.from_mapping(own)).tracker == "outline"
    assert find_tracker("/some/where/marker.urdf") == "marker"
    assert find_tracker(((0.0, 0.0), (0.1, 0.0), (0.0, 0.1))) == "outline"


def test_a_picture_is_taught_by_the_camera_as_it_is_believed():
    """The controller's own camera_info told it so then; else it refused the goal as another's."""
    there = {"shape": "poster", "size": [0.8, 0.6], "pose": TURNED}
    spec = {**RUN, "target": there, "scheme": "luminance", "calibration_offset": {"focal": 0.9}}
    parts = assemble(Experiment.from_mapping(spec))
    assert parts.goal.camera == parts.calibrated_camera


def test_a_disturbed_picture_is_as_the_protocols_have_it():
    """Of columns of two grey levels, which their means tell; a patch has one level."""
    plain = np.full((120, 180), 75, np.uint8)
    plain[:, ::2] = 125
    target = TexturedTarget(plain, (0.3, 0.2), np.ones((4, 2)))
    everywhere, patches, grains = [], [], []
    for seed in range(200):
        made = target.perturb(seed)
        assert made.size == target.size and made.known_points is target.known_points
        level = np.bincount(made.pixels.ravel()).argmax()
        block = cv2.morphologyEx((made.pixels == level).view(np.uint8), cv2.MORPH_OPEN,
                                 np.ones((7, 7), np.uint8))  # fmt: skip
        left, top, wide, high = cv2.boundingRect(block)
        if wide:
            assert block.sum() == wide * high
            patches.append([high / 120 * wide / 180, np.log(high / 120 / (wide / 180)),
                            top / (120 - high), left / (180 - wide), level])  # fmt: skip
        bright, dark = (made.pixels[:, i::2][block[:, i::2] == 0].astype(float) for i in (0, 1))
        brightness = (bright.mean() + dark.mean()) / 200.0
        everywhere.append([brightness, (bright.mean() - dark.mean()) / 50.0 / brightness])
        grains.append(bright.std())
    np.testing.assert_array_equal(target.perturb(199).pixels, made.pixels)
    assert np.median(grains) == pytest.approx(12.75, rel=0.01)
    assert len(patches) == pytest.approx(100, abs=21)
    bounds = [(0.4, 1.6), (0.6, 1.4), (0.02, 0.33), (-1.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0, 255)]
    columns = [*np.transpose(everywhere), *np.transpose(patches)]
    for values, (low, high) in zip(columns, bounds, strict=True):
        slack = 0.05 * (high - low)
        assert low - slack < values.min() < low + 2 * slack
        assert high - 2 * slack < values.max() < high + slack
        assert kstest(values, "uniform", (low, high - low)).pvalue > 0.01


POSTER_K = (301.0, 0.0, 163.2, 0.0, 295.0, 114.7, 0.0, 0.0, 1.0)
CAMERAS = {
    "pinhole": CameraModel(320, 240, POSTER_K),
    "plumb_bob": CameraModel(320, 240, POSTER_K, (-0.2, 0.05, 0.001, -0.002, 0.0)),
    "equidistant": CameraModel(320, 240, POSTER_K, (0.02, -0.01, 0.003, 0.0), "equidistant")}
# A black rectangle on white, 0.1 x 0.075 m, off the middle of a poster of 0.4 x 0.3 m.
POSTER_SIZE = np.array([0.4, 0.3])
LOW, HIGH = np.array([-0.05, -0.0375]), np.array([0.05, 0.0375])
OFF = np.array([0.025, -0.01875])


def rectangle() -> TexturedTarget:
    pixels = np.full((768, 1024), 255, np.uint8)
    per = pixels.shape[1] / POSTER_SIZE[0]
    x0, y0 = np.rint((LOW + OFF + POSTER_SIZE / 2) * per).astype(int)
    x1, y1 = np.rint((HIGH + OFF + POSTER_SIZE / 2) * per).astype(int)
    pixels[768 - y1:768 - y0, x0:x1] = 0
    return TexturedTarget(pixels, tuple(POSTER_SIZE))


@pytest.mark.parametrize("name", CAMERAS)
def test_the_centroid_of_what_a_poster_shows_is_where_it_is_projected(name):
    camera, target = CAMERAS[name], rectangle()
    random, errors = np.random.default_rng(3), []
    side = np.linspace(0.0, 1.0, 33)[:-1]
    (x0, y0), (x1, y1) = LOW + OFF, HIGH + OFF
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    rim = np.concatenate([a + side[:, None] * (b - a)
                          for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    rim = np.column_stack([rim, np.zeros(len(rim))])
    for _ in range(15):
        turn = random.uniform(-0.4, 0.4, 2)
        target_T_camera = matrix_from_xyz_rpy((0, 0, 0), (np.pi, 0, 0)) @ matrix_from_xyz_rpy(
            (0, 0, 0), (*turn, random.uniform(-np.pi, np.pi))) @ matrix_from_xyz_rpy(
            (*random.uniform(-0.03, 0.03, 2), -random.uniform(0.35, 0.6)), (0, 0, 0))
        outline = np.column_stack(camera.project(*project(rim, target_T_camera).T))
        assert (outline > 3).all() and (outline < (316, 236)).all()
        exact, dark = Moments.from_polygon(outline, 2), 255.0 - render_target(
            target, camera, target_T_camera)  # fmt: skip
        seen_at = [(index * dark).sum() / dark.sum() for index in np.indices(dark.shape)[::-1]]
        errors.append(np.subtract(seen_at, (exact.xg, exact.yg)))
    assert np.sqrt((np.array(errors) ** 2).sum(axis=1).mean()) < 0.004


def test_an_occluder_is_white_and_lies_on_the_picture():
    """What it covers of the rectangle is the half with y below its middle."""
    camera, target = CAMERAS["pinhole"], rectangle()
    above = matrix_from_xyz_rpy((0, 0, 0), (np.pi, 0, 0)) @ matrix_from_xyz_rpy(
        (0.01, 0.0, -0.45), (0, 0, 0.3))
    cover = ((-0.1, -0.15), (0.15, float(OFF[1])))
    whole, half = render_target(target, camera, above), render_target(target, camera, above, cover)
    assert (half >= whole).all()
    assert (255.0 - half).sum() == pytest.approx(0.5 * (255.0 - whole).sum(), rel=0.02)
    there = inverse(above) @ [OFF[0], OFF[1] - 0.01, 0.0, 1.0]
    u, v = np.rint(np.array(camera.project(*(there[:2, None] / there[2]))).ravel()).astype(int)
    assert whole[v, u] == 0 and half[v, u] == 255
    behind = matrix_from_xyz_rpy((0, 0, -0.5), (0, 0, 0))
    assert (render_target(target, camera, behind) == 255).all()
