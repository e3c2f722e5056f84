"""A recorded run is read from its bag unchanged, whatever data the bag lacks."""

import json
import re
import struct
from pathlib import Path

import cv2
import genpy.dynamic
import numpy as np
import pytest
import rosbag
import rospy
import yaml
from geometry_msgs.msg import Transform, TransformStamped
from rosgraph_msgs.msg import Clock
from run_messages import ARM, NAMES, SETTINGS, K, joint_states, made_state, position, same, told
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.errors import BenchError
from aras_visual_servo_bench.recording import message_run_builder
from aras_visual_servo_bench.recording.graph_recording import GraphRecording
from aras_visual_servo_bench.ros import bag as bags
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.records.state import ServoState
from aras_visual_servo_controller.schemes.base import SchemeOutput
from aras_visual_servo_controller.settings import ControllerSettings

STAMPS = 1.537 + np.arange(9) * 0.0341
TRANSFORMED = np.arange(STAMPS[0] - 0.05, STAMPS[-1] + 0.02, 0.0171)
PACE = [(1.6, 0.9), (1.7, 1.1)]


def picture(number: int) -> np.ndarray:
    """(48, 64, 3) rgb, of a colour of its own."""
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[:, :] = (20 * number + 10, 200 - 20 * number, 90)
    return rgb


def image(stamp: float, number: int) -> Image:
    message = Image(width=64, height=48, encoding="rgb8", step=192, data=picture(number).tobytes())
    message.header.stamp = rospy.Time.from_sec(stamp)
    return message


def transforms(stamp: float, parts: dict[tuple[str, str], tuple]) -> TFMessage:
    found = []
    for (parent, child), (place, turn) in parts.items():
        one = TransformStamped(child_frame_id=child, transform=Transform())
        one.header.frame_id, one.header.stamp = parent, rospy.Time.from_sec(stamp)
        t, q = one.transform.translation, one.transform.rotation
        t.x, t.y, t.z = place
        q.x, q.y, q.z, q.w = Rotation.from_rotvec(turn).as_quat()
        found.append(one)
    return TFMessage(found)


def described(**parameters: object) -> str:
    return json.dumps({
        "controller": "/loop", "versions": {"numpy": "1"}, "goals": {},
        "launch": [["pkg", "a.launch", "camera:=lab"]],
        "parameters": {"robot_description": ARM, "loop": {
            "scheme": "points", "namespace": "/two", "command_topic": "both", **parameters}}})


