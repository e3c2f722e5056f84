"""Markers: every dictionary, choice among several, boards; in the loop and in the camera node."""

import cv2
import numpy as np
import pytest
import yaml

from aras_visual_servo_bench import Experiment, assemble, run
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.detection_pipeline import DetectionPipeline
from aras_visual_servo_camera.errors import VisionError, VisionParameterError
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.markers import DICTIONARIES, SEARCHED_DICTIONARIES, MarkerChoice
from aras_visual_servo_camera.parameters import VisionParameters
from aras_visual_servo_camera.trackers.marker import MarkerTracker
from aras_visual_servo_controller.goals.goal import Goal

CAMERA = CameraModel(640, 480, (600.0, 0, 319.5, 0, 600.0, 239.5, 0, 0, 1))
APRIL = "DICT_APRILTAG_36h11"


def drawn(*markers, shape=(480, 640)):
    """An image with markers (written choice, side px, column, row), a white rim about each."""
    image = np.full(shape, 255, np.uint8)
    for choice, side, column, row in markers:
        marker = MarkerChoice.read(choice).draw_marker(side)
        image[row : row + side, column : column + side] = marker
    return image


def find_pixels(found):
    return np.column_stack(CAMERA.project(*found.points.T))


@pytest.mark.parametrize("name", DICTIONARIES)
def test_markers_of_every_dictionary_are_found(name):
    side = 10 * DICTIONARIES[name]
    image = drawn((f"{name}:7", side, 200, 150), shape=(300, 400))
    corners = np.array([(0, 0), (side, 0), (side, side), (0, side)]) + (199.5, 149.5)
    searched = name in SEARCHED_DICTIONARIES or not name.startswith(("DICT_4X4", "DICT_APRIL"))
    for given in (f"{name}:7", name.removeprefix("DICT_").lower(), *(["", "7"] * searched)):
        found = MarkerTracker(MarkerChoice.read(given)).track(image, CAMERA)
        assert found.marker.endswith(":7")
        assert np.abs(find_pixels(found) - corners).max() < 0.05
    assert MarkerTracker(MarkerChoice.read(name)).track(image, CAMERA).marker == f"{name}:7"


def test_a_chosen_marker_is_named_where_it_is_not_in_view():
    image = drawn((f"{APRIL}:5", 120, 100, 150), (f"{APRIL}:3", 120, 400, 150))
    for given in (f"{APRIL}:3", "3", "apriltag_36h11:3"):
        found = MarkerTracker(MarkerChoice.read(given)).track(image, CAMERA)
        assert found.marker == f"{APRIL}:3" and found.points[:, 0].min() > 0.1
    with pytest.raises(VisionError, match=f"marker 4 of {APRIL} is not in view; .*11:3, .*11:5"):
        MarkerTracker(MarkerChoice.read(f"{APRIL}:4")).find(image)


BOARD = {"dictionary": "5X5_50", "size": 0.1, "markers": {1: [0, 0]}}


@pytest.mark.parametrize(("given", "words"), [
    ("DICT_5X5_50:50", "number is 50, must be at most 49 in DICT_5X5_50"),
    ("DICT_5X6_50:1", "dictionary 'DICT_5X6_50': did you mean .DICT_6X6_50."),
    ("-1", "must be a number of at least 0"), ("5X5_50:x", "must be a number"),
    ("99999", "at most 2319"), ("{dictionary: 5X5_100, size", "marker"),
    ({"dictionary": "5X5_50", "size": 0.1}, "key 'markers' of the board is missing"),
    (BOARD | {"size": -1}, "marker.size is -1"),
    (BOARD | {"markers": {1: [0]}}, r"marker.markers.1 is \[0\]"),
    (BOARD | {"markers": {70: [0, 0]}}, "number is 70, must be"),
    (BOARD | {"sise": 0.1}, "did you mean 'size'"),
])  # fmt: skip
def test_what_is_no_marker_is_refused_by_name(given, words):
    with pytest.raises(VisionError, match=words):
        MarkerChoice.read(given)
    with pytest.raises(VisionParameterError, match=words):  # of the camera node
        VisionParameters.from_mapping({"marker": given})
    with pytest.raises(ExperimentError, match=words):
        Experiment(target={"shape": "./tags.png", "marker": given}, plant="free")


