"""Data that are recorded during a run, and fixed objects in the 3-D view of a report."""

from __future__ import annotations

import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest
from made_run import GOAL, made_run
from scipy.spatial.transform import Rotation

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.plots.palette import LIVE_CURVES, SCENE, to_rgb
from aras_visual_servo_bench.recording import film as films
from aras_visual_servo_bench.recording.camera_record import CameraRecord
from aras_visual_servo_bench.recording.film import make_image, with_images
from aras_visual_servo_bench.recording.run import pad_rows
from aras_visual_servo_bench.recording.run_recorder import RunRecorder
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.visualization.drawing_shapes import (
    compute_image_border,
    place_on_image_plane,
)
from aras_visual_servo_bench.web.report.report_data import make_contents
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.records.state import ServoState
from aras_visual_servo_controller.schemes.base import SchemeOutput

LEFT = CameraModel(64, 48, (50.0, 0, 30.0, 0, 44.0, 21.0, 0, 0, 1))
WIDE = CameraModel(80, 40, (30.0, 0, 41.0, 0, 33.0, 19.0, 0, 0, 1))


def pose(number):
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec([0.1 * number, 0.3, -0.2]).as_matrix()
    found[:3, 3] = number, 0.2, 0.5
    return found


EYE = {"width": 64, "height": 48, "camera_matrix": {"fx": 50.0, "fy": 44.0, "cx": 30.0, "cy": 21.0}}
EXPERIMENT = {
    "plant": "chain", "features": "exact", "gain": 3.0, "scheme": "moments@left",
    "camera": "original", "target": {"shape": "square", "size": [0.05, 0.05], "pose": [
        0.0, 0.0, 0.591, 0.0, 0.0, 0.3]},
    "cameras": {"left": {"model": EYE}, "blind": {"model": EYE},
                "wide": {"model": {**EYE, "latency": 0.02}, "delay": 0.05}}}  # fmt: skip


@pytest.fixture(scope="module")
def parts():
    return assemble(Experiment.from_mapping(EXPERIMENT))


def recorded(parts, phases=("approaching", "servoing", "servoing"), filmed=True,
             names=("yg", "an", "xg", "alpha")):  # fmt: skip
    """Run of made states, of five joint states, and of two images of the camera `wide`."""
    count = len(parts.plant.joint_names)
    recorder = RunRecorder(count, filmed)
    for i, phase in enumerate(phases):
        decision = SchemeOutput(names, *np.arange(12.0 * i, 12.0 * i + 12).reshape(3, 4))
        recorder.add_state(ServoState(1.5 + i, phase, scheme_output=decision), pose(i))
    for i in range(5):
        if i == 2:
            recorder.on_command(np.full(count, 0.7))
        recorder.on_joints(1.0 + 0.5 * i, np.full(count, 0.1 * i), np.full(count, 0.3 + i))
    for i in range(2):
        image = np.full((40, 80, 3), (200, 100 * i, 10), np.uint8)
        recorder.add_image(Frame(round(1.2e9 + 1e8 * i), image, "bgr8", name="wide"),
                     pose(7 + i), WIDE)  # fmt: skip
    return recorder.make_run(
        parts.plant, Experiment.from_mapping(EXPERIMENT), parts,
        joint_names=parts.plant.joint_names, goal_pose=GOAL, outcome="converged",
        reason="", remedy="", verdict=None)