def write(path: Path, graph, face, *, experiment: str = "", compressed: bool = False,
          shift: float = 0.0, append: bool = False, skip: tuple[str, ...] = (),
          after: tuple[float, ...] = ()) -> Path:
    """A bag as the recorder writes one, all stamps later by `shift` s; what is appended was written
    30 s later. after: when images came that nobody answered, s after the last."""
    from aras_visual_servo_camera.msg import ImageMoments
    from gazebo_msgs.msg import PerformanceMetrics

    with rosbag.Bag(str(path), "a" if append else "w", chunk_threshold=20_000) as bag:
        def put(topic, message, stamp, late=0.0):
            if topic.rpartition("/")[2] not in skip:
                written = rospy.Time.from_sec(stamp + late + (30.0 if append else 0.0))
                bag.write(topic, message, written)

        began = STAMPS[0] + shift
        if experiment:
            put("/two/experiment", String(experiment), began - 0.1)
        put("/other/camera/camera_info", CameraInfo(width=9, height=9), began)
        put("/labrob/camera/camera_info", CameraInfo(
            width=64, height=48, K=K, D=[0.0] * 5, distortion_model="plumb_bob"), began)
        put("/tf_static", transforms(began, {
            ("hand", "camera_link"): ((0.01, 0.02, 0.03), (0.1, 0.2, 0.3))}), began - 0.1)
        for stamp in np.arange(STAMPS[0] - 0.05, STAMPS[-1] + 0.02, 0.013) + shift:
            put("/two/joint_states", joint_states(stamp), stamp)
        for stamp in TRANSFORMED + shift:
            put("/tf", transforms(stamp, {("world", "/hand"): ((stamp, 0.1, 0.5), (0, 0, stamp))}),
                stamp)
        for number, stamp in enumerate(STAMPS + shift):
            approaching = number == 0
            state = made_state(stamp, "approaching" if approaching else "servoing",
                               outcome="" if number == 8 else "running")
            message, report = told(graph, face, state)
            put("/two/controller/state", message, stamp, 0.02)
            put("/two/controller/diagnosis", report, stamp, 0.021)
            moments = Moments.from_polygon(
                np.array([(0.1, 0.2), (0.3, 0.2), (0.2, 0.4 + 0.01 * number)]))
            seen = ImageMoments(valid=number != 4, m=moments.m_array, mu=moments.mu_array,
                                order=moments.order)
            seen.header = message.header
            put("/two/camera/moments", seen, stamp, 0.01)
            if compressed:
                bgr = picture(number)[..., ::-1]
                content = cv2.imencode(".png", bgr)[1].tobytes()
                shown = CompressedImage(format="png", data=content)
                shown.header.stamp = rospy.Time.from_sec(stamp)
                put("/labrob/camera/image_raw/compressed", shown, stamp, 0.005 + 1e-4 * number)
            else:
                put("/other/camera/image_raw", Image(), stamp)
                put("/labrob/camera/image_raw", image(stamp, number), stamp, 0.005 + 1e-4 * number)
        for late in after:
            put("/labrob/camera/image_raw", image(STAMPS[-1] + late, 9), STAMPS[-1] + late)
        for stamp, factor in PACE:
            message = PerformanceMetrics(real_time_factor=factor)
            message.header.stamp = rospy.Time.from_sec(stamp + shift)
            put("/gazebo/performance_metrics", message, stamp + shift)
        put("/clock", Clock(), began)
    return path


def test_a_bag_s_run_has_every_number_that_was_recorded(graph, face, tmp_path):
    path = write(tmp_path / "run.bag", graph, face, experiment=described())
    parts = []
    run = bags.read_bag(path, parts.append)
    assert run.name == tmp_path.name and run.source == str(path)
    assert min(parts) > 0.0 and np.ptp(np.diff([0.0, *parts])) < 0.02 and parts[-1] == 1.0
    states = [made_state(stamp) for stamp in STAMPS[1:]]  # the first was the way to the start
    same(run.stamp, np.round(STAMPS[1:], 9))
    assert run.outcome == "running" and run.scheme == "points" and run.names == NAMES
    for name, wanted in (("features", [s.scheme_output.features for s in states]),
                         ("error", [s.error for s in states]),
                         ("filtered_error", [s.scheme_output.filtered_error for s in states]),
                         ("desired_twist", [s.desired_twist for s in states]),
                         ("achieved_twist", [s.achieved_twist for s in states])):  # fmt: skip
        same(getattr(run, name), wanted)
    same([s.computation_time for s in run.states], [s.computation_time for s in states])
    stamp = np.arange(STAMPS[0] - 0.05, STAMPS[-1] + 0.02, 0.013)
    np.testing.assert_allclose(run.joint_stamp, stamp, atol=1.1e-9)
    np.testing.assert_allclose(run.measured_positions, [position(s) for s in stamp], atol=1e-9)
    same(run.measured_velocities, np.tile([-0.11, 0.2], (len(stamp), 1)))
    last = np.searchsorted(STAMPS, stamp + 1e-8) - 1
    wanted = [position(STAMPS[i]) + 0.01 if i > 0 else (np.nan, np.nan) for i in last]
    np.testing.assert_allclose(run.joint_commands, wanted, atol=1e-8)
    arm = SETTINGS.make_arm(ARM)
    np.testing.assert_allclose(run.true_pose, [arm.pose(position(s)) for s in stamp], atol=1e-8)
    at = np.searchsorted(run.joint_stamp, run.stamp)
    same(run.pose, run.true_pose[at])
    assert run.joint_origins.shape[0] == len(stamp)
    record = run.cameras["camera"]
    np.testing.assert_allclose(record.stamp, STAMPS, atol=1.1e-9)
    np.testing.assert_allclose(record.arrival - record.stamp, 0.005 + 1e-4 * np.arange(9),
                               atol=2e-9)
    assert (record.model.width, record.model.K) == (64, K)
    for exposed, rgb in record.images:
        number = round((exposed - STAMPS[0]) / 0.0341)
        assert (rgb == picture(number)).all()
    assert {round(s, 4) for s, _ in record.images} >= {round(STAMPS[-1], 4)}
    centres = [(0.2, (0.8 + 0.01 * n) / 3) if n != 4 else (np.nan, np.nan) for n in range(1, 9)]
    same(run.centres, centres)
    same(run.real_time_factors, PACE)
    same(run.position_limits, [(-0.5, -1.5), (0.7, 2.0)])
    same(run.speed_limits, (0.3, 1.9))
    assert run.joint_units == ("m", "rad") and run.versions == {"numpy": "1"}
    assert run.settings["camera"] == "lab" and "roslaunch" not in run.settings["launched by"]
    assert run.notes == ["the goal goal_2016.yaml was not recorded",
                         "units of the features are unknown: scheme 'points' has other features "
                         "than in the bag"]


