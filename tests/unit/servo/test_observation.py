"""The one factory: the same record from pictures, from messages and from exact geometry."""

import cv2
import numpy as np
import pytest
from loop_rig import CAMERA, STARTS, lost, the_arm, the_goal

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.seeing.joint_sample import JointSample
from aras_visual_servo_controller.seeing.observation import Need, Observer, implausible

ALL = frozenset(Need)


def joints(t, q=None):
    names = the_arm().names
    return JointSample.of(t, names, STARTS["2016"] if q is None else q, np.zeros(6))


def outline(q=None):
    pose = the_arm().pose(np.array(STARTS["2016"] if q is None else q, float))
    return the_goal("2016").target.outline(pose)


def picture(shape):
    finer = 8
    pixels = shape * [CAMERA.K[0], CAMERA.K[4]] + [CAMERA.K[2], CAMERA.K[5]]
    fine = np.full((240 * finer, 320 * finer), 250, np.uint8)
    fixed = np.round(((pixels + 0.5) * finer - 0.5) * 256.0).astype(np.int32)
    cv2.fillPoly(fine, [fixed], 5, shift=8)
    return cv2.resize(fine, (320, 240), interpolation=cv2.INTER_AREA)


def test_a_picture_and_exact_geometry_say_the_same():
    seen = Observer(the_arm(), ALL).of_image(0.5, picture(outline()), CAMERA, joints(0.5))
    exact = Observer(the_arm(), ALL).of_exact(0.5, CAMERA, joints(0.5), contour=outline())
    assert seen.valid, seen.reason
    assert exact.valid
    assert seen.moments.m00 == pytest.approx(exact.moments.m00, rel=0.01)
    assert seen.moments.xg == pytest.approx(exact.moments.xg, abs=1e-3)
    assert seen.moments.order == exact.moments.order == 6
    assert seen.cameras == {"camera": seen} and not seen.apart
    assert len(seen.contour) > 50
    assert seen.kernel.shape == (20,)
    assert seen.pixel_count > 100
    np.testing.assert_array_equal(seen.world_T_camera, the_arm().pose(seen.joints.positions))
    for array in (seen.image, seen.contour, seen.corners, seen.kernel, seen.world_T_camera,
                  seen.joints.positions, seen.joints.velocities):
        assert not array.flags.writeable


@pytest.mark.parametrize("need", Need)
def test_only_what_is_asked_for_is_worked_out(need):
    depth = np.full((240, 320), 0.2, np.float32)
    seen = Observer(the_arm(), frozenset((need,))).of_image(
        0.0, picture(outline()), CAMERA, joints(0.0), depth=depth
    )
    given = {
        Need.IMAGE: seen.image, Need.DEPTH: seen.depth, Need.KERNEL: seen.kernel,
        Need.CONTOUR: seen.contour, Need.CORNERS: seen.corners,
    }  # fmt: skip
    for other, value in given.items():
        expected = other is need or (other is Need.CONTOUR and need is Need.CORNERS)
        assert (value is not None) is expected, other


