"""Model-based tracking of a solid: accuracy on rendered images, and lost targets."""


import numpy as np
import pytest
from tracking_scenes import CAMERA, CONDITIONS, SOLIDS, Sequence, block, corners_of, error_of

from aras_visual_servo_base.poses import exponential, inverse, matrix_from_xyz_rpy, rotation_vector
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import TrackingModelError, VisionError
from aras_visual_servo_camera.model_tracker import Solid, SolidTracking
from aras_visual_servo_camera.model_tracker.edge_search import (
    UNKNOWN_LEVEL,
    estimate_noise,
    measure_edges,
)
from aras_visual_servo_camera.model_tracker.pose_fitting import build_surface_equations
from aras_visual_servo_camera.model_tracker.visible_edges import sample_visible_edges
from aras_visual_servo_camera.trackers.initial_pose import InitialPose
from aras_visual_servo_camera.trackers.model import ModelTracker

OFF = (0.002, -0.0015, 0.004, 0.012, -0.015, 0.02)  # m and rad that a start is off
PICTURES = (3, 410)
BOUNDS = {"clean": (0.06, 0.03), "cluttered": (0.06, 0.03), "occluded": (0.1, 0.06),
          "noisy": (0.3, 0.15)}  # mm and degrees; measured on these images: half of it at most


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("solids")


def solid_of(name):
    return Solid.from_triangles(corners_of(name), name)


@pytest.mark.parametrize(("name", "condition"), [
    (name, condition) for i, name in enumerate(SOLIDS) for j, condition in enumerate(CONDITIONS)
    if (i + j) % 2 == 0
])
def test_a_pose_is_found_from_nearby_to_a_fraction_of_a_millimetre(folder, name, condition):
    sequence, tracking = Sequence(name, condition, folder), SolidTracking(solid_of(name))
    for i in PICTURES:
        true = sequence.pose(i)
        tracking.start(exponential(OFF) @ true)
        found = tracking.track(sequence.picture(i), CAMERA)
        away, turned = error_of(name, found.camera_T_solid, true)
        assert not found.loss_reason
        assert 1e3 * away < BOUNDS[condition][0], i
        assert np.degrees(turned) < BOUNDS[condition][1], i


def test_a_solid_is_followed_and_its_motion_goes_on(folder):
    sequence = Sequence("bracket", "cluttered", folder)
    tracking = SolidTracking(solid_of("bracket"))
    tracking.start(sequence.pose(0))
    for i in range(0, 24, 2):  # twice as fast
        found = tracking.track(sequence.picture(i), CAMERA)
        assert error_of("bracket", found.camera_T_solid, sequence.pose(i))[0] < 1e-4


def test_through_a_lens_points_normals_and_gains_are_those_of_the_bent_edges():
    solid = solid_of("bracket")
    pose = matrix_from_xyz_rpy((0.05, -0.03, 0.3), (np.pi - 0.6, 0.4, 0.5))
    lens = CameraModel(CAMERA.width, CAMERA.height, CAMERA.K, (-0.3, 0.1, 0.002, -0.003, 0.0))
    points = sample_visible_edges(solid, lens, pose, 3.0)
    straight = sample_visible_edges(solid, CAMERA, pose, 3.0)

    def drawn(seen):
        return np.column_stack(lens.project(*seen.T))

    assert len(points.solid_points) == len(straight.solid_points) > 100
    assert np.allclose(points.pixels, drawn(points.image_points))
    assert np.abs(points.pixels - straight.pixels).max() > 5.0
    begin, end = (solid.vertices[solid.edges[points.edges, k]] for k in (0, 1))
    onward = (points.solid_points + 1e-4 * (end - begin)) @ pose[:3, :3].T + pose[:3, 3]
    along = drawn(onward[:, :2] / onward[:, 2:]) - points.pixels
    along /= np.linalg.norm(along, axis=1)[:, None]
    assert np.allclose(points.normals, np.column_stack([along[:, 1], -along[:, 0]]), atol=1e-3)
    for k, step in enumerate(1e-6 * np.eye(2)):
        change = (drawn(points.image_points + step) - points.pixels) / 1e-6
        assert np.allclose(points.gains[:, k], (points.normals * change).sum(axis=1), rtol=1e-4,
                           atol=0.05)  # fmt: skip