def test_where_nothing_is_described_the_camera_s_path_is_that_of_tf(graph, face, tmp_path):
    run = bags.read_bag(write(tmp_path / "a.b.bag", graph, face, compressed=True), name="")
    assert run.name == "a"
    assert any("no topic .../experiment" in note for note in run.notes)
    hand_R_link = Rotation.from_rotvec([0.1, 0.2, 0.3])
    link_R_optical = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    for joint_stamp, pose in zip(run.joint_stamp, run.true_pose, strict=True):
        stamp = TRANSFORMED[np.argmin(np.abs(TRANSFORMED - joint_stamp))]
        world_R_hand = Rotation.from_rotvec([0, 0, stamp])
        np.testing.assert_allclose(pose[:3, :3], (world_R_hand * hand_R_link).as_matrix()
                                   @ link_R_optical, atol=1e-8)
        np.testing.assert_allclose(pose[:3, 3], (stamp, 0.1, 0.5) + world_R_hand.apply(
            [0.01, 0.02, 0.03]), atol=1e-8)
    exposed, rgb = run.cameras["camera"].images[-1]
    assert exposed == pytest.approx(STAMPS[-1], abs=1e-8)
    assert (rgb == picture(8)).all()
    assert run.joint_units in ((), ("", "")) and run.verdict.name == ""
    assert run.goal_pose.shape == (4, 4) and np.isnan(run.goal_pose).all()


def test_a_film_ends_with_the_last_image_that_was_answered(graph, face, tmp_path):
    path, unknown = write(tmp_path / "a.bag", graph, face, after=(0.0341, 0.5)), image(1.6, 3)
    unknown.encoding = "yuv422"
    with rosbag.Bag(str(path), "a") as bag:
        bag.write("/labrob/camera/image_raw", unknown, rospy.Time.from_sec(1.601))
    run = bags.read_bag(path)
    record = run.cameras["camera"]
    assert len(record.stamp) == len(STAMPS) + 3
    np.testing.assert_allclose([stamp for stamp, _ in record.film], STAMPS[1:], atol=1.1e-9)
    shown = cv2.imdecode(np.frombuffer(record.film[0][1], np.uint8), 1)[..., ::-1]
    assert np.abs(shown.astype(int) - picture(1)).max() < 8


