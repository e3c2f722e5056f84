"""Lens models: inverse, areas, and moments through a lens."""

from dataclasses import replace

import numpy as np
import pytest
from feature_cases import L_SHAPE, View, rotation

from aras_visual_servo_base.lenses import brown
from aras_visual_servo_camera.camera_model import CameraModel, PixelTables, subdivide
from aras_visual_servo_camera.detection_pipeline import DetectionPipeline, DetectionSettings
from aras_visual_servo_camera.errors import InvalidIntrinsicsError
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.moments import Moments, exponents

messages = pytest.importorskip("sensor_msgs.msg")

K = (195.0507, 0.0, 162.4058, 0.0, 195.0992, 127.1973, 0.0, 0.0, 1.0)
TANGENTIAL = CameraModel(320, 240, K, (-0.28, 0.09, 0.002, -0.0015, -0.01))
RATIONAL = CameraModel(
    320, 240, K, (0.4, 0.1, 1e-3, -5e-4, 0.01, 0.7, 0.2, 0.02), "rational_polynomial"
)
FISHEYE = CameraModel(
    320, 240, (102.0, 0, 159.5, 0, 102.0, 119.5, 0, 0, 1), (0.02, -0.01, 0.003, 0.0), "equidistant"
)
STRONG_FISHEYE = CameraModel(
    320, 240, (110.0, 0, 162.5, 0, 120.0, 117.5, 0, 0, 1), (0.03, -0.02, 0.02, 0.05), "fisheye"
)
FOLDING = CameraModel(320, 240, K, (-0.33, 0.0, 1e-3, -2e-3, 0.0))


@pytest.mark.parametrize("camera", [FOLDING, FISHEYE, STRONG_FISHEYE],
                         ids=["folding", "fisheye", "strong fisheye"])
def test_a_place_has_a_ray_only_if_the_ray_leads_back(camera: CameraModel) -> None:
    """Far beyond the image, where a polynomial folds over and a fisheye looks behind itself."""
    u, v = (a.ravel() for a in np.meshgrid(np.arange(-600, 921, 40.0), np.arange(-600, 841, 40.0)))
    x, y, valid = camera.normalise(u, v)
    assert valid.any() and not valid.all()
    back = camera.project(x[valid], y[valid])
    np.testing.assert_allclose(back[0], u[valid], atol=1e-6)
    np.testing.assert_allclose(back[1], v[valid], atol=1e-6)
    assert (x[~valid] == 0.0).all() and (y[~valid] == 0.0).all()
    # one sign all over: never on the far side of the axis, never further than 88 degrees
    assert ((x * (u - camera.K[2]))[valid] >= -1e-9).all()
    assert (np.hypot(x, y) < np.tan(np.deg2rad(88.0))).all()


def test_a_fisheye_is_good_up_to_its_fold() -> None:
    """theta (1 - 0.02 theta^8) grows up to theta = (1 / 0.18)^(1/8) = 1.239."""
    K = (100.0, 0, 0, 0, 100.0, 0, 0, 0, 1)
    folding = CameraModel(320, 240, K, (0.0, 0.0, 0.0, -0.02), "equidistant")
    theta = np.array([0.3, 1.0, 1.2, 1.232, 1.238])
    x, y, valid = folding.normalise(*folding.project(np.tan(theta), 0.0 * theta))
    assert valid.all()
    np.testing.assert_allclose(np.arctan(x), theta, atol=1e-7)
    beyond = 100.0 * 1.2392 * (1 - 0.02 * 1.2392**8) + np.array([0.1, 5.0, 50.0])
    assert not folding.normalise(beyond, 0.0 * beyond)[2].any()


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_a_pixel_counts_where_its_centre_and_corners_have_rays(model: str) -> None:
    D = (-0.33, 0.0, 0.0, 0.0) if model == "plumb_bob" else (-0.01, 0.0, 0.0, 0.0)
    focal = 30.0 if model == "plumb_bob" else 18.0
    camera = CameraModel(60, 40, (focal, 0, 30.5, 0, focal - 1, 18.0, 0, 0, 1), D, model)
    table = camera.tables
    row, column = (a.ravel() for a in np.mgrid[:40, :60])
    u = np.add.outer([0.0, -0.5, 0.5, 0.5, -0.5], column)
    v = np.add.outer([0.0, -0.5, -0.5, 0.5, 0.5], row)
    x, y, valid = (a.reshape(u.shape) for a in camera.normalise(u.ravel(), v.ravel()))
    corners = np.roll(x[1:], -1, axis=0) * y[1:] - x[1:] * np.roll(y[1:], -1, axis=0)
    area = np.where(valid.all(axis=0), np.maximum(-0.5 * corners.sum(axis=0), 0.0), 0.0)
    np.testing.assert_allclose(table.area.ravel(), area, rtol=1e-9, atol=1e-15)
    for own, wanted in ((table.x, x[0]), (table.y, y[0])):
        np.testing.assert_allclose(own.ravel(), np.where(area > 0.0, wanted, 0.0), rtol=1e-6)
    assert 0 < (area == 0.0).sum() < 2400
    assert (camera.blind_mask == (table.area == 0.0)).all()


