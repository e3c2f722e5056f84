"""Motion and force sensors: values at rest and in motion, times, and noise."""

import math

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base.poses import Pose, Twist

MS = 1_000_000
G = 9.8
TILTED = Pose.from_rpy((0.3, -0.2, 2.0), (0.4, -0.5, 0.6))
# A joint that swings, turned and off its link's masses, with a tool fixed on what it moves.
ARM = """<robot name="arm"><link name="world"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0 0 1" rpy="0.2 0.1 -0.3"/></joint>
  <link name="base"><inertial><mass value="5"/>{I}</inertial></link>
  <joint name="swing" type="{kind}"><parent link="base"/><child link="upper"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.5 -0.4 0.3"/><axis xyz="0.36 0.48 0.8"/>
    <limit lower="-9" upper="9" effort="99" velocity="99"/>{dynamics}</joint>
  <link name="upper"><inertial><origin xyz="0.1 -0.05 -0.2" rpy="0.3 0 0.2"/><mass value="2"/>
    <inertia ixx=".03" iyy=".02" izz=".04" ixy=".002" ixz="0" iyz="-.003"/></inertial></link>
  <joint name="flange" type="fixed"><parent link="upper"/><child link="tool"/>
    <origin xyz="0.05 0.1 -0.4" rpy="0.7 0.2 -0.1"/></joint>
  <link name="tool"><inertial><origin xyz="0.02 0.01 -0.03"/><mass value="0.7"/>
    <inertia ixx=".001" iyy=".002" izz=".003" ixy="0" ixz="0" iyz="0"/></inertial></link>
  {tags}</robot>"""
INERTIA = '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'
BLOCK = f"""<robot name="block"><link name="link"><inertial><origin xyz="0.1 0 0"/>
  <mass value="3"/>{INERTIA}</inertial></link>{{tags}}</robot>"""


def arm(kind="revolute", dynamics="", tags=""):
    return ARM.format(I=INERTIA, kind=kind, dynamics=dynamics, tags=tags)


def plugin(name, settings):
    inside = "".join(f"<{key}>{value}</{key}>" for key, value in settings.items())
    return f'<gazebo><plugin name="p" filename="libgazebo_ros_{name}.so">{inside}</plugin></gazebo>'


def wrench_of(joint, **settings):
    return plugin("ft_sensor", {"topicName": "w", "jointName": joint, **settings})


def imu_on(link, pose="0 0 0 0 0 0", inside="", rate=0, **settings):
    told = {"frameName": "f", "updateRateHZ": 0, **settings}
    words = "".join(f"<{key}>{value}</{key}>" for key, value in told.items())
    return (f'<gazebo reference="{link}"><sensor type="imu" name="i"><pose>{pose}</pose>'
            f'<update_rate>{rate}</update_rate><imu>{inside}</imu><plugin name="p" '
            f'filename="libgazebo_ros_imu_sensor.so">{words}</plugin></sensor></gazebo>')


@pytest.fixture
def make():
    """(simulation, model, readings of each of its sensors) of a URDF."""
    made = []

    def simulate(xml, pose=TILTED, ground=False, joints=None, seed=0):
        simulation = Simulation(SimulationConfig(ground_plane=ground, seed=seed))
        made.append(simulation)
        description = parse_urdf(xml)
        assert description.warnings == ()
        model = simulation.spawn(description, "m", pose, joint_positions=joints)
        readings = [[] for _ in simulation.sensors]
        for sensor, found in zip(simulation.sensors, readings, strict=True):
            sensor.on_state = found.append
        return simulation, model, readings

    yield simulate
    for simulation in made:
        simulation.close()


def steps(simulation, count):
    for _ in range(count):
        simulation.step()


def turned(pose, vector):
    """A vector of the world in a pose's axes."""
    return pose.matrix()[:3, :3].T @ vector


@pytest.mark.parametrize("ground", [False, True])
def test_a_pose_is_that_of_link_states_to_the_bit(make, ground):
    tags = plugin("p3d", {"bodyName": "tool", "topicName": "t"})
    simulation, model, (readings,) = make(arm(tags=tags), ground=ground)
    model.set_joint_positions({"swing": 0.4})
    steps(simulation, 50)
    for _ in range(20):
        simulation.step()
        pose, twist = model.link_states()["tool"]
        assert readings[-1].pose == pose and readings[-1].twist == twist
        assert readings[-1].stamp_ns == simulation.time_ns
    assert math.hypot(*twist.linear) > 0.1