def test_a_recorder_keeps_what_it_is_told_from_where_servoing_began(parts):
    run, arm, count = recorded(parts), parts.servo.arm, len(parts.plant.joint_names)
    assert [state.stamp for state in run.states] == [2.5, 3.5]
    np.testing.assert_array_equal(run.pose, [pose(1), pose(2)])
    np.testing.assert_allclose(run.joint_stamp, [1.0, 1.5, 2.0, 2.5, 3.0])
    np.testing.assert_allclose(run.measured_positions, [[0.1 * i] * count for i in range(5)])
    np.testing.assert_allclose(run.measured_velocities, [[0.3 + i] * count for i in range(5)])
    np.testing.assert_array_equal(run.joint_commands, [[np.nan] * count] * 2 + [[0.7] * count] * 3)
    for i in range(5):
        np.testing.assert_allclose(run.true_pose[i], arm.pose(np.full(count, 0.1 * i)), atol=1e-9)
    scheme = parts.servo.scheme
    assert run.units == tuple(scheme.units) and run.tolerances == tuple(scheme.tolerances)
    np.testing.assert_allclose(run.position_limits, [arm.lower, arm.upper])
    assert run.joint_units == tuple("m" if slides else "rad" for slides in arm.is_prismatic)
    assert list(run.speed_limits) == list(parts.settings.make_limits(arm).velocity)
    np.testing.assert_array_equal(run.centres, [[14.0, 12.0], [26.0, 24.0]])  # xg, yg
    assert (run.target, run.goal, run.outcome) == (parts.target, parts.goal, "converged")
    assert run.settings["gain"] == "3" and run.experiment.gain == 3.0
    assert list(run.cameras) == list(parts.cameras) and len(run.cameras) == 3
    left, wide, blind = (run.cameras[name] for name in ("left", "wide", "blind"))
    assert left.model is parts.plant.camera and wide.model is parts.cameras["wide"].true_camera
    assert left.stamp.tolist() == left.arrival.tolist() == [2.5, 3.5]
    np.testing.assert_array_equal(left.pose, run.pose)
    np.testing.assert_allclose(wide.stamp, [1.2, 1.3])
    np.testing.assert_allclose(wide.arrival, [1.27, 1.37])
    np.testing.assert_array_equal(wide.pose, [pose(7), pose(8)])
    assert (len(blind.stamp), blind.pose.shape, blind.film) == (0, (0, 4, 4), ())
    assert [stamp for stamp, _ in wide.film] == wide.stamp.tolist()
    shown = cv2.imdecode(np.frombuffer(wide.film[1][1], np.uint8), cv2.IMREAD_COLOR)  # bgr
    assert shown.shape == (40, 80, 3) and np.abs(shown[20, 40] - [200.0, 100.0, 10.0]).max() < 9
    assert recorded(parts, filmed=False).cameras["wide"].film == ()
    for names in (("yg", "an", "x", "a"), ("y", "an", "xg", "a")):
        assert recorded(parts, names=names).centres.shape == (0, 2)
    late = recorded(parts, ("servoing", "approaching", "servoing"))
    assert [state.stamp for state in late.states] == [3.5]
    free = recorded(assemble(Experiment.from_mapping({**EXPERIMENT, "plant": "free"})))
    assert free.joint_units == () and len(free.speed_limits) == 0


def test_a_picture_is_rgb_whatever_the_camera_delivers():
    grey = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    for image in (grey, grey[..., None]):
        shown = make_image(Frame(0, image, "mono8"), LEFT)
        np.testing.assert_array_equal(shown, np.repeat(grey[..., None], 3, 2))
    colours = np.dstack([grey, grey // 2, grey // 3])
    np.testing.assert_array_equal(make_image(Frame(0, colours, "rgb8"), LEFT), colours)
    turned = make_image(Frame(0, colours, "bgr8"), LEFT)
    np.testing.assert_array_equal(turned, colours[..., ::-1])
    outline = np.array([[10.0, 12.0], [40.0, 12.0], [40.0, 30.0], [10.0, 30.0]])
    drawn = make_image(Frame(0, outline=outline), LEFT)
    dark = np.argwhere(drawn[..., 0] < 100)
    assert drawn.shape == (48, 64, 3)
    assert np.abs(dark.min(axis=0) - [12, 10]).max() <= 1
    assert np.abs(dark.max(axis=0) - [30, 40]).max() <= 1


def test_pictures_are_those_of_the_control_camera(parts):
    run = recorded(parts)
    kept = [(2.5, np.zeros((4, 4, 3))), (3.5, np.ones((4, 4, 3)))]
    found = with_images(run, kept, ((2.5, b"jpeg"),))
    assert list(found.cameras) == list(run.cameras)
    assert found.control_record.images == tuple(kept)
    assert found.control_record.film == ((2.5, b"jpeg"),)
    assert found.control_record.model is parts.plant.camera
    assert found.cameras["wide"] is run.cameras["wide"]
    for stamp, number in ((0.0, 0), (2.9, 0), (3.1, 1), (9.0, 1)):
        assert found.control_record.find_nearest_image(stamp) is kept[number][1]
    assert run.control_record.find_nearest_image(0.0) is None
    bare = with_images(replace(run, cameras={}), kept)
    assert list(bare.cameras) == ["camera"] and bare.control_record.film == ()
    np.testing.assert_array_equal(pad_rows([(1, 2), None, (3,)]),
                                  [[1, 2], [np.nan] * 2, [3, np.nan]])  # fmt: skip
    assert pad_rows([]).shape == (0, 0)


def test_a_film_s_frames_are_as_large_as_its_bytes_allow():
    shape = (960, 1280, 3)
    calm = [(float(i), np.full(shape, 40 * i, np.uint8)) for i in range(3)]
    frames = films.encode_film(calm, 3)
    assert [stamp for stamp, _ in frames] == [0.0, 1.0, 2.0]
    shown = [cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1) for _, jpeg in frames]
    assert [one.shape for one in shown] == [(480, 640, 3)] * 3
    assert [round(float(one.mean())) for one in shown] == [0, 40, 80]
    noise = np.random.default_rng(0).integers(0, 255, shape, np.uint8)
    half = (noise[::2, ::2].copy(), np.zeros((480, 640, 3), np.uint8))
    frames = films.encode_film([(float(i), half[i > 0]) for i in range(300)], 300)
    sides = {cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1).shape[1] for _, jpeg in frames}
    assert len(sides) == 1 and sides < {480, 400, 320, 240, 160}  # none is larger than one before
    assert len(frames[0][1]) <= films.MAX_BYTES / 300
    ((_, jpeg),) = films.encode_film([(0.0, noise)], 1)
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1).shape == (480, 640, 3)
    stamps = np.array([0.9, 1.0 - 1e-7, 1.5, 2.0, 4.0, 8.0, 9.0])
    assert films.select_frames(stamps, 1.0).tolist() == stamps[1:].tolist()
    assert films.select_frames(stamps, 1.0, 3).tolist() == [stamps[1], 2.0, 9.0]  # halves are even