@pytest.mark.parametrize("centre", [(1.6, 0.1), (-0.1, -1.2)], ids=["right", "above"])
def test_a_small_target_far_from_the_axis(centre: tuple[float, float]) -> None:
    """The blur that is taken out is that of the pixels there, several times a central one's."""
    outline = 0.09 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]]) + centre
    exact = Moments.from_polygon(outline)
    pipeline = DetectionPipeline(DetectionSettings())
    pipeline.set_camera(FISHEYE)
    moments = pipeline.measure(Image(through(FISHEYE, outline, 32), "mono8")).moments
    for i, j in ((2, 0), (0, 2)):
        spread = exact.mu(i, j) / exact.m00
        assert moments.mu(i, j) / moments.m00 == pytest.approx(spread, rel=0.015)


def test_tables_of_equal_cameras_and_points_of_edges():
    again, other = replace(TANGENTIAL), replace(TANGENTIAL, width=319)
    assert again is not TANGENTIAL and again.tables is TANGENTIAL.tables
    assert other.tables.x.shape == (240, 319)
    with pytest.raises(ValueError, match="read-only"):
        again.tables.area[0, 0] = 1.0
    one = CameraModel(1, 1, (0.5, 0, 0, 0, 0.5, 0, 0, 0, 1), (0.0,) * 4, "equidistant")
    assert one.tables.area.shape == (1, 1)
    corners = np.array([[0.0, 0.0], [1.0, 0.5], [0.2, 2.0]])
    along = np.arange(12) / 4.0
    expected = [np.interp(along, range(4), [*column, column[0]]) for column in corners.T]
    np.testing.assert_allclose(subdivide(corners, 4), np.transpose(expected), atol=1e-12)


def test_jacobian_of_the_polynomial_by_finite_differences() -> None:
    """With every coefficient at work; in Newton's method a wrong one would only cost steps."""
    D = (0.4, 0.3, 0.05, -0.07, 0.2, 0.7, 0.25, 0.15, 0.03, 0.02, -0.04, 0.01, 0.1, -0.2)
    x, y = np.random.default_rng(1).uniform(-0.8, 0.8, (2, 30))
    _, _, jxx, jxy, jyx, jyy = brown(x, y, D)

    def slope(dx: float, dy: float) -> tuple[np.ndarray, ...]:
        after = brown(x + dx, y + dy, D)[:2]
        before = brown(x - dx, y - dy, D)[:2]
        return tuple((a - b) / (2 * (dx + dy)) for a, b in zip(after, before, strict=True))

    by_x, by_y = slope(1e-5, 0.0), slope(0.0, 1e-5)
    np.testing.assert_allclose(by_x, [jxx, jyx], atol=1e-9)
    np.testing.assert_allclose(by_y, [jxy, jyy], atol=1e-9)


@pytest.mark.parametrize("place", [(2, 3), (0, 0), (6, 4)], ids=["inside", "first", "last"])
def test_variance_of_a_pixel_s_square(place: tuple[int, int]) -> None:
    """A pixel that is mapped to a parallelogram: J J' / 12, at the image's edge as within."""
    J = np.array([[0.02, 0.003], [-0.005, 0.03]])
    u, v = np.meshgrid(np.arange(7.0), np.arange(5.0))
    x, y = J[0, 0] * u + J[0, 1] * v, J[1, 0] * u + J[1, 1] * v
    table = PixelTables(x, y, np.full(x.shape, np.linalg.det(J)))
    variance = J @ J.T / 12.0
    expected = (variance[0, 0], variance[0, 1], variance[1, 1])
    assert table.compute_pixel_variance(*place) == pytest.approx(expected, rel=1e-12)


