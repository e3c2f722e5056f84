"""Topics of motion and force sensors: every message field, names and frames."""

import sys

import genpy.message
import numpy as np
import pytest
import roslib.message
from gazebo_msgs.msg import ContactsState, ContactState
from genpy import Time
from geometry_msgs import msg as geo
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Header

from aras_sim_bridge import sensors
from aras_sim_bridge.description import SensorDescription, parse_urdf
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.sensors import SensorTopic
from aras_visual_servo_base import poses

STAMP = 3_000_000_004
HEAD = Header(1, Time(3, 4), "lens")
TURN = (0.5, -0.5, 0.1, 0.7)
RIG = """<robot name="rig"><link name="arm"/><link name="hand"/>
  <joint name="wrist" type="fixed"><parent link="arm"/><child link="hand"/></joint></robot>"""


@pytest.fixture
def sensor(thread):
    simulation = thread.simulation
    model = thread.call(lambda: simulation.spawn(parse_urdf(RIG), "rig"))

    def make(kind: str, topic: str = "t", **more: object) -> sensors.PeriodicSensor:
        settings = SensorDescription(kind, topic, **{"link": "hand", "joint": "wrist", **more})
        return thread.call(lambda: sensors.KINDS[kind](settings, model, simulation.world, 0))

    return make


def diagonal(size: int, value: float) -> list[float]:
    return (value * np.eye(size)).ravel().tolist()


def touch(k: float) -> sensors.ContactPoint:
    return sensors.ContactPoint(
        (k, k + 1, k + 2),
        (k + 3, k + 4, k + 5),
        k + 6,
        (k + 7, k + 8, k + 9),
        (k + 10, 2 * k, 3 * k))


def wrench(*numbers: float) -> geo.Wrench:
    return geo.Wrench(geo.Vector3(*numbers[:3]), geo.Vector3(*numbers[3:]))


TOUCHES = {("a::b::c", "d::e::f"): [touch(1.0), touch(20.0)], ("a::g::h", "i::j::k"): [touch(7.0)]}
INFO = "Debug:  i:({}/2)     my geom:{}   other geom:{}         time:3.000000004\n"
IMU_READING = sensors.ImuReading(STAMP, TURN, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
xyz = geo.Vector3
IMU = Imu(HEAD, geo.Quaternion(*TURN), diagonal(3, 0.25), xyz(1, 2, 3), diagonal(3, 0.25),
          xyz(4, 5, 6), diagonal(3, 0.25))


@pytest.mark.parametrize(("kind", "reading", "message"), [
    ("pose", sensors.PoseReading(STAMP, poses.Pose((1.0, 2.0, 3.0), TURN),
                                 poses.Twist((4.0, 5.0, 6.0), (7.0, 8.0, 9.0))),
     Odometry(HEAD, "hand",
              geo.PoseWithCovariance(geo.Pose(geo.Point(1, 2, 3), geo.Quaternion(*TURN)),
                                     diagonal(6, 0.25)),
              geo.TwistWithCovariance(geo.Twist(xyz(4, 5, 6), xyz(7, 8, 9)), diagonal(6, 0.25)))),
    ("imu", IMU_READING, IMU), ("body_imu", IMU_READING, IMU),
    ("wrench", sensors.WrenchReading(STAMP, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)),
     geo.WrenchStamped(HEAD, wrench(1, 2, 3, 4, 5, 6))),
    ("joint_states", sensors.JointStateReading(STAMP, ("j", "k"), (1.0, 2.0), (3.0, 4.0)),
     JointState(HEAD, ["j", "k"], [1.0, 2.0], [3.0, 4.0], [])),
    ("contact", sensors.ContactReading(STAMP, TOUCHES), ContactsState(HEAD, [
        ContactState(
            INFO.format(0, "a::b::c", "d::e::f"), "a::b::c", "d::e::f",
            [wrench(8, 9, 10, 11, 2, 3), wrench(27, 28, 29, 30, 40, 60)],
            wrench(35, 37, 39, 41, 42, 63), [xyz(1, 2, 3), xyz(20, 21, 22)],
            [xyz(4, 5, 6), xyz(23, 24, 25)], [7, 26]),
        ContactState(
            INFO.format(1, "a::g::h", "i::j::k"), "a::g::h", "i::j::k",
            [wrench(14, 15, 16, 17, 14, 21)], wrench(14, 15, 16, 17, 14, 21), [xyz(7, 8, 9)],
            [xyz(10, 11, 12)], [13])]))])
def test_a_reading_is_told_in_every_field_while_somebody_listens(
    graph, thread, sensor, kind, reading, message
):
    told = sensor(kind, frame="lens", noise=0.5)
    topic = SensorTopic(told, thread)
    assert graph.told() == {"/t": (type(message), 1, False)}
    thread.call(lambda: None)
    assert told.on_state is None
    (listener,) = graph.listen("/t")
    thread.call(lambda: None)
    told.on_state(reading)
    told.on_state(reading)
    for seq in (1, 2):  # what the first message held is not told again
        size = int.from_bytes(listener.heard.recv(4), "little")
        message.header.seq = seq
        assert type(message)().deserialize(listener.heard.recv(size)) == message
    topic.shutdown()
    thread.call(lambda: None)
    assert told.on_state is None and not graph.publishers


@pytest.mark.parametrize(("given", "topic", "frame"), [
    ({"topic": "imu", "namespace": None}, "/rig/imu", "hand"), ({"topic": "imu"}, "/imu", "hand"),
    ({"topic": "imu", "namespace": "/a/b/", "frame": "/lens"}, "/a/b/imu", "x/lens"),
    ({"topic": "/imu", "namespace": "a"}, "/imu", "x/hand"),
    ({"wrench_frame": "parent"}, "/t", "arm"), ({"wrench_frame": "sensor"}, "/t", "hand"),
    ({"wrench_frame": "parent", "frame": "lens"}, "/t", "lens")])
def test_names_and_frames(graph, thread, sensor, given, topic, frame):
    graph.parameters["/a/tf_prefix"] = "x"
    one = sensor("wrench", **given)
    SensorTopic(one, thread)
    (listener,) = graph.listen(topic)
    thread.call(lambda: None)
    one.on_state(sensors.WrenchReading(1, (0.0,) * 3, (0.0,) * 3))
    assert geo.WrenchStamped().deserialize(listener.heard.recv(999)[4:]).header.frame_id == frame


def test_a_package_that_is_not_installed_is_named(graph, thread, sensor, monkeypatch):
    for module in (genpy.message, roslib.message):
        monkeypatch.setattr(module, "_message_class_cache", {}, raising=False)
    for name in ("nav_msgs", "nav_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(SimError, match="nav_msgs/Odometry is not .* install python3-nav-msgs"):
        SensorTopic(sensor("pose"), thread)
