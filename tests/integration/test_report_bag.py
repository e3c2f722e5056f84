"""Reading of bags with real message types: the run is equal to the recorded one."""

from __future__ import annotations

import json
import re
from pathlib import Path

import genpy.dynamic
import numpy as np
import pytest
import rosbag
import rospy
import yaml
from aras_visual_servo_camera.msg import ImageMoments
from aras_visual_servo_controller.msg import ServoState
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.errors import BenchError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.metrics.summary import summarise
from aras_visual_servo_bench.recording.image_tracks import compute_tracks
from aras_visual_servo_bench.ros.bag import read_bag
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.web.report.write import write_report
from aras_visual_servo_camera.camera_model import normalise_pixels
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.ros.messages import make_report_message, make_state_message

NAMESPACE = "/aras_visual_servo"
ROOT = Path(__file__).resolve().parents[2]


def transform(parent, child, pose, stamp):
    """TransformStamped of a (4, 4) whose rotation is no half turn."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = pose[:3, 3]
    R = pose[:3, :3]
    w = 0.5 * np.sqrt(max(1.0 + np.trace(R), 1e-12))
    rotation.w = w
    rotation.x, rotation.y, rotation.z = (
        np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4.0 * w)
    )
    return message


def description():
    """Return the description that the node `describe` publishes for a run of the demo."""
    urdf = (ROOT / "src/aras_visual_servo_gazebo/robots/aras_visual_servo.urdf").read_text()
    goal = ROOT / "src/aras_visual_servo_controller/config/goal_2016.yaml"
    return {
        "format": 1, "controller": "/aras_visual_servo_controller",
        "parameters": {
            "robot_description": urdf, "gazebo": {"seed": 7},
            "aras_visual_servo_controller": {
                "scheme": "moments", "start": 2016, "desired": "auto", "gain": 4.0, "listeners": 2,
                "smoothing": 0.02, "gains": {"gain": 4.0},
            },
        },
        "launch": [["-p", "11311", "aras_visual_servo_gazebo", "aras_visual_servo.launch",
                    "camera:=fisheye", "camera_xyz:=0 0.03 0"]],
        "goals": {goal.name: goal.read_text()}, "versions": {"numpy": "2"},
    }  # fmt: skip


def write_run(path, seconds=3.0, described=False, goals=()):
    """Record a run of the runner as the recorder would; returns run, arm, last joints."""
    experiment = Experiment(plant="chain", start="2016", duration=seconds,
        time_after_convergence=None,
                            controller_parameters={"smoothing": 0.05})  # fmt: skip
    loop = Loop(experiment, assemble(experiment))
    arm = loop.plant.arm
    # The camera hangs upside down: split its turn, for a half turn has no unique small quaternion.
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    link_T_optical = np.eye(4)
    link_T_optical[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    seen = []
    while (state := loop.run_to_image()) is not None:
        camera = loop.parts.calibrated_camera
        outline = normalise_pixels(loop.reading.outline, camera, camera, is_closed=True)
        seen.append((state, loop.plant.read_joints()[0], outline))

    with rosbag.Bag(str(path), "w", chunk_threshold=20_000) as bag:
        half = transform("base_link", "upside_down", np.eye(4), rospy.Time(1))
        half.transform.rotation.x, half.transform.rotation.w = 1.0, 0.0
        optical = transform("camera_link", "camera_optical_frame", link_T_optical, rospy.Time(1))
        bag.write("/tf_static", TFMessage([half, optical]), rospy.Time(1))
        if described:
            told = description()
            told["goals"].update(goals)
            text = String(json.dumps(told))
            bag.write(f"{NAMESPACE}/experiment", text, rospy.Time(1))
        for seen_state, q, outline in seen:
            stamp = seen_state.stamp
            time = rospy.Time.from_sec(1.0 + stamp)
            later = rospy.Time.from_sec(1.004 + stamp)

            joints = JointState(name=[*arm.names[1:], "gantry"], position=[*q[1:], q[0]])
            joints.header.stamp = time
            bag.write(f"{NAMESPACE}/joint_states", joints, later)

            pose = flip @ arm.pose(q) @ np.linalg.inv(link_T_optical)
            bag.write(
                "/tf", TFMessage([transform("upside_down", "camera_link", pose, time)]), later
            )

            info = CameraInfo(width=4, height=2, K=[100.0, 0, 160, 0, 100, 120, 0, 0, 1],
                              D=[0.0] * 4, distortion_model="equidistant")
            bag.write("/labrob/camera/camera_info", info, later)
            image = Image(encoding="rgb8", width=4, height=2, step=12, data=bytes(range(24)))
            image.header.stamp = time
            bag.write("/labrob/camera/image_raw", image, later)

            moments = ImageMoments(valid=True, order=4)
            moments.header.stamp = time
            measured = Moments.from_polygon(outline, 4)
            moments.m = measured.m_array.tolist()
            moments.mu = measured.mu_array.tolist()
            bag.write(f"{NAMESPACE}/camera/moments", moments, later)

            state = make_state_message(seen_state, "moments", "camera_optical_frame", arm.names)
            report = make_report_message(seen_state, "camera_optical_frame", arm.names)
            state.header.stamp = report.header.stamp = time
            bag.write(f"{NAMESPACE}/controller/state", state, later)
            bag.write(f"{NAMESPACE}/controller/diagnosis", report, later)
    return loop.make_run(), arm, seen[-1][1]


def test_a_described_bag_tells_what_the_run_itself_tells(tmp_path):
    path = tmp_path / "run.bag"
    result, *_ = write_run(path, described=True)
    record = read_bag(path)
    assert record.notes == []
    # In units of the goal's distance, some 0.2 m.
    assert record.tolerances == pytest.approx((0.0005, 0.0005, 0.001, 0.005), rel=0.05)
    assert record.joint_units == ("m", *("rad",) * 5)
    np.testing.assert_allclose(record.speed_limits, [1.0, 2.0, 2.0, 2.0, 2.0, 2.0])
    assert record.verdict.name == result.verdict.name == "goal_reached"
    assert record.verdict.distance == pytest.approx(result.verdict.distance, abs=1e-6)
    # To the printed digits, from the first image on.
    found = {q.key: q for q in summarise(record)}
    own = {q.key: q for q in summarise(result)}
    for key in ("error_settled", "decay_rate", "overshoot", "final_error_xn", "worst_error_alpha",
                "servoing_time", "top_speed"):  # fmt: skip
        assert found[key].value_text == own[key].value_text, key
    assert found["settled"].value == pytest.approx(result.compute_settling_time(), abs=0.04)
    found = compute_tracks(record)
    assert found.names[-1] == "centre of gravity"
    np.testing.assert_allclose(found.pixels[-1], found.desired, atol=0.5)


def test_a_bag_shows_its_experiment_and_what_it_was_made_of(tmp_path, capsys):
    path, out = tmp_path / "run.bag", tmp_path / "shown"
    write_run(path, described=True)
    assert main(["show", str(path), "--out", str(out)]) == 0
    told = yaml.safe_load(capsys.readouterr().out)
    experiment = Experiment.from_mapping(told)
    assert (experiment.scheme, experiment.start, experiment.camera) == (
        "moments", "2016", "fisheye")
    assert experiment.camera_xyz == (0.0, 0.03, 0.0) and experiment.seed == 7
    assert experiment.gain == 4.0 and experiment.controller_parameters == {"smoothing": 0.02}
    assert Experiment.from_yaml(out / "experiment.yaml") == Experiment.from_mapping(told)
    assert (out / "robot.urdf").read_text() == description()["parameters"]["robot_description"]
    assert (out / "goal_2016.yaml").is_file()
    assert "camera:=fisheye" in (out / "launch.txt").read_text()
    kept = yaml.safe_load((out / "parameters.yaml").read_text())
    assert kept["aras_visual_servo_controller"]["gain"] == 4.0
    write_run(path)
    assert main(["show", str(path)]) == 1
    assert "older version" in capsys.readouterr().err


def test_no_name_in_a_bag_leads_out_of_the_folder(tmp_path, capsys):
    path, out = tmp_path / "run.bag", tmp_path / "deep" / "shown"
    hostile = {"../stolen.yaml": "a", str(tmp_path / "there.yaml"): "b", "..": "c", "a/b.yaml": "d",
               "\n.yaml": "e", "experiment.yaml": "f", "robot.urdf": "g", ".bashrc": "h"}
    write_run(path, described=True, goals=hostile)
    assert main(["show", str(path), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert said.count("is omitted: it is not a file name") == 7
    assert "# the goal '../stolen.yaml' is omitted" in said
    assert {p.name for p in out.iterdir()} == {
        "experiment.yaml", "goal_2016.yaml", "launch.txt", "parameters.yaml", "robot.urdf",
        "versions.txt"}  # fmt: skip
    assert {p.name for p in tmp_path.iterdir()} == {"run.bag", "deep"}
    assert "scheme" in yaml.safe_load((out / "experiment.yaml").read_text())


def test_foxgloves_own_reader_reads_the_conversion(tmp_path, capsys):
    """Every message of the bag, bit for bit, through the reference implementation of MCAP."""
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros1.decoder")
    path = tmp_path / "run.bag"
    write_run(path)
    with rosbag.Bag(str(path)) as bag:
        written = [(t, raw[1], time.to_nsec()) for t, raw, time in bag.read_messages(raw=True)]
        sums = {raw[2] for _, raw, _ in bag.read_messages(raw=True)}
    path = cut_off(path, 1.0)
    assert main(["convert", str(path)]) == 0
    out = tmp_path / f"{path.name.split('.')[0]}.mcap"
    assert f"{out}: {len(written)} messages of 8 topics" in capsys.readouterr().out
    with out.open("rb") as stream:
        made = reader.make_reader(stream, validate_crcs=True,
                                  decoder_factories=[decoder.DecoderFactory()])  # fmt: skip
        assert made.get_header().profile == "ros1"
        summary = made.get_summary()
        assert summary.statistics.message_count == len(written)
        assert summary.statistics.message_start_time == min(time for *_, time in written)
        assert summary.statistics.message_end_time == max(time for *_, time in written)
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        assert {c.metadata["md5sum"] for c in summary.channels.values()} == sums
        assert [m.name for m in made.iter_metadata()] == ["bag"]
        read = [(c.topic, m.data, m.log_time) for _, c, m in made.iter_messages()]
        assert sorted(read) == sorted(written)
        decoded = {c.topic: d for _, c, _, d in made.iter_decoded_messages()}
        assert decoded["/labrob/camera/camera_info"].distortion_model == "equidistant"
        assert decoded[f"{NAMESPACE}/controller/state"].phase == "converged"
        # By its index: a second of one topic.
        start = written[0][2] + 1_000_000_000
        part = list(made.iter_messages([f"{NAMESPACE}/joint_states"], starting_at=start,
                                       ending_before=start + 10**9))
        assert 29 <= len(part) <= 31 and all(start <= m.log_time for _, _, m in part)


def messages(path):
    with rosbag.Bag(str(path)) as bag:
        return list(bag.read_messages())


def later(message, seconds):
    """Return the message with all stamps shifted."""
    for part in (message, *getattr(message, "transforms", ())):
        if hasattr(part, "header"):
            part.header.stamp += rospy.Duration.from_sec(seconds)
    return message


def test_of_several_runs_the_last_is_told(tmp_path):
    once, path = tmp_path / "once.bag", tmp_path / "twice.bag"
    write_run(once, described=True)
    whole = messages(once)
    with rosbag.Bag(str(path), "w") as bag:
        for topic, message, time in whole:
            bag.write(topic, message, time)
        state = ServoState(phase="approaching")
        state.header.stamp = rospy.Time.from_sec(8.0)
        bag.write(f"{NAMESPACE}/controller/state", state, rospy.Time.from_sec(8.0))
        for topic, message, time in whole:
            after = time + rospy.Duration.from_sec(10.0)
            bag.write(topic, later(message, 10.0), after)
    record, single = read_bag(path), read_bag(once)
    assert any("has 2 runs" in note for note in record.notes)
    assert not any("clock was reset" in note for note in record.notes)
    np.testing.assert_allclose(record.stamp, single.stamp + 10.0)
    found, own = ({q.key: q.value_text for q in summarise(one)} for one in (record, single))
    for key in ("outcome", "settled", "error_settled", "final_error_xn", "path_ratio"):
        assert found.get(key) == own.get(key), key


def cut_off(bag, kept):
    """The first part of a bag, as a recorder leaves it that was killed."""
    data = bytearray(bag.read_bytes())
    # It writes where its index is when it closes the bag.
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = bytes(8)
    cut = bag.with_name("cut.bag.active")
    cut.write_bytes(data[: int(kept * len(data))])
    return cut


def test_of_a_bag_that_was_cut_off_is_told_what_is_there(tmp_path):
    whole = tmp_path / "whole.bag"
    write_run(whole)
    there, kept = len(read_bag(whole).stamp), 0.6
    cut = cut_off(whole, kept)
    before = cut.read_bytes()
    record = read_bag(cut)
    assert "was not closed" in record.notes[0]
    assert 0.5 * kept * there < len(record.stamp) <= there
    assert cut.read_bytes() == before  # nothing is done to the file
    assert write_report([record], tmp_path / "out", ())[0].is_file()


def of_another_version(source, target, topic, without):
    """A copy of a bag in which the messages of a topic were defined without a field."""
    definition, older = "", None
    with rosbag.Bag(str(source)) as there, rosbag.Bag(str(target), "w") as copy:
        for name, message, time in there:
            if name == topic:
                if older is None:
                    definition = re.sub(rf"^\S+ +{without}\b.*\n", "", message._full_text,
                                        flags=re.MULTILINE)  # fmt: skip
                    assert definition != message._full_text
                    older = genpy.dynamic.generate_dynamic(message._type, definition)[message._type]
                message = older(*(getattr(message, field) for field in older.__slots__))
            copy.write(name, message, time)
    return target


def test_a_bag_of_another_version_is_named_or_told_without_what_it_lacks(tmp_path):
    whole = tmp_path / "whole.bag"
    write_run(whole)
    state, report = f"{NAMESPACE}/controller/state", f"{NAMESPACE}/controller/diagnosis"
    without = of_another_version(whole, tmp_path / "a.bag", state, "desired_features")
    with pytest.raises(BenchError, match=f"{state} has another version .* without desired_f"):
        read_bag(without)
    without = of_another_version(whole, tmp_path / "b.bag", report, "manipulability")
    record = read_bag(without)
    assert f"{report} has another version" in "".join(record.notes)
    assert not np.isfinite(record.scale).any()
    assert record.stamp == pytest.approx(read_bag(whole).stamp)
    # What was added later and is not needed is not missed.
    without = of_another_version(whole, tmp_path / "c.bag", report, "filtered_error")
    record = read_bag(without)
    assert not any("another version of" in note for note in record.notes)
    assert np.isfinite(record.scale).any()


def test_bags_that_cannot_be_reported_on_are_named(tmp_path):
    broken = tmp_path / "broken.bag"
    for content in (b"#ROSBAG V2.0\n" + b"\0" * 50, b"\x89PNG"):
        broken.write_bytes(content)
        with pytest.raises(BenchError, match="cannot read the bag .*broken.bag"):
            read_bag(broken)
    waiting = tmp_path / "waiting.bag"
    with rosbag.Bag(str(waiting), "w") as bag:
        state = ServoState(phase="waiting", reason="no image on /labrob/camera")
        bag.write(f"{NAMESPACE}/controller/state", state, rospy.Time(1))
    with pytest.raises(BenchError, match="last phase is waiting: no image on /labrob/camera"):
        read_bag(waiting)