def through(camera: CameraModel, outline: np.ndarray, finer: int = 8) -> np.ndarray:
    """Return a grey image of a polygon through the lens; each pixel is averaged over its area."""
    corners = np.stack(camera.project(*outline.T), axis=1)
    u0, v0 = np.floor(corners.min(axis=0)).astype(int) - 6  # edges bend: leave some room
    u1, v1 = np.ceil(corners.max(axis=0)).astype(int) + 7
    grid = (np.arange(finer) + 0.5) / finer - 0.5
    u = (np.arange(u0, u1)[:, None] + grid).ravel()
    v = (np.arange(v0, v1)[:, None] + grid).ravel()
    x, y, valid = camera.normalise(*(a.ravel() for a in np.meshgrid(u, v)))
    inside = np.zeros(x.shape, dtype=bool)
    for (px, py), (qx, qy) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        crosses = (py > y) != (qy > y)
        inside ^= crosses & (x < (qx - px) * (y - py) / (qy - py if qy != py else 1.0) + px)
    part = (inside & valid).reshape(v1 - v0, finer, u1 - u0, finer).mean(axis=(1, 3))
    grey = np.full((camera.height, camera.width), 255, dtype=np.uint8)
    grey[v0:v1, u0:u1] = np.round(255 * (1 - part))
    return grey


@pytest.mark.parametrize("camera", [TANGENTIAL, RATIONAL, FISHEYE],
                         ids=["tangential", "rational", "fisheye"])
def test_moments_through_a_lens_are_those_without(camera: CameraModel) -> None:
    view = View(L_SHAPE, rotation([0.1, -0.2, 0.5]), np.array([0.09, -0.06, 0.42]))
    exact = Moments.from_polygon(view.image)
    pipeline = DetectionPipeline(DetectionSettings())
    pipeline.set_camera(camera)
    measured = pipeline.measure(Image(through(camera, view.image), "mono8"))
    assert measured.valid, measured.reason
    moments = measured.moments
    rg = ((exact.mu(2, 0) + exact.mu(0, 2)) / exact.m00) ** 0.5
    assert moments.m00 == pytest.approx(exact.m00, rel=1e-3)
    assert np.hypot(moments.xg - exact.xg, moments.yg - exact.yg) < 1e-3 * rg
    for i, j in exponents(6):
        assert abs(moments.mu(i, j) - exact.mu(i, j)) < 4e-3 * exact.m00 * rg ** (i + j)


def info(**changes):
    good = {"width": 320, "height": 240, "K": K, "D": (0.0,) * 5, "distortion_model": "plumb_bob"}
    return messages.CameraInfo(**{**good, **changes})


@pytest.mark.parametrize(
    ("model", "counts"),
    [*((name, (0, 4, 5, 8, 12, 14)) for name in ("plumb_bob", "rational_polynomial", "")),
     ("equidistant", (0, 4)), ("fisheye", (0, 4))],
)
def test_numbers_of_coefficients(model: str, counts: tuple[int, ...]) -> None:
    assert CameraModel.from_message(info()).pinhole.fx == K[0]
    assert CameraModel.from_message(info(D=[])).is_distorted is False
    for count in range(16):
        if count in counts:
            assert CameraModel.from_message(info(D=(0.01,) * count, distortion_model=model))
        else:
            with pytest.raises(InvalidIntrinsicsError, match=f"D has {count} coefficients"):
                CameraModel.from_message(info(D=(0.01,) * count, distortion_model=model))


@pytest.mark.parametrize(("changes", "text"), [
    ({"K": (0.0,) * 9}, "focal lengths fx=0"), ({"K": (float("nan"), *K[1:])}, "finite"),
    ({"K": K[:8]}, "9 finite numbers"), ({"K": (K[0], 0.5, *K[2:])}, "skew"),
    ({"D": (float("inf"),) * 5}, "finite"), ({"width": 0}, "is empty"), ({"height": 0}, "is empty"),
    ({"distortion_model": "thin_prism"}, "'thin_prism' is not known")])
def test_unusable_camera_info_is_refused(changes, text: str) -> None:
    with pytest.raises(InvalidIntrinsicsError, match=text):
        CameraModel.from_message(info(**changes))