def test_the_noise_of_a_picture_is_the_median_of_its_bends():
    random = np.random.default_rng(5)
    smooth = np.linspace(40.0, 200.0, 640) * np.ones((480, 1))
    for sigma in (2.0, 5.0, 12.0):
        grey = np.round(smooth + random.normal(0.0, sigma, smooth.shape))
        found = estimate_noise(np.clip(grey, 0, 255).astype(np.uint8))
        assert found == pytest.approx(sigma, rel=0.1)
    assert estimate_noise(np.full((480, 640), 7, np.uint8)) == 0.0


def measured(grey, at, normals, with_normal=UNKNOWN_LEVEL):
    levels = np.tile([with_normal, UNKNOWN_LEVEL], (len(at), 1))
    return measure_edges(grey, at, normals, np.full((len(at), 2), 50.0), levels, 10.0, 25.0, 0.0)


def slanted(angle, shade):
    """An image (40, 40) of grey levels by the distance across an edge; 13 points and normals."""
    normal = np.array([np.cos(angle), np.sin(angle)])
    fine = (np.arange(40 * 48) + 0.5) / 48.0 - 0.5
    across = fine[None, :] * normal[0] + fine[:, None] * normal[1] - 20.0 * normal.sum()
    grey = np.round(shade(across).reshape(40, 48, 40, 48).mean(axis=(1, 3))).astype(np.uint8)
    at = 20.0 + np.linspace(-6.0, 6.0, 13)[:, None] * (-normal[1], normal[0])
    return grey, at, np.tile(normal, (13, 1))


@pytest.mark.parametrize("angle", [0.0, 0.9, 2.2, -0.4])
def test_an_edge_is_measured_exactly_whatever_its_slant(angle):
    for offset in (0.0, 0.13, 0.37, -0.42):
        seen = slanted(angle, lambda across, at=offset: np.where(across < at, 50.0, 200.0))
        values = measured(*seen)
        assert np.abs(values[:, 0] - offset).max() < 0.012
        assert np.allclose(values[:, 1:3], (200.0, 50.0), atol=0.6)
        assert np.isnan(measured(*seen, 90.0)[:, 0]).all()  # of another level: another edge


@pytest.mark.parametrize("axis", [0, 1])
def test_an_edge_is_measured_up_to_three_pixels_from_the_border(axis):
    for place, found in ((2.5, False), (3.5, True), (35.5, True), (36.5, False)):
        at, normals = np.full((1, 2), 30.0), np.eye(2)[[axis]]
        at[0, axis] = place
        one = np.where(np.arange(40) <= place, 50, 200).astype(np.uint8)
        grey = np.tile(one, (60, 1)) if axis == 0 else np.tile(one[:, None], (1, 60))
        value = measured(grey, at, normals)[0, 0]
        assert value == pytest.approx(0.0, abs=1e-9) if found else np.isnan(value), place