def test_without_segmentation_asked_for_an_empty_picture_is_valid():
    white = np.full((240, 320), 250, np.uint8)
    for given in (white, np.dstack([white, white // 2, white // 3])):
        seen = Observer(None, frozenset((Need.IMAGE,))).of_image(0.0, given, CAMERA)
        assert seen.valid
        np.testing.assert_array_equal(seen.image, given)
    seen = Observer(None, frozenset((Need.IMAGE, Need.MOMENTS))).of_image(0.0, white, CAMERA)
    assert not seen.valid
    assert seen.reason == "no target in view"
    assert seen.image is not None


def test_a_target_at_the_border_is_said_with_the_border():
    shape = outline() - [outline()[:, 0].min() + 1.6, 0.0]  # the picture begins at -1.55
    seen = Observer(None).of_image(0.0, picture(shape), CAMERA)
    assert not seen.valid
    assert seen.touches == ("left",)
    assert "left" in seen.reason


def test_a_picture_of_another_size_than_the_camera():
    seen = Observer(None).of_image(0.0, picture(outline())[:200], CAMERA)
    assert not seen.valid
    assert "320 x 200" in seen.reason


@pytest.mark.parametrize("begin", [0.0, 31.5])
def test_time_and_motion_since_the_last_one(begin):
    observer = Observer(the_arm())
    q = np.array(STARTS["2016"])
    first = observer.of_exact(begin, CAMERA, joints(begin, q), contour=outline(q))
    assert first.dt == 0.0
    assert first.previous_T_camera is None
    moved = q + [0.01, 0.02, -0.01, 0.0, 0.01, 0.1]
    second = observer.of_exact(begin + 0.04, CAMERA, joints(begin, moved), contour=outline(moved))
    assert second.dt == pytest.approx(0.04)
    np.testing.assert_allclose(
        first.world_T_camera @ second.previous_T_camera, second.world_T_camera, atol=1e-12
    )
    assert not second.previous_T_camera.flags.writeable
    late = observer.of_exact(begin + 0.02, CAMERA, joints(begin, q), contour=outline(q))
    assert late.dt == 0.0
    third = observer.of_exact(begin + 0.08, CAMERA, joints(begin, moved), contour=outline(q))
    assert third.dt == pytest.approx(0.04)  # since the newest, not since the late one
    np.testing.assert_allclose(third.previous_T_camera, np.eye(4), atol=1e-12)
    observer.reset()
    assert observer.of_exact(begin, CAMERA, joints(begin), contour=outline()).dt == 0.0


def test_of_messages():
    exact = Moments.from_polygon(outline(), 6)
    observer = Observer(the_arm(), frozenset((Need.MOMENTS, Need.KERNEL)))
    seen = observer.of_moments(
        0.1, exact, True, "", CAMERA, joints(0.1), kernel=np.arange(20.0), pixel_count=7,
        touches=("top",), commands=[joints(0.05)],
    )  # fmt: skip
    assert seen.valid
    assert seen.moments is exact
    assert (seen.pixel_count, seen.touches) == (7, ("top",))
    assert len(seen.commands) == 1
    np.testing.assert_array_equal(seen.kernel, np.arange(20.0))
    none = observer.of_moments(0.2, None, True, "", CAMERA)
    assert not none.valid
    assert none.reason == "the camera node sent no moments"
    bad = observer.of_moments(0.3, exact, False, "cut by the border", CAMERA)
    assert (bad.valid, bad.reason) == (False, "cut by the border")


@pytest.mark.parametrize(
    "change",
    [{"xg": 1e308}, {"yg": -31.0}, {"m00": 1e308}, {"m00": 3601.0}, {"centred": 1e300},
     {"m00": 0.0, "centred": 0.0}, {"xg": np.nan}],
)  # fmt: skip
def test_moments_that_no_camera_can_see(change):
    m = Moments.from_polygon(outline(), 4)
    values = {"m00": m.m00, "xg": m.xg, "yg": m.yg, **change}
    centred = m.centred * (change.get("centred", 1.0))
    bad = Moments(4, m.kind, values["m00"], values["xg"], values["yg"], centred)
    assert implausible(bad)
    seen = Observer(None).of_moments(0.0, bad, True, "", CAMERA)
    assert not seen.valid
    assert "implausible" in seen.reason
    assert seen.moments is None
    assert implausible(m) == ""
    wide = 28.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    assert implausible(Moments.from_polygon(wide, 4)) == ""  # 88 degrees off the axis, nearly


def test_exact_points_alone_and_nothing_in_view():
    observer = Observer(None, frozenset((Need.CORNERS,)))
    seen = observer.of_exact(0.0, CAMERA, points=[[0.1, 0.2], [0.3, 0.4], [0.0, 0.5]])
    assert seen.valid
    assert seen.moments is None
    assert seen.corners.shape == (3, 2)
    assert not observer.of_exact(0.1, CAMERA).valid
    assert not observer.of_exact(0.2, CAMERA, points=[[np.nan, 0.0]]).valid
    crossed = [[0, 0], [0.1, 0.1], [0.1, 0], [0, 0.1]]
    seen = observer.of_exact(0.3, CAMERA, contour=crossed)
    assert not seen.valid and "cross" in seen.reason


def test_a_lens_is_undone():
    fisheye = CameraModel(320, 240, CAMERA.K, (), "equidistant")
    u, v = fisheye.project(*outline().T)
    bent = np.stack([(u - CAMERA.K[2]) / CAMERA.K[0], (v - CAMERA.K[5]) / CAMERA.K[4]], axis=1)
    seen = Observer(None).of_image(0.0, picture(bent), fisheye)
    exact = Moments.from_polygon(outline(), 2)
    assert seen.moments.xg == pytest.approx(exact.xg, abs=5e-3)
    assert lost(seen, "x").moments is None