def test_the_last_run_of_a_bag_is_read_also_after_the_clock_was_reset(graph, face, tmp_path):
    path = write(tmp_path / "a.bag", graph, face, experiment=described())
    write(path, graph, face, shift=-1.4, append=True, skip=("camera_info",))
    parts = []
    run = bags.read_bag(path, parts.append)
    assert len(parts) == 100  # of some 200 messages
    same(run.stamp, np.round(STAMPS[1:] - 1.4, 9))
    assert run.joint_stamp[0] == pytest.approx(STAMPS[0] - 1.45)  # the first one after it
    # told once
    assert run.cameras["camera"].model.width == 64 and run.position_limits[0][0] == -0.5
    assert len(run.cameras["camera"].stamp) == 9
    (note,) = [note for note in run.notes if "clock" in note]
    assert note.startswith("the clock was reset once")
    assert bags.read_recorded_experiment(path).arguments == {"camera": "lab"}
    with rosbag.Bag(str(path), "a") as bag:  # of a node that has not heard the clock yet
        bag.write("/two/joint_states", joint_states(0.0), rospy.Time(40))
    again = bags.read_bag(path)
    assert again.notes == run.notes
    same(again.joint_stamp, run.joint_stamp)
    path = write(tmp_path / "a.bag", graph, face, experiment=described())
    write(path, graph, face, shift=10.0, append=True, skip=("camera_info",))
    run = bags.read_bag(path)
    same(run.stamp, np.round(STAMPS[1:] + 10.0, 9))
    assert any("has 2 runs" in note for note in run.notes)
    assert not any("clock was reset" in note for note in run.notes)


def in_order(path: Path, source: Path, added, clock: bool) -> Path:
    """Write a bag's messages and `added` ones (topic, message, time in s) by time, with /clock."""
    with rosbag.Bag(str(source)) as bag:
        rows = [row for row in bag if row[0] != "/clock"]
    rows += [(topic, message, rospy.Time.from_sec(time)) for topic, message, time in added]
    if clock:
        for t in np.arange(STAMPS[0] - 0.2, STAMPS[-1] + 0.1, 0.01):
            time = rospy.Time.from_sec(t)
            rows.append(("/clock", Clock(time), time))
    with rosbag.Bag(str(path), "w") as bag:
        for row in sorted(rows, key=lambda row: row[2]):
            bag.write(*row)
    return path


@pytest.mark.parametrize("clock", [True, False])
def test_stamps_of_another_clock_are_left_out_and_do_not_reset_the_clock(
    graph, face, tmp_path, clock
):
    once = write(tmp_path / "a.bag", graph, face, experiment=described())
    wall = 1.8e9
    times = np.arange(STAMPS[0], STAMPS[-1], 0.02)
    strays = [("/two/joint_states", joint_states(wall + t), t + 0.001) for t in times]
    strays += [("/tf", transforms(wall + t, {("world", "/hand"): ((9.0, 9.0, 9.0), (0, 0, 0))}),
                t + 0.001) for t in times[:3]]  # fmt: skip
    notes = read_both(tmp_path, once, strays, clock)
    assert len(notes) == 2 and not any("reset" in note for note in notes)
    assert notes[0].startswith(f"/two/joint_states: {len(times)} messages are left out")
    assert "second node" in notes[0] and "wall time" in notes[0] and "1.8e+09 s" in notes[0]
    assert notes[1].startswith("/tf: 3 messages are left out")


def read_both(folder, once, strays, clock=True):
    """Check that messages of others between its own do not change a bag's run; return new notes."""
    run, single = (bags.read_bag(in_order(folder / "b.bag", once, added, clock))
                   for added in (strays, []))  # fmt: skip
    for name in ("stamp", "joint_stamp", "measured_positions", "true_pose"):
        same(getattr(run, name), getattr(single, name))
    return [note for note in run.notes if note not in single.notes]


def test_impossible_joint_states_of_a_second_publisher_are_left_out(graph, face, tmp_path):
    once = write(tmp_path / "a.bag", graph, face)
    strays = []
    for t in np.arange(STAMPS[0], STAMPS[-1], 0.02):
        message = joint_states(t + 0.001)
        message.position = [np.nan] * len(message.name)
        strays.append(("/two/joint_states", message, t + 0.001))
    (note,) = read_both(tmp_path, once, strays)
    assert f"impossible positions: {len(strays)} (the measured position" in note
    assert "second node publishes joint states" in note