@pytest.mark.parametrize(("half", "slope"), [(-40.0, 3.0), (40.0, 3.0), (3.0, 1.2), (6.5, 1.2)])
def test_edges_between_shaded_faces_are_measured_whichever_is_the_bright_one(half, slope):
    """Two in one image, each by its own normal. The faces differ from their mean by `half` grey
    levels, and all is brighter by `slope` a pixel; too little at the edge itself is none."""
    one, other = (slanted(angle, lambda across: 120.0 + half * np.sign(across - 0.3)
                          + slope * across) for angle in (1.4, 0.2))
    grey, at = np.hstack([one[0], other[0]]), np.vstack([one[1], other[1] + (40.0, 0.0)])
    values = measured(grey, at, np.vstack([one[2], other[2]]))
    np.testing.assert_allclose(values[13:], measured(*other), atol=1e-9)
    if abs(half) == 40.0:
        assert np.abs(values[:, 0] - 0.3).max() < 0.15
        assert np.allclose(values[:, 1] - values[:, 2], 2.0 * half, atol=15.0)
    else:
        assert np.isfinite(values[:, 0]).sum() > 6 if half > 5.0 else np.isnan(values[:, 0]).all()


def test_a_solid_that_is_gone_is_lost_and_found_again(folder):
    sequence, tracking = Sequence("box", "clean", folder), SolidTracking(solid_of("box"))
    tracking.start(sequence.pose(0))
    assert not tracking.track(sequence.picture(0), CAMERA).loss_reason
    empty = np.full((480, 640), 90, np.uint8)
    gone = tracking.track(empty, CAMERA)
    assert gone.loss_reason.startswith("box is lost: 0 of ")
    assert gone.inlier_share == 0.0
    other = Sequence("cylinder", "cluttered", folder)
    assert tracking.track(other.picture(200), CAMERA).loss_reason
    found = tracking.track(sequence.picture(1), CAMERA)
    assert not found.loss_reason
    assert error_of("box", found.camera_T_solid, sequence.pose(1))[0] < 1e-4


def test_what_cannot_be_seen_stays_as_it_was_and_is_said(folder):
    sequence, tracking = Sequence("cylinder", "clean", folder), SolidTracking(solid_of("cylinder"))
    true = sequence.pose(10)
    tracking.start(true @ matrix_from_xyz_rpy((0, 0, 0), (0.0, 0.0, 0.3)))
    found = tracking.track(sequence.picture(10), CAMERA)
    turned = rotation_vector(true[:3, :3].T @ found.camera_T_solid[:3, :3])
    assert turned[2] == pytest.approx(0.3, abs=0.02)
    values, vectors = np.linalg.eigh(found.covariance)
    assert values[-1] > 1.0 > 1e-6 > values[-2]
    assert abs(vectors[3:, -1] @ found.camera_T_solid[:3, 2]) > 0.999


def test_the_covariance_tells_the_spread_of_noisy_pictures(folder):
    sequence, tracking = Sequence("box", "clean", folder), SolidTracking(solid_of("box"))
    true, plain = sequence.pose(60), sequence.picture(60)
    random = np.random.default_rng(3)
    middle = np.append(tracking.solid.middle, 1.0)
    away, told = [], []
    for _ in range(20):
        noisy = np.clip(np.round(plain + random.normal(0.0, 5.0, plain.shape)), 0, 255)
        tracking.start(true)
        found = tracking.track(noisy.astype(np.uint8), CAMERA)
        turned = rotation_vector(found.camera_T_solid[:3, :3] @ true[:3, :3].T)
        away.append(np.append(((found.camera_T_solid - true) @ middle)[:3], turned))
        told.append(np.diag(found.covariance))
    ratios = np.square(away) / told
    assert 0.4 < np.sqrt(ratios[:, :3].mean()) < 2.5
    assert 0.4 < np.sqrt(ratios[:, 3:].mean()) < 2.5


def test_a_mesh_of_another_size_is_known_less_well_by_what_its_edges_miss(folder):
    sequence, true = Sequence("box", "clean", folder), Sequence("box", "clean", folder).pose(60)
    told = []
    for wider in (1.0, 1.02):
        solid = Solid.from_triangles(corners_of("box") * (wider, 1.0, 1.0), "box")
        tracker = ModelTracker(solid, InitialPose({"pose": [0.0] * 6}))
        tracker.tracking.start(true)
        told.append(tracker.track(sequence.picture(60), CAMERA))
    right, wrong = told
    assert right.repeatability < 0.4 * wrong.repeatability
    assert 0.9 * wrong.accuracy < wrong.repeatability < wrong.accuracy
    assert wrong.accuracy > 3.0 * right.accuracy