def test_a_pose_in_a_frame_that_moves_and_with_an_offset(make):
    tags = plugin("p3d", {"bodyName": "tool", "topicName": "t", "frameName": "upper"})
    tags += plugin("p3d", {"bodyName": "tool", "topicName": "u", "xyzOffset": "1 2 3",
                           "rpyOffset": "0 0 1.5707963267948966"})
    tags += plugin("p3d", {"bodyName": "base", "topicName": "v", "frameName": "tool"})
    simulation, model, readings = make(arm(tags=tags))
    steps(simulation, 50)
    inside, offset, back = (one[-1] for one in readings)
    (tool, moving), base = model.link_state("tool"), model.link_pose("base")
    assert back.twist.angular == pytest.approx(-turned(tool, moving.angular))
    assert back.twist.linear == pytest.approx(-turned(tool, np.add(
        moving.linear, np.cross(moving.angular, np.subtract(base.xyz, tool.xyz)))))
    np.testing.assert_allclose(inside.pose.matrix(), Pose.from_rpy(
        (0.05, 0.1, -0.4), (0.7, 0.2, -0.1)).matrix(), atol=1e-12)
    np.testing.assert_allclose(inside.twist, np.zeros((2, 3)), atol=1e-12)
    turn = Pose.from_rpy((0, 0, 0), (0, 0, math.pi / 2))
    assert offset.pose.xyz == pytest.approx(np.add(tool.xyz, (1, 2, 3)))
    np.testing.assert_allclose(offset.pose.matrix()[:3, :3],
                               turn.matrix()[:3, :3] @ tool.matrix()[:3, :3], atol=1e-12)