def points(shape):
    return np.reshape(shape["points"], (-1, 3))


def in_world(camera, local):
    return np.asarray(local) @ camera[:3, :3].T + camera[:3, 3]


def test_what_stands_still_in_space_is_where_the_run_has_it():
    runs = [made_run(3, 1.6), made_run(4, 2.3)]
    runs[1] = replace(runs[1], cameras={"camera": CameraRecord()})
    lost = replace(runs[1], true_pose=np.full_like(runs[1].true_pose, np.nan), target=None)
    for some in (runs[:1], [*runs, lost]):
        told = make_contents(some, [])["scene"]
        paths = [run.true_pose[run.joint_stamp >= run.states[0].stamp] for run in some[:2]]
        base = some[0].target.world_T_target(some[0].states[0].stamp)
        corners = np.array([(x, y, 0.0) for x, y in some[0].target.shape.corners])
        corners = in_world(base, corners)
        every = np.vstack([*(path[:, :3, 3] for path in paths), GOAL[None, :3, 3], corners])
        low, high = every.min(axis=0), every.max(axis=0)
        size = np.linalg.norm(high - low)
        assert told["size"] == pytest.approx(size)
        assert told["middle"] == pytest.approx((low + high) / 2)
        face, rim = (shape for _, shape in told["shapes"]["target"])
        np.testing.assert_allclose(points(rim), [*corners, corners[0]], atol=1e-5)
        middle = corners.mean(axis=0)
        wanted = [(a, b, middle) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
        np.testing.assert_allclose(points(face), np.reshape(wanted, (-1, 3)), atol=1e-5)
        assert (face["kind"], rim["kind"]) == ("faces", "strip")
        assert set(told["shapes"]) == {"target", *map(str, range(len(paths)))}
        for number, path in enumerate(paths):
            own = dict(told["shapes"][str(number)])
            np.testing.assert_allclose(points(own["path"]), path[:, :3, 3], atol=1e-5)
            ideal = points(own["straight"])
            np.testing.assert_allclose(ideal, np.linspace(path[0, :3, 3], GOAL[:3, 3], len(ideal)),
                                       atol=1e-5)  # fmt: skip
        border = compute_image_border(some[0].camera)
        farthest = np.sqrt(1 + (border**2).sum(axis=1)).max()
        local = 0.2 * size / farthest * np.column_stack([border, np.ones(len(border))])
        np.testing.assert_allclose(place_on_image_plane(border, border, 0.2 * size), local)
        own = dict(told["shapes"]["0"])
        for name, camera in (("goal", GOAL), ("start", paths[0][0])):
            picture = points(own[f"{name} picture"])
            np.testing.assert_allclose(picture[:-1], in_world(camera, local), atol=1e-5)
            np.testing.assert_allclose(points(own[f"{name} edges"])[0], camera[:3, 3], atol=1e-5)
        np.testing.assert_allclose(told["rims"][0], local)
        colours = [LIVE_CURVES[k] for k in range(3)] if len(some) > 1 else [SCENE["rim"]]
        assert told["colours"] == [[*to_rgb(colour), 1.0] for colour in colours]
        assert told["arm"] == to_rgb(SCENE["face"])
    assert set(dict(told["shapes"]["1"])) == {"path", "straight"} and told["rims"][1] == []
    assert make_contents([lost], [])["scene"] is None
    still = replace(runs[0], true_pose=np.tile(GOAL, (len(runs[0].true_pose), 1, 1)), target=None)
    told = make_contents([still], [])["scene"]
    assert told["size"] == 0.02 and told["shapes"]["target"] == []
    two = replace(lost, true_pose=runs[1].true_pose, target=runs[0].target)
    assert len(make_contents([two], [])["scene"]["shapes"]["target"]) == 2


def read(told, number, *shape):
    return np.frombuffer(base64.b64decode(told["arrays"][number]), "<f4").reshape(-1, *shape)


def test_poses_and_films_are_those_that_were_known():
    run = made_run(3, 1.6)
    poses = run.true_pose.copy()
    after = np.flatnonzero(run.joint_stamp >= run.states[0].stamp)
    poses[after[[0, 7]], 1, 2] = np.nan
    places = np.random.default_rng(1).normal(size=(len(poses), 3, 3))
    jpeg = films.encode_frame(np.zeros((40, 80, 3), np.uint8))
    other = CameraRecord(
        WIDE, film=tuple((s, jpeg) for s in (1.0, run.start_stamp, run.start_stamp + 0.5)))
    early = CameraRecord(WIDE, film=((1.0, jpeg),))
    pictures = tuple((float(s), np.zeros((40, 64, 3), np.uint8)) for s in run.stamp[:3])
    first = replace(run.control_record, images=((1.0, pictures[0][1]), *pictures), model=None)
    run = replace(run, true_pose=poses, joint_origins=places,
                  cameras={"camera": first, "early": early, "wide": other})  # fmt: skip
    told = make_contents([run], [])
    own = told["runs"][0]
    known = np.delete(after, [0, 7])
    np.testing.assert_allclose(read(told, own["poses"]["time"]),
                               run.joint_stamp[known] - run.start_stamp, atol=1e-6)  # fmt: skip
    np.testing.assert_allclose(read(told, own["poses"]["rows"], 12).reshape(-1, 3, 4),
                               poses[known][:, :3], atol=1e-6)  # fmt: skip
    np.testing.assert_allclose(read(told, own["poses"]["arm"], 3, 3), places[known], atol=1e-6)
    assert own["poses"]["joints"] == 3 and told["end"] == run.time[-1]
    film = own["film"]
    np.testing.assert_allclose(read(told, film["time"]), run.stamp[:3] - run.start_stamp, atol=1e-6)
    assert (film["width"], film["height"], len(film["frames"])) == (64, 40, 3)
    assert film["desired_outline"] is None and film["tracks"] is None  # no camera is known
    assert film["milestones"][0] == 0.0 and film["milestones"][-1] == run.time[-1]
    alone = replace(run, cameras={"camera": replace(first, images=pictures[:1])})
    film = make_contents([alone], [])["runs"][0]["film"]
    assert (film["width"], film["height"], len(film["frames"])) == (64, 40, 1)
    (wide,) = own["other_films"]
    assert (wide["camera"], wide["width"], wide["height"]) == ("wide", 80, 40)
    np.testing.assert_allclose(read(told, wide["time"]), [0.0, 0.5], atol=1e-6)
    assert base64.b64decode(wide["frames"][1]) == jpeg and len(wide["frames"]) == 2
    never = replace(run, true_pose=np.full_like(poses, np.nan), cameras={"camera": CameraRecord()})
    told = make_contents([never], [])["runs"][0]
    assert told["poses"] is told["film"] is None and told["other_films"] == []
    long = np.tile(GOAL, (5000, 1, 1))
    stamps = run.start_stamp + 1e-3 * np.arange(5000)
    told = make_contents([replace(run, true_pose=long, joint_stamp=stamps,
                             joint_origins=np.zeros((0, 0, 3)))], [])  # fmt: skip
    time = read(told, told["runs"][0]["poses"]["time"])
    assert len(time) == 2000 and time[-1] == pytest.approx(4.999) and np.ptp(np.diff(time)) < 2e-3
    assert "arm" not in told["runs"][0]["poses"]