def test_a_bar_whose_ends_are_not_seen_is_known_but_for_a_shift_along_it():
    bar = block((0, 0), (1.4, 0.05), 0.0, 0.0, 0.04)
    tracking = SolidTracking(Solid.from_triangles(bar, "the bar"))
    pose = matrix_from_xyz_rpy((0.01, 0.02, 0.3), (2.6, 0.0, 0.0))
    points = sample_visible_edges(tracking.solid, CAMERA, pose, 3.0)
    assert len(np.unique(points.edges)) > 2
    grey = np.full((480, 640), 60, np.uint8)
    v, u = np.mgrid[0:480, 0:640]
    low, high = points.pixels[:, 1].min(), points.pixels[:, 1].max()
    grey[(v > low) & (v < high)] = 160
    tracking.start(pose)
    found = tracking.track(grey, CAMERA)
    along = found.camera_T_solid[:3, 0]
    assert not found.loss_reason
    assert along @ found.covariance[:3, :3] @ along > 1.0
    assert found.unrepeatable_part == 1.0


def test_a_depth_image_alone_tells_the_pose_of_three_faces(folder):
    sequence, solid = Sequence("box", "clean", folder), solid_of("box")
    true, depth = sequence.pose(200), sequence.depth(200)
    v, u = (a.ravel() for a in np.mgrid[0:480:6, 0:640:6])
    x, y, _ = CAMERA.normalise(u, v)
    seen = np.column_stack([x, y, depth[v, u]])
    pose = exponential((0.001, -0.0005, 0.002, 0.004, -0.005, 0.003)) @ true
    for _ in range(12):
        A, b, count = build_surface_equations(
            solid.vertices, solid.faces, solid.normals, seen, np.ascontiguousarray(pose),
            np.zeros(3), 1.0, 1e-3)
        pose = exponential(np.linalg.solve(A, b)) @ pose
    away, turned = error_of("box", pose, true)
    assert count > 100
    assert away < 5e-5
    assert turned < 1e-3


def test_a_depth_image_holds_what_noise_lets_go(folder):
    sequence, name = Sequence("cylinder", "noisy", folder), "cylinder"
    errors = []
    for deep in (False, True):
        tracking, sums = SolidTracking(solid_of(name)), []
        for i in range(30, 230, 40):
            tracking.start(sequence.pose(i))
            depth = sequence.depth(i) if deep else None
            found = tracking.track(sequence.picture(i), CAMERA, None, depth)
            sums.append(error_of(name, found.camera_T_solid, sequence.pose(i))[0])
        errors.append(np.sqrt(np.mean(np.square(sums))))
    assert errors[1] < 0.7 * errors[0]


def test_clicks_and_a_marker_start_it(folder):
    sequence, name = Sequence("bracket", "clean", folder), "bracket"
    true, picture = sequence.pose(0), sequence.picture(0)
    corners = np.unique(corners_of(name).reshape(-1, 3), axis=0)[[0, 3, 5, 8, 10]]
    places = corners @ true[:3, :3].T + true[:3, 3]
    u, v = CAMERA.project(*(places[:, :2] / places[:, 2:]).T)
    rough = np.round(np.column_stack([corners, u + 1.5, v - 1.0]), 4)
    tracker = ModelTracker(solid_of(name), InitialPose({"clicks": rough.tolist()}))
    told = tracker.track(picture, CAMERA)
    assert error_of(name, tracker.tracking.tracked_pose.camera_T_solid, true)[0] < 1e-4
    section = solid_of(name).compute_section_corners() @ true[:3, :3].T + true[:3, 3]
    assert np.abs(told.points - section[:, :2] / section[:, 2:]).max() < 2e-4
    assert told.plane.inverse_depth(*told.points[2]) == pytest.approx(1.0 / section[2, 2], rel=1e-3)
    assert 0.0 < told.accuracy < 1e-3
    start = InitialPose({"marker": {"size": 0.04, "pose": [0.01, 0, 0, 0, 0, 0]}})
    with pytest.raises(VisionError, match="no marker"):
        start.compute_camera_T_solid(picture, CAMERA, None)
    for given, why in (({}, "must define the start pose"), ({"pose": [0, 0, 0]}, "six finite numb"),
                       ({"pose": [0] * 6, "clicks": []}, "must define the start pose"),
                       ({"clicks": [[0, 0, 0, 1, 1]] * 3}, "four clicks of five"),
                       ({"marker": {"size": 0.1}}, "'pose'")):
        with pytest.raises(TrackingModelError, match=why):
            InitialPose(given)