@pytest.mark.parametrize(("shown", "count"), [((0.29,), 0), ((0.31,), 1), ((40.0, 8.0), 2)])
def test_the_clock_of_the_bag_shows_when_it_was_reset(graph, face, tmp_path, shown, count):
    """Joint states that are out of order are no reset, if the bag has the clock."""
    once = write(tmp_path / "a.bag", graph, face, experiment=described())
    ahead = [("/two/joint_states", joint_states(STAMPS[0] + 0.9), STAMPS[0] + 0.003)]
    before = [("/clock", Clock(rospy.Time.from_sec(STAMPS[0] + by)), STAMPS[0] - 0.3 + 0.01 * k)
              for k, by in enumerate(shown)]
    late = [("/two/joint_states", joint_states(STAMPS[0] + shown[-1]), STAMPS[0] - 0.1)]
    run = bags.read_bag(in_order(tmp_path / "b.bag", once, [*before, *ahead, *late], clock=True))
    assert [note.split(" during")[0] for note in run.notes if "reset" in note] == {
        0: [], 1: ["the clock was reset once"], 2: ["the clock was reset 2 times"]}[count]
    assert not any("left out" in note for note in run.notes)
    same(run.stamp, np.round(STAMPS[1:], 9))


def test_a_bag_that_was_not_closed_is_read_as_far_as_it_goes(graph, face, tmp_path):
    path = write(tmp_path / "a.bag", graph, face)
    whole = path.read_bytes()
    with rosbag.Bag(str(path)) as bag:
        index = bag._index_data_pos
    head = whole[:index].replace(b"index_pos=" + index.to_bytes(8, "little"),
                                 b"index_pos=" + bytes(8))  # fmt: skip
    cut = tmp_path / "b.bag.active"
    cut.write_bytes(head)
    run = bags.read_bag(cut)
    assert run.notes[0].startswith("the bag was not closed") and run.name == "b"
    same(run.stamp, bags.read_bag(path).stamp)
    same(run.joint_stamp, bags.read_bag(path).joint_stamp)
    assert cut.read_bytes() == head
    cut.write_bytes(head[: round(0.6 * len(head))])
    assert 0 < len(bags.read_bag(cut).stamp) <= len(run.stamp)
    cut.write_bytes(head[:200])
    with pytest.raises(BenchError, match="b.bag.active"):
        bags.read_bag(cut)
    cut.write_bytes(head[9:])
    for read in (bags.read_bag, bags.read_recorded_experiment):
        with pytest.raises(BenchError, match="cannot read the bag .*b.bag.active"):
            read(cut)


@pytest.mark.parametrize("fault", [
    OSError, rosbag.ROSBagException, struct.error, ValueError, RuntimeError])
def test_whatever_rosbag_raises_of_a_damaged_bag_is_told(monkeypatch, tmp_path, fault):
    pytest.importorskip("mcap")
    from aras_visual_servo_bench.ros import mcap

    def fail(_path):
        raise fault("why")

    monkeypatch.setattr(rosbag, "Bag", fail)
    for read in (bags.read_bag, bags.read_recorded_experiment,
                 lambda bag: mcap.convert(bag, tmp_path / "a.mcap")):
        with pytest.raises(BenchError, match="cannot .* a.bag.*: why"):
            read(Path("a.bag"))


@pytest.mark.parametrize(("skip", "said"), [
    (("diagnosis",), "no diagnosis: outcome and achieved twist are unknown"),
    (("image_raw",), "the bag has no images"), (("tf", "tf_static"), "no transforms of the camera"),
    (("tf_static",), "no transforms of the camera"),
    (("joint_states",), "no joint states of slide, elbow")])
def test_what_a_bag_lacks_is_noted(graph, face, tmp_path, skip, said):
    run = bags.read_bag(write(tmp_path / "a.bag", graph, face, skip=skip))
    assert any(said in note for note in run.notes), run.notes