def test_a_board_has_the_same_corners_whichever_of_its_markers_are_in_view():
    names, numbers = "5X5_100", (3, 8, 40, 99)
    seats = [(i % 2, i // 2) for i in range(4)]  # 120 px apart; 1 px is 0.5 mm
    places = {n: [0.06 * x, -0.06 * y] for n, (x, y) in zip(numbers, seats, strict=True)}
    board = {"dictionary": names, "size": 0.04, "markers": places}
    quoted = board | {"markers": {str(n): at for n, at in places.items()}}
    text = yaml.safe_dump(quoted, default_flow_style=True, sort_keys=False)  # as in launch files
    tracker = MarkerTracker(MarkerChoice.read(text))
    assert tracker.choice == MarkerChoice.read(board)
    every = [(f"{names}:{n}", 80, 200 + 120 * x, 120 + 120 * y)
             for n, (x, y) in zip(numbers, seats, strict=True)]  # fmt: skip
    corners = np.array([(0, 0), (200, 0), (200, 200), (0, 200)]) + (199.5, 119.5)
    for shown, apart in ((every, 0.05), (every[:1], 0.3), (every[1:3], 0.2), (every[2:], 0.2)):
        found = tracker.track(drawn(*shown, (f"{names}:1", 80, 480, 350)), CAMERA)
        assert np.abs(find_pixels(found) - corners).max() < apart
    with pytest.raises(VisionError, match="the board of markers 3, 8, 40, 99 .* not in view"):
        tracker.track(drawn((f"{names}:1", 80, 480, 350)), CAMERA)


def test_corners_of_a_marker_err_as_its_rim_s_edges_scatter():
    random, given = np.random.default_rng(3), "DICT_5X5_100:7"
    tracker = MarkerTracker(MarkerChoice.read(given))
    image = drawn((given, 90, 250, 200), shape=(320, 400))
    image = cv2.GaussianBlur(image, (0, 0), 0.8).astype(float)
    points, spreads = [], []
    for _ in range(25):
        noisy = np.clip(0.8 * image + 20.0 + 8.0 * random.normal(size=image.shape), 0, 255)
        found = tracker.track(noisy.astype(np.uint8), CAMERA)
        points.append(found.points.ravel())
        spreads.append(found.spread)
    told = np.sqrt(np.mean([np.diag(spread @ spread.T) for spread in spreads], axis=0))
    scatter = np.std(points, axis=0)
    assert (scatter < 2.5 * told).all() and (told < 3.0 * scatter).all(), told / scatter


def test_moments_are_of_the_chosen_marker():
    one, other = (f"{APRIL}:5", 120, 100, 150), (f"{APRIL}:0", 160, 400, 150)

    def measured(image, **given):
        pipeline = DetectionPipeline(VisionParameters.from_mapping(given).pipeline_settings)
        pipeline.set_camera(CAMERA)
        return pipeline.measure(Image(image, "mono8"))

    both = measured(drawn(one, other), marker=5)
    alone = measured(drawn(one), component="all")
    assert both.valid and both.moments.xg == pytest.approx(alone.moments.xg, abs=1e-12)
    assert both.moments.m00 == pytest.approx(alone.moments.m00)
    missing = measured(drawn(other), segmentation={"method": "otsu", "marker": f"{APRIL}:5"})
    assert not missing.valid and f"marker 5 of {APRIL} is not in view" in missing.reason


FREE = {"plant": "free", "features": "images", "gain": 4.0,
        "goal": {"pose": [0, 0, 0.4, np.pi, 0, 0]}}  # fmt: skip


@pytest.mark.parametrize(("given", "number"), [
    ({}, 0), ({"marker": 5}, 5), ({"marker": f"{APRIL}:0"}, 0),
])  # fmt: skip
def test_the_loop_keeps_to_its_marker(tmp_path, given, number):
    """Two markers of one size; without a choice, the one that the goal was taught by."""
    path = tmp_path / "two.png"
    cv2.imwrite(str(path), drawn((f"{APRIL}:5", 300, 100, 100), (f"{APRIL}:0", 300, 600, 100),
                                 shape=(500, 1000)))  # fmt: skip
    experiment = Experiment(
        controller_parameters={"tracker": "marker"}, scheme="numbered_points", duration=3.0,
        camera={"width": 320, "height": 240, "horizontal_fov": 1.05, "update_rate": 15.0},
        target={"shape": str(path), "size": [0.24, 0.12], **given},
        start={"pose": [0.02, -0.02, 0.45, 3.1, 0.05, 1.6]}, **FREE,
    )  # fmt: skip
    goal = assemble(experiment).goal
    assert goal.marker.startswith(APRIL) and (not given or goal.marker == f"{APRIL}:{number}")
    assert Goal.from_mapping(yaml.safe_load(goal.to_yaml())).marker == goal.marker
    done = run(experiment)
    assert done.outcome.startswith("converged") and done.verdict.distance < 1e-3


@pytest.mark.parametrize("given", ["6X6_250:17", "ARUCO_ORIGINAL:1023", "APRILTAG_16h5:29", 12])
def test_the_target_marker_is_drawn_as_the_one_that_is_chosen(given):
    goal = assemble(Experiment(
        target={"shape": "marker", "size": [0.1, 0.1], "marker": given}, scheme="pose",
        start={"pose": [0.02, -0.02, 0.45, 3.1, 0.05, 0.3]}, **FREE,
    )).goal  # fmt: skip
    assert goal.marker.endswith(str(given).rpartition(":")[2])
    with pytest.raises(ExperimentError, match="applies only to a target that shows markers"):
        Experiment(target={"shape": "l_shape", "marker": given}, **FREE)