def test_a_pose_in_the_world_starts_it_and_kinematics_tell_where_to_look(folder):
    sequence, name = Sequence("box", "clean", folder), "box"
    tracker = ModelTracker(solid_of(name), InitialPose({"pose": [0, 0, 0, 0, 0, 0]}))
    with pytest.raises(VisionError, match="needs the pose of the camera"):
        tracker.track(sequence.picture(0), CAMERA)
    gone = np.full((480, 640), 90, np.uint8)
    with pytest.raises(VisionError, match="is lost"):
        tracker.track(gone, CAMERA, inverse(sequence.pose(0)))
    assert not tracker.tracking.is_started  # it starts again while nothing of it is known
    for i in (0, 20, 60):  # far too far apart for a search
        tracker.track(sequence.picture(i), CAMERA, inverse(sequence.pose(i)))
        found = tracker.tracking.tracked_pose.camera_T_solid
        assert error_of(name, found, sequence.pose(i))[0] < 2e-4
    with pytest.raises(VisionError, match="is lost"):
        tracker.track(gone, CAMERA, inverse(sequence.pose(60)))
    assert tracker.tracking.is_started


def test_meshes_that_are_no_solid_in_metres_are_refused():
    box = corners_of("box")
    flipped = np.where(np.arange(len(box))[:, None, None] == 3, box[:, ::-1], box)
    for triangles, why in ((1000.0 * box, "80 m long: is it in millimetres"),
                           (0.001 * box, "too small"), (box[1:], "part.stl is not a closed"),
                           (box[:, ::-1], "inside out"), (flipped, "not a closed surface")):
        with pytest.raises(TrackingModelError, match=why):
            Solid.from_triangles(triangles, "part.stl")


def test_what_slips_turns_about_the_solids_own_axis():
    aside = Solid.from_triangles(corners_of("cylinder") + (0.04, -0.02, 0.01))
    free = np.abs(aside.compute_free_motions())
    assert np.allclose(free, np.eye(6)[:, 5:], atol=1e-3)


def test_triangles_are_welded_in_whatever_order_they_are_listed():
    """Each begins where the one before ends, and three of them are none."""
    left, chain = list(block((0.01, 0), (0.1, 0.05), 0.0, 0.03, 0.07)), []
    chain.append(left.pop(0))
    while left:
        for n, turn in np.ndindex(len(left), 3):
            if (np.roll(left[n], turn, axis=0)[0] == chain[-1][2]).all():
                chain.append(np.roll(left.pop(n), turn, axis=0))
                break
        else:
            chain.append(left.pop(0))
    a, b, c = chain[0]
    solid = Solid.from_triangles(np.array([*chain, (a, a, b), (a, b, a), (c, b, b)]))
    assert (len(solid.faces), len(solid.edges)) == (12, 12)
    section = solid.compute_section_corners()[[0, 2]]
    assert np.allclose(section, [(-0.04, -0.025, 0.05), (0.06, 0.025, 0.05)])