def test_an_imu_at_rest_feels_what_holds_it_up(make):
    tags = imu_on("base", "0.1 0.2 0.3 0.4 0.5 0.6") + plugin(
        "imu", {"bodyName": "base", "topicName": "b"})
    tags += imu_on("base", initialOrientationAsReference=1, rpyOffset="0 0 0.5")
    tags += imu_on("base", rpyOffset="0 0 0.5")
    simulation, model, readings = make(arm("fixed", tags=tags))
    steps(simulation, 5)
    felt, from_start, offset, bare = (one[-1] for one in readings)
    base = model.link_pose("base")
    held = base @ Pose.from_rpy((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
    assert felt.linear_acceleration == pytest.approx(turned(held, (0, 0, G)), abs=1e-12)
    assert felt.angular_velocity == (0, 0, 0)
    assert felt.orientation == pytest.approx(held.quat)
    assert bare.linear_acceleration == (0, 0, 0)  # upstream's tells no gravity there
    assert bare.orientation == pytest.approx(base.quat)
    turn = Pose.from_rpy((0, 0, 0), (0, 0, 0.5))
    assert from_start.orientation == pytest.approx(turn.quat)
    assert offset.orientation == pytest.approx((turn @ Pose((0, 0, 0), base.quat)).quat)


def test_an_imu_in_free_fall_and_its_mean_over_its_own_period(make):
    """Off the centre of mass of a body that turns about it: the centripetal acceleration."""
    tags = imu_on("link", "0.3 0 0 0 0 0.8")
    simulation, model, (readings,) = make(BLOCK.format(tags=tags), pose=Pose((0, 0, 50)))
    model.set_twist(Twist((0, 0, 0), (0, 0, 4.0)))
    steps(simulation, 3)
    pose = model.link_pose("link") @ Pose.from_rpy((0.3, 0, 0), (0, 0, 0.8))
    inwards = -16.0 * 0.2 * model.link_pose("link").matrix()[:3, 0]
    assert readings[-1].linear_acceleration == pytest.approx(turned(pose, inwards), abs=0.01)
    assert readings[-1].angular_velocity == pytest.approx((0, 0, 4.0), abs=1e-9)
    tags = imu_on("link", rate=100, updateRateHZ=10)
    simulation, model, (readings,) = make(BLOCK.format(tags=tags), pose=Pose((0, 0, 50)))
    velocities = {0: 0.0}
    for k in range(1, 251):
        if k > 150:
            model.apply_force("link", (60.0 * math.sin(k / 3.0), 0, 0),
                              model.link_pose("link").apply((0.1, 0, 0)))
        simulation.step()
        velocities[k] = model.link_twist("link").linear[0]
    assert [r.stamp_ns // MS for r in readings] == [100, 200]
    mean = (velocities[200] - velocities[190]) / 0.01
    assert abs(mean) > 1.0
    assert readings[-1].linear_acceleration[0] == pytest.approx(mean, abs=1e-9)


def distal(model, joint):
    """Weight (N), and its moment about the joint's origin, of what hangs there, world axes."""
    links = ("upper", "tool") if joint == "swing" else ("tool",)
    origin = model.link_pose(links[0]).xyz
    force, torque = np.zeros(3), np.zeros(3)
    for link in links:
        inertial = model.description.links[link].inertial
        weight = np.array([0, 0, -G * inertial.mass])
        centre = model.link_pose(link).apply(inertial.origin_xyz)
        force += weight
        torque += np.cross(np.subtract(centre, origin), weight)
    return force, torque


@pytest.mark.parametrize("joint", ["swing", "flange"])
@pytest.mark.parametrize(("frame", "direction", "pose"), [
    (None, None, ""), ("child", "parent_to_child", ""), ("parent", "child_to_parent", ""),
    ("sensor", "parent_to_child", "<pose>9 9 9 0.3 0.2 0.1</pose>")])
def test_a_wrench_at_rest_is_the_weight_of_what_hangs_there(make, joint, frame, direction, pose):
    tags = wrench_of(joint) + (
        f'<gazebo reference="{joint}"><sensor name="s" type="force_torque">{pose}<force_torque>'
        f"<frame>{frame}</frame><measure_direction>{direction}</measure_direction></force_torque>"
        "</sensor></gazebo>" if frame else "")
    simulation, model, (readings,) = make(
        arm(dynamics='<dynamics friction="50"/>', tags=tags), joints={"swing": 0.7})
    steps(simulation, 20)
    parent, child = ("base", "upper") if joint == "swing" else ("upper", "tool")
    axes = model.link_pose(parent if frame == "parent" else child)
    if frame == "sensor":
        axes = axes @ Pose.from_rpy((9, 9, 9), (0.3, 0.2, 0.1))
    sign = -1.0 if direction == "parent_to_child" else 1.0
    force, torque = distal(model, joint)
    assert readings[-1].force == pytest.approx(sign * turned(axes, force), abs=1e-3)
    assert readings[-1].torque == pytest.approx(sign * turned(axes, torque), abs=1e-3)


def test_a_wrench_contains_what_is_applied_to_the_tool(make):
    simulation, model, (readings,) = make(arm("fixed", tags=wrench_of("flange")))
    steps(simulation, 3)
    still = readings[-1]
    pose = model.link_pose("tool")
    point = pose.apply((0.0, 0.0, 0.5))
    model.apply_force("tool", (3.0, -2.0, 1.0), point, (0.1, 0.2, 0.3))
    # What acts on the other side is not felt.
    model.apply_force("upper", (-1.0, 4.0, 2.0), point, (0.3, 0.1, -0.2))
    simulation.step()
    force, torque = turned(pose, (3.0, -2.0, 1.0)), turned(pose, (0.1, 0.2, 0.3))
    assert np.subtract(readings[-1].force, still.force) == pytest.approx(force)
    assert np.subtract(readings[-1].torque, still.torque) == pytest.approx(
        torque + np.cross((0, 0, 0.5), force))
    simulation.step()
    assert readings[-1].force == pytest.approx(still.force)


def test_a_wrench_contains_what_the_ground_bears_of_it(make):
    """Of two feet on which a body stands; the other one's load is not felt."""
    feet = "".join(f"""<joint name="{side}" type="fixed"><parent link="body"/>
      <child link="{side}_foot"/><origin xyz="0.01 {y} -0.3"/></joint><link name="{side}_foot">
      <inertial><mass value="1.5"/>{INERTIA}</inertial><collision><geometry>
      <box size="0.2 0.01 0.1"/></geometry></collision></link>{wrench_of(side)}"""
                   for side, y in (("left", 0.2), ("right", -0.2)))
    simulation, model, readings = make(f"""<robot name="stack"><link name="body"><inertial>
      <origin xyz="0.01 0.1 0"/><mass value="4"/>{INERTIA}</inertial></link>{feet}</robot>""",
                                   pose=Pose((0, 0, 0.351)), ground=True)
    steps(simulation, 400)
    left, right = (np.mean([r.force for r in one[-200:]], axis=0) for one in readings)
    # The moment about the feet's line: 0.1 m of 0.2 m to the left.
    assert left[2] == pytest.approx(3 * G, abs=1.0) and right[2] == pytest.approx(G, abs=1.0)
    assert np.add(left, right) == pytest.approx((0, 0, 4 * G), abs=0.02)
    for _ in range(60):  # and the friction that holds it against a push
        model.apply_force("body", (4.0, -3.0, 0.0), model.link_pose("body").xyz, (0, 0, 0))
        simulation.step()
    held = np.sum([np.mean([r.force for r in one[-40:]], axis=0) for one in readings], axis=0)
    assert held == pytest.approx((-4.0, 3.0, 4 * G), abs=0.2)


@pytest.mark.parametrize(("rate", "expected"), [
    (0, list(range(2, 101))), (100, list(range(10, 101, 10))), (30, [34, 67, 100])])
def test_readings_come_at_the_first_tick_of_each_period(make, rate, expected):
    tags = plugin("p3d", {"bodyName": "tool", "topicName": "t", "updateRate": rate})
    simulation, _, (readings,) = make(arm(tags=tags))
    (sensor,) = simulation.sensors
    for _ in range(2):
        readings.clear()
        for _ in range(100):
            idle_ns, count = sensor.idle_until_ns, len(readings)
            simulation.step()
            assert len(readings) == count or simulation.time_ns > idle_ns
        assert [r.stamp_ns // MS for r in readings] == expected
        simulation.reset_simulation()
    sensor.on_state = None
    steps(simulation, 105)
    assert not sensor.enabled
    readings.clear()
    sensor.on_state = readings.append  # who looks again begins with the next period
    steps(simulation, 95)
    assert [r.stamp_ns // MS - 100 for r in readings] == [at for at in expected if at > 6]


NOISE = ("<angular_velocity><y><noise type='gaussian'><mean>0.1</mean><stddev>0.02</stddev></noise>"
         "</y></angular_velocity><linear_acceleration><z><noise type='gaussian'><mean>0</mean>"
         "<stddev>0.5</stddev><bias_mean>2</bias_mean><bias_stddev>0.001</bias_stddev></noise></z>"
         "</linear_acceleration>")


def test_noise_is_as_asked_for_and_depends_on_seed_and_stamp_alone(make):
    def told(seed, inside=NOISE, count=801, **settings):
        tags = imu_on("base", inside=inside, **settings)
        simulation, _, (readings,) = make(arm("fixed", tags=tags), Pose(), seed=seed)
        steps(simulation, count)
        return np.array([(*r.angular_velocity, *r.linear_acceleration) for r in readings])

    first = told(1)
    base = turned(Pose.from_rpy((0, 0, 0), (0.2, 0.1, -0.3)), (0, 0, G))
    off = first - [0, 0, 0, *base]
    assert abs(off[:, [0, 2, 3, 4]]).max() < 1e-12
    assert off[:, 1].mean() == pytest.approx(0.1, abs=0.002)
    assert off[:, 1].std() == pytest.approx(0.02, rel=0.06)
    assert abs(off[:, 5].mean()) == pytest.approx(2.0, abs=0.05)
    assert off[:, 5].std() == pytest.approx(0.5, rel=0.06)
    again, other = (told(seed, count=101) for seed in (1, 2))
    assert np.array_equal(first[:len(again)], again) and not np.array_equal(again, other)
    assert {math.copysign(1, told(seed, "<linear_acceleration><x><noise><bias_mean>99</bias_mean>"
                                  "</noise></x></linear_acceleration>", count=2)[0, 3])
            for seed in range(8)} == {-1, 1}
    all_six = told(1, "", gaussianNoise=0.3) - [0, 0, 0, *base]
    assert all_six.std(axis=0) == pytest.approx(np.full(6, 0.3), rel=0.06)
    assert abs(np.corrcoef(all_six.T) - np.eye(6)).max() < 0.15


def bumper_on(link, *collisions, rate=0, **settings):
    words = "".join(f"<{key}>{value}</{key}>" for key, value in settings.items())
    named = "".join(f"<collision>{name}</collision>" for name in collisions)
    return (f'<gazebo reference="{link}"><sensor type="contact" name="c"><update_rate>{rate}'
            f"</update_rate><contact>{named}</contact>"
            f'<plugin name="p" filename="libgazebo_ros_bumper.so">{words}</plugin></sensor>'
            "</gazebo>")


def box(mass=10.0, size="0.4 0.3 0.2", centre="0.05 -0.02 0", tags=""):
    return f"""<robot name="b"><link name="link"><inertial><origin xyz="{centre}"/>
      <mass value="{mass}"/>{INERTIA}</inertial><collision><origin xyz="0 0 0.1"/><geometry>
      <box size="{size}"/></geometry></collision></link>
      <gazebo reference="link"><mu1>0.6</mu1></gazebo>{tags}</robot>"""


def test_a_bumper_tells_the_weight_that_the_ground_bears(make):
    simulation, model, (readings,) = make(box(tags=bumper_on("link", "link_collision")),
                                          Pose.from_rpy((0.3, 0.2, 0.004), (0.0, 0.0, 0.5)), True)
    steps(simulation, 5)
    assert readings[-1].contacts == {}  # near, and no more
    steps(simulation, 400)
    (pair, touches), = readings[-1].contacts.items()
    assert pair == ("m::link::link_collision", "ground_plane::link::collision")
    assert readings[-1].stamp_ns == simulation.time_ns
    forces = np.array([one.force for one in touches])
    assert forces.sum(axis=0) == pytest.approx((0.0, 0.0, 10.0 * G), abs=1e-2)
    # Each about the centre of mass: at rest they cancel, though that is beside the middle.
    assert np.sum([one.torque for one in touches], axis=0) == pytest.approx((0, 0, 0), abs=1e-2)
    centre = model.pose().apply((0.05, -0.02, 0.0))
    for one in touches:
        assert one.normal == pytest.approx((0.0, 0.0, 1.0))
        assert 0.0 < one.depth < 1e-4 and abs(one.position[2]) < 1e-4
        assert one.torque == pytest.approx(np.cross(np.subtract(one.position, centre), one.force))
    assert len(touches) >= 3 and np.abs([one.torque for one in touches]).max() > 1.0


def test_who_touches_is_told_from_both_sides_with_opposite_forces(make):
    bumper = bumper_on("link", "link_collision")
    simulation, model, (readings,) = make(box(tags=bumper), Pose(), True)
    other = simulation.spawn(parse_urdf(box(2.0, "0.1 0.1 0.2", tags=bumper)), "top",
                             Pose((0.02, 0.01, 0.2)))
    above = []
    simulation.sensors[1].on_state = above.append
    steps(simulation, 300)
    names = "m::link::link_collision", "top::link::link_collision"
    assert set(readings[-1].contacts) == {names, (names[0], "ground_plane::link::collision")}
    (touches,) = above[-1].contacts.values()
    for told, up in ((readings[-1].contacts[names], -1.0), (touches, 1.0)):
        total = np.sum([one.force for one in told], axis=0)
        assert total == pytest.approx((0.0, 0.0, up * 2.0 * G), abs=0.02)
        assert all(one.normal == pytest.approx((0.0, 0.0, up), abs=1e-3) for one in told)
    other.set_pose(Pose((2.0, 0.0, 1.0)))
    steps(simulation, 3)
    assert above[-1].contacts == {} and names not in readings[-1].contacts


def test_a_base_with_a_bumper_is_not_held_and_feels_the_ground(make):
    """And only its own collisions', one of which is on a link that is fixed to it."""
    part = '<collision name="{}"><origin xyz="0 0 {}"/><geometry><box size="0.2 0.3 0.1"/>' \
        "</geometry></collision>"
    xml = f"""<robot name="r"><link name="slide"><inertial><mass value="1"/>{INERTIA}</inertial>
      {part.format("high", 0.5)}</link><link name="tip"><inertial><mass value="0.5"/>{INERTIA}
      </inertial>{part.format("low", 0.05)}</link><joint name="at" type="fixed">
      <parent link="slide"/><child link="tip"/></joint><link name="arm"><inertial><mass value="1"/>
      {INERTIA}</inertial></link><joint name="j" type="revolute"><parent link="slide"/>
      <child link="arm"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="9"/>
      </joint>{bumper_on("slide", "slide_fixed_joint_lump__low")}{bumper_on("slide", "high")}
      </robot>"""
    simulation, _, (low, high) = make(xml, Pose(), True)
    steps(simulation, 400)
    (names, touches), = low[-1].contacts.items()
    assert names == ("m::tip::low", "ground_plane::link::collision") and high[-1].contacts == {}
    assert sum(one.force[2] for one in touches) == pytest.approx(2.5 * G, rel=1e-3)


@pytest.mark.parametrize(("tags", "reason"), [
    (plugin("p3d", {"bodyName": "gone", "topicName": "t"}), "link 'gone' does not exist"),
    (plugin("p3d", {"bodyName": "tool"}), "<topicName> is missing"),
    (plugin("p3d", {"bodyName": "tool", "topicName": "t", "frameName": "gone"}),
     "frame 'gone' is neither the world nor a link"),
    (plugin("ft_sensor", {"topicName": "t"}), "joint '' does not exist"),
    (plugin("imu", {"topicName": "t"}), "link '' does not exist"),
    (plugin("imu_sensor", {"frameName": "f"}), "it must be inside <sensor type='imu'>"),
    (bumper_on("tool"), "it names no <collision>"),
    (plugin("bumper", {}), "it names no <collision>"),
    (imu_on("base").replace("frameName", "frame"), "a plug-in is ignored, because <frameName> is "
                                                   "missing"),
    (imu_on("base").replace("imu_sensor.so", "p3d.so"), "because it must be in")])
def test_a_sensor_that_measures_nothing_costs_one_line(tags, reason):
    read = parse_urdf(arm(tags=tags + wrench_of("swing")))
    # A setting that is none of the plug-in's has a line of its own.
    (warning,) = [text for text in read.warnings if "because it is not supported" not in text]
    assert reason in warning and "ignored" in warning
    assert [sensor.kind for sensor in read.sensors] == ["wrench"]


def test_words_of_a_wrench_that_there_are_not():
    read = parse_urdf(arm(tags=wrench_of("swing") + (
        '<gazebo reference="swing"><sensor type="force_torque" name="s"><force_torque><frame>hand'
        "</frame><measure_direction>up</measure_direction></force_torque></sensor></gazebo>")))
    assert read.warnings == (
        "sensor 's' on joint 'swing': frame 'hand' is unknown; child is used",
        "sensor 's' on joint 'swing': measure_direction 'up' is unknown; child_to_parent is used")
    (wrench,) = read.sensors
    assert (wrench.wrench_frame, wrench.on_child) == ("child", False)


def test_many_ticks_in_a_call_tell_what_single_ones_tell():
    """A controlled arm, alone, so that ticks are compiled; each sensor at a rate of its own."""
    tags = (plugin("p3d", {"bodyName": "tool", "topicName": "t", "updateRate": 40})
            + imu_on("tool", "0.1 0 0 0 0.3 0", rate=125, updateRateHZ=30)
            + wrench_of("swing", updateRate=70) + plugin("control", {})
            + '<transmission name="t"><type>transmission_interface/SimpleTransmission</type>'
            '<joint name="swing"><hardwareInterface>hardware_interface/EffortJointInterface'
            '</hardwareInterface></joint><actuator name="a"/></transmission>')
    settings = {"c": {"type": "effort_controllers/JointPositionController", "joint": "swing",
                      "pid": {"p": 30.0, "d": 3.0}}}

    def told(until_ns):
        simulation, calls = Simulation(SimulationConfig(ground_plane=False)), 0
        simulation.spawn(parse_urdf(arm(tags=tags)), "m", TILTED, parameters=settings)
        simulation.robots["m"].start(["c"])
        simulation.robots["m"].command("c", 0.8)
        readings = [[] for _ in simulation.sensors]
        for sensor, found in zip(simulation.sensors, readings, strict=True):
            sensor.on_state = found.append
        while simulation.time_ns < 500 * MS:
            simulation.step(until_ns)
            calls += 1
        simulation.close()
        return calls, readings

    (calls, singly), (fewer, together) = told(0), told(500 * MS)
    assert (calls, fewer < 200) == (500, True) and [len(one) for one in singly] == [15, 20, 35]
    assert singly == together