def test_a_bag_without_a_run_or_of_another_version_is_named(graph, face, tmp_path):
    with pytest.raises(BenchError, match="contains no state of a servo .*; its topics: /"):
        bags.read_bag(write(tmp_path / "b.bag", graph, face, skip=("state",)))
    with rosbag.Bag(str(tmp_path / "c.bag"), "w") as bag:
        bag.write("/two/controller/state", told(graph, face, ServoState(1.0, "waiting", reason="no "
                  "image on /eye"))[0], rospy.Time(1))
    with pytest.raises(BenchError, match="last phase is waiting: no image on /eye"):
        bags.read_bag(tmp_path / "c.bag")
    whole = write(tmp_path / "whole.bag", graph, face)
    state, report = "/two/controller/state", "/two/controller/diagnosis"
    with pytest.raises(BenchError, match=f"{state} has another version .* without desired_f"):
        bags.read_bag(write_without(tmp_path / "a.bag", whole, state, "desired_features"))
    run = bags.read_bag(write_without(tmp_path / "b.bag", whole, report, "manipulability"))
    assert f"{report} has another version" in "".join(run.notes)
    assert not np.isfinite(run.scale).any()
    same(run.stamp, bags.read_bag(whole).stamp)
    # What was added later and is not needed is not missed.
    run = bags.read_bag(write_without(tmp_path / "c.bag", whole, report, "filtered_error"))
    assert not any("another version of" in note for note in run.notes)
    assert np.isfinite(run.scale).any()


def heard(graph, face, scheme="points", count=3) -> GraphRecording:
    """Return the messages of three images with `count` features, as stored during a run."""
    found = GraphRecording(Path("run"))
    found.experiment_text = described(scheme=scheme)
    for stamp in STAMPS[1:4]:
        decision = SchemeOutput(tuple(f"f{i}" for i in range(count)), *stamp + np.eye(3, count))
        message, report = told(graph, face, made_state(stamp, scheme_output=decision))
        message.scheme = scheme
        found.states.append(message)
        found.add_report(report)
        found.joints.append(joint_states(stamp))
    return found


@pytest.mark.parametrize(("scheme", "at_any_depth"), [
    ("moments", False), ("theta_u", True), ("pose", False), ("lines", True)])
def test_features_have_the_units_and_tolerances_of_their_scheme(graph, face, scheme, at_any_depth):
    """Tolerances of lengths are parts of the goal's depth, which these messages do not tell."""
    made = ControllerSettings(scheme=scheme).make_scheme()
    for count in (len(made.units), len(made.units) + 1):
        given = heard(graph, face, scheme, count)
        run = message_run_builder.MessageRunBuilder(given).build_run("name")
        known = count == len(made.units)
        assert run.units == (tuple(made.units) if known else ("",) * count)
        assert run.tolerances == (tuple(made.tolerances) if known and at_any_depth else ())
        assert run.scheme == scheme and any("units" in note for note in run.notes) != known


def test_joint_states_that_lack_a_place_are_left_out_and_speeds_may_be_unknown(graph, face):
    """Whole ones in any order; of the others the arm's joints are not all known."""
    rows = (
        (1.5, ("slide", "elbow"), (0.1, 0.2), (0.3, 0.4)),
        (1.6, ("elbow", "finger", "slide"), (0.5, 9.0), (0.6, 8.0, 0.7)),  # of the slide none
        (1.7, ("elbow", "slide", "finger"), (0.8, 0.9), (1.0, 1.1, 8.0)),  # of the finger none
        (1.8, ("elbow", "finger"), (1.2, 9.0), (1.3, 8.0)),
        (1.9, ("slide", "elbow"), (), ()), (2.0, ("elbow", "slide"), (1.4, 1.5), ()),
        (2.1, ("elbow", "slide"), (1.6, 1.7), (1.8,)))
    read = heard(graph, face)
    read.joints = [JointState(name=n, position=q, velocity=v) for _, n, q, v in rows]
    for message, (stamp, *_) in zip(read.joints, rows, strict=True):
        message.header.stamp = rospy.Time.from_sec(stamp)
    run = message_run_builder.MessageRunBuilder(read).build_run("name")
    np.testing.assert_allclose(run.joint_stamp, [1.5, 1.7, 2.0, 2.1])
    np.testing.assert_allclose(run.measured_positions,
                               [(0.1, 0.2), (0.9, 0.8), (1.5, 1.4), (1.7, 1.6)])
    unknown = (np.nan, np.nan)
    np.testing.assert_allclose(run.measured_velocities, [(0.3, 0.4), (1.1, 1.0), unknown, unknown])


def write_without(path: Path, source: Path, topic: str, field: str) -> Path:
    """Copy a bag as if the messages of a topic had been defined without a field."""
    older = None
    with rosbag.Bag(str(source)) as there, rosbag.Bag(str(path), "w") as copy:
        for name, message, time in there:
            if name == topic:
                if older is None:
                    definition = re.sub(rf"^\S+ +{field}\b.*\n", "", message._full_text,
                                        flags=re.MULTILINE)
                    older = genpy.dynamic.generate_dynamic(message._type, definition)[message._type]
                message = older(*(getattr(message, slot) for slot in older.__slots__))
            copy.write(name, message, time)
    return path


def test_a_bag_shows_its_experiment_and_what_it_was_made_of(graph, face, tmp_path, capsys):
    content = json.loads(described(gain=2.5))
    content["goals"] = {"../stolen.yaml": "a", "experiment.yaml": "f"}
    path = write(tmp_path / "a.bag", graph, face, experiment=json.dumps(content))
    assert main(["show", str(path), "--out", str(tmp_path / "shown")]) == 0
    said = capsys.readouterr().out
    assert "# the goal '../stolen.yaml' is omitted: it is not a file name" in said
    told = yaml.safe_load(said)
    assert (told["scheme"], told["gain"]) == ("points", 2.5)
    assert yaml.safe_load((tmp_path / "shown" / "experiment.yaml").read_text()) == told
    assert {file.name for file in (tmp_path / "shown").iterdir()} == {
        "experiment.yaml", "launch.txt", "parameters.yaml", "robot.urdf", "versions.txt"}
    assert not (tmp_path / "stolen.yaml").exists()
    assert main(["show", str(write(path, graph, face))]) == 1
    assert "older version" in capsys.readouterr().err


def test_a_run_ends_where_the_arm_goes_to_a_start_or_other_features_are_seen():
    def states(text):
        """A state a letter: of features a or b, without any (-), another phase (p, idle)."""
        none = np.zeros(1)
        outputs = {one: SchemeOutput((one,), none, none, none) for one in "ab"}
        phases = {"p": "approaching", "i": "idle", "h": "holding", "s": "stopped"}
        return [ServoState(1.0, phases.get(one, "servoing"), scheme_output=outputs.get(one))
                for one in text]  # fmt: skip

    for text, lengths in (("-ab", [1, 1]), ("aa-a", [4]), ("aapa", [2, 1]), ("--", []),
                          ("aib-bs", [1, 4]), ("p-aapp-h", [2]), ("ah-b", [3, 1])):  # fmt: skip
        runs = message_run_builder.split_runs(states(text))
        assert [len(run) for run in runs] == lengths, text


def test_topics_are_found_by_their_types():
    kinds = {"/a/camera_info": bags.INFO, "/a/image_raw": bags.IMAGE, "/x/s": bags.STATE,
             "/c/compressed": bags.COMPRESSED, "/q": "std_msgs/String",
             "/b/labrob/camera/image_raw/compressed": bags.COMPRESSED,
             "/x/experiment": "std_msgs/String", "/x/joint_states": bags.JOINTS,
             "/y/joints": bags.JOINTS, "/a/other": bags.IMAGE}  # fmt: skip
    found = bags.find_topics(kinds)
    assert (found.info, found.image) == ("/a/camera_info", "/a/image_raw")
    assert (found.state, found.report, found.joints) == ("/x/s", "", "/x/joint_states")
    assert found.experiment == "/x/experiment"
    found = bags.find_topics({**kinds, "/b/labrob/camera/camera_info": bags.INFO})
    assert found.info == "/b/labrob/camera/camera_info"
    assert found.image == "/b/labrob/camera/image_raw/compressed"
    pictures = {topic: kind for topic, kind in kinds.items() if kind != bags.IMAGE}
    found = bags.find_topics({**pictures, "/b/labrob/camera/camera_info": bags.INFO})
    assert found.image == "/b/labrob/camera/image_raw/compressed"
