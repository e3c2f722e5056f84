"""Steps in one compiled call are bit-identical to single steps and to steps with Python code."""

import random

import pytest
from aras_robot import CONTROLLERS, ArasRobot

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.control.controllers.joint_state import JointStateController
from aras_sim_bridge.control.controllers.pid_controllers import PidPositionController
from aras_sim_bridge.control.drives import MAX_EFFORT
from aras_sim_bridge.control.pid import PidGains
from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base.poses import Pose

MS = 1_000_000
LINK = ('<link name="{0}"><inertial><mass value="1"/><origin xyz="0.2 0 0"/><inertia ixx="0.02" '
        'iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>')
DRIVE = ('<transmission name="{0}_t"><type>transmission_interface/SimpleTransmission</type>'
         '<joint name="{0}"><hardwareInterface>hardware_interface/EffortJointInterface'
         '</hardwareInterface></joint><actuator name="{0}_m"/></transmission>')
CONTROL = '<gazebo><plugin name="p" filename="libgazebo_ros_control.so"/></gazebo>'
TURNER = f"""<robot name="turner"><link name="world"/>{LINK.format("a")}{LINK.format("b")}
{LINK.format("c")}
<joint name="round" type="continuous"><parent link="world"/><child link="a"/><axis xyz="0 0 1"/>
  <limit effort="30" velocity="8"/></joint>
<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
  <limit lower="-0.5" upper="0.5" effort="60" velocity="3"/></joint>
<joint name="bend" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" effort="20" velocity="6"/><dynamics friction="0.1" damping="0.2"/>
</joint>{"".join(map(DRIVE.format, ("round", "slide", "bend")))}{CONTROL}</robot>"""
STATES = {"type": "joint_state_controller/JointStateController", "publish_rate": 60.0}
WOUND = {"p": 30.0, "i": 40.0, "d": 3.0, "i_clamp_max": 6.0, "i_clamp_min": -2.0}


SOFT = {"p": 3.0, "d": 0.02}  # even half a turn off asks for less than the effort limit


def made_of(urdf, running, **parameters):
    """A simulation of this robot with these controllers running."""
    simulation = Simulation(SimulationConfig())
    simulation.spawn(parse_urdf(urdf), "turner", namespace="/t", parameters=parameters)
    simulation.robots["turner"].start(running)
    return simulation


def turner(antiwindup=False, pid=WOUND):
    """A joint that turns for ever, one that slides, one that bends; a group and a single one."""
    gains = {"pid": {**pid, "antiwindup": antiwindup}}
    return made_of(
        TURNER, ["states", "slide", "group"], states=STATES,
        group={"type": "effort_controllers/JointGroupPositionController",
               "joints": ["bend", "round"], "bend": gains, "round": gains},
        slide={"type": "effort_controllers/JointPositionController", "joint": "slide",
               "interpolate": True, "pid": {"p": 300.0, "d": 20.0}})


def motors():
    """Velocity motors, one of them under a position loop, and one by a PID of its drive's."""
    return made_of(
        TURNER.replace("EffortJoint", "VelocityJoint"), ["states", "spin", "slide", "bend"],
        states=STATES,
        spin={"type": "velocity_controllers/JointVelocityController", "joint": "round"},
        slide={"type": "velocity_controllers/JointPositionController", "joint": "slide",
               "interpolate": True, "pid": {"p": 8.0}},
        bend={"type": "velocity_controllers/JointVelocityController", "joint": "bend"},
        gazebo_ros_control={"pid_gains": {"bend": {"p": 9.0, "i": 4.0, "i_clamp": 2.0}}},
        joint_limits={"round": {"has_acceleration_limits": True, "max_acceleration": 30.0}})


def efforts():
    """Efforts as they come, some beyond the limits, and a velocity PID."""
    return made_of(
        TURNER, ["states", "group", "bend"], states=STATES,
        group={"type": "effort_controllers/JointGroupEffortController",
               "joints": ["slide", "round"]},
        bend={"type": "effort_controllers/JointVelocityController", "joint": "bend",
              "pid": {"p": 3.0, "i": 2.0, "i_clamp": 5.0}})


def aras(**options):
    """The shipped robot."""
    return ArasRobot(**options).simulation


def robot_of(simulation):
    (robot,) = simulation.robots.values()
    return robot


def told(simulation):
    """Return all state that control cycles change."""
    robot = robot_of(simulation)
    hardware = robot.hardware
    loops = [row.tolist() for entry in robot.manager.running
             for row in getattr(entry.controller, "rows", ())]  # fmt: skip
    joints = [list(part) for part in robot.model.read_joints()]
    return repr((simulation.time_ns, joints, hardware.handle_rows.tolist(),
                 hardware.drive_rows.tolist(), loops))  # NaN equals NaN


class Idle(Controller):
    """A user's own, which does nothing, but in Python and in every cycle."""


def one_by_one(simulation, until_ns):
    simulation.step()


def in_python(simulation, until_ns):
    """Run with a user-defined controller, so that compiled functions are called one by one."""
    manager = robot_of(simulation).manager
    if "idle" not in [entry.name for entry in manager.list()]:
        manager.parameters = {**manager.parameters, "idle": {"type": "idle"}, "controller_classes":
                              {"idle": f"{Idle.__module__}:{Idle.__name__}"}}  # fmt: skip
        manager.load("idle")
        manager.switch(["idle"], [])
    simulation.step(until_ns)


def together(simulation, until_ns):
    simulation.step(until_ns)


def run(simulation, script, step):
    """Carry out a script of (ns, what to do then); all that was told at each, the joint states, and
    the most ticks in a call."""
    most, seen, states = 0, [], []
    manager = robot_of(simulation).manager
    manager.get(next(e.name for e in manager.list() if "state" in e.name)).on_state = (
        lambda state: states.append((state.stamp_ns, state.positions, state.efforts))
    )
    for at_ns, act in script:
        while simulation.time_ns < at_ns:
            before = simulation.time_ns
            step(simulation, at_ns)
            most = max(most, (simulation.time_ns - before) // simulation.step_ns)
        seen.append(told(simulation))
        act(simulation)
    simulation.close()
    return seen, states, most


def commands(seed, names, spread):
    """Commands at uneven times, some far out, gains changed on the way."""
    draw, at, script = random.Random(seed), 0, []

    def command(values):
        return lambda simulation: [
            robot_of(simulation).command(name, value) for name, value in values.items()]

    def softer(i):
        def act(simulation):
            for name in names:
                for pid in robot_of(simulation).manager.get(name).pids.values():
                    pid.set_gains(PidGains(*pid.gains)._replace(p=0.7 * pid.gains.p, i=i))
        return act

    changes = {20: softer(5.0), 30: softer(-4.0),
               40: lambda simulation: robot_of(simulation).manager.switch([], names[:1])}
    for k in range(45):
        at += (200 if k % 12 == 0 else draw.randrange(1, 45)) * MS
        far = 4.0 if k % 9 == 0 and spread > 1e-3 else spread
        values = {name: draw.uniform(-far, far) if name != "group" else
                  [draw.uniform(-far, far), draw.uniform(-far, 2.5 * far)]
                  for name in (names[:1] if k % 5 == 3 else names)}
        script.append((at, changes.get(k) or command(values)))
    return script


@pytest.mark.parametrize("make, names, spread", [
    (aras, tuple(CONTROLLERS.values()), 0.05),
    (lambda: aras(interpolate=False), tuple(CONTROLLERS.values()), 0.1),
    (turner, ("slide", "group"), 0.6),
    (lambda: turner(antiwindup=True), ("slide", "group"), 0.6),
    (lambda: turner(pid=SOFT), ("slide", "group"), 1.9),
    (motors, ("slide", "spin", "bend"), 2.5),
    (efforts, ("group", "bend"), 25.0),
], ids=["interpolated", "saturated", "wound up", "antiwindup", "the short way round",
        "motors", "efforts"])  # fmt: skip
def test_ticks_in_a_row_are_those_one_by_one_bit_for_bit(make, names, spread, caplog):
    script = commands(3, names, spread)
    logs = []
    seen, states, most = run(make(), script, together)
    for step in (one_by_one, in_python):
        logs.append([record.getMessage() for record in caplog.records])
        caplog.clear()
        alone, alone_states, once = run(make(), script, step)
        assert alone == seen
        assert alone_states == states
        assert once == 1
    logs.append([record.getMessage() for record in caplog.records])
    assert logs[0] == logs[1] == logs[2]
    assert most > 5


def arrived(simulation):
    """Let it come to rest, in steps."""
    while simulation.time_ns < 300 * MS:
        simulation.step()
    return simulation


def test_ticks_in_a_row_end_with_a_picture():
    simulation = arrived(aras(cameras={"labrob": {"camera": {"update_rate": 15.0}}}))
    robot_of(simulation).manager.switch([], ["joint_state_controller"])
    simulation.step()
    (camera,) = simulation.cameras
    camera.enabled = True
    for at in (302, 334):  # it begins to look; a picture falls at 333.3
        simulation.step(10_000 * MS)
        assert simulation.time_ns == at * MS
    simulation.close()


PLATE = ('<robot name="plate"><link name="world"><visual><geometry><box size="0.1 0.1 0.01"/>'
         '</geometry></visual></link><gazebo reference="world"><material>Gazebo/Red</material>'
         '</gazebo></robot>')  # fmt: skip


def test_pictures_between_ticks_in_a_row_are_those_of_single_ticks():
    taken = []
    for step in (in_python, one_by_one, together):
        simulation = arrived(aras(cameras={"labrob": {"camera": {"update_rate": 70.0}}}))
        for name in CONTROLLERS.values():
            robot_of(simulation).command(name, 0.3)
        (camera,) = simulation.cameras
        optical = camera.model.link_pose(camera.link).matrix() @ camera.parent_T_optical
        optical[:3, 3] += 0.3 * optical[:3, 2]
        simulation.spawn(parse_urdf(PLATE), "plate", Pose.from_matrix(optical))
        frames = []
        camera.on_frame, camera.enabled = frames.append, True
        while simulation.time_ns < 500 * MS:
            step(simulation, 500 * MS)
        simulation.close()
        taken.append([(frame.stamp_ns, frame.image.tobytes()) for frame in frames])
    assert taken[0] == taken[1] == taken[2]
    assert len({image for _, image in taken[0]}) == 14


class Shy(PidPositionController):
    """A user's own."""

    def update(self, time_ns, period):
        super().update(time_ns, period)


def replaced(simulation, name, cls):
    """A controller of a user's own in the place of a shipped one."""
    manager = robot_of(simulation).manager
    manager.switch([], [name])
    simulation.step()
    manager.get(name).__class__ = cls
    manager.switch([name], [])
    simulation.step()


class Chatty(JointStateController):
    """A user's own, which looks in every cycle."""

    def update(self, time_ns, period):
        super().update(time_ns, period)


BOX = ('<robot name="box"><link name="box"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
       'izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry><box size="1 1 1"/>'
       '</geometry></collision></link></robot>')  # fmt: skip
BARE = TURNER.replace(CONTROL, "")


def controller(simulation, joint):
    return robot_of(simulation).manager.get(CONTROLLERS[joint])


DISTURBANCES = {
    "own states": lambda s: replaced(s, "joint_state_controller", Chatty),
    "own class": lambda s: replaced(s, CONTROLLERS["J5"], Shy),
    "stop": lambda s: setattr(robot_of(s).hardware, "e_stop", True),
    "listener": lambda s: setattr(controller(s, "J3"), "on_state", lambda state: None),
    "PID's": lambda s: setattr(controller(s, "J3").pids["pid"], "on_state", lambda state: None),
    "push": lambda s: robot_of(s).model.apply_effort("J6", 0.1),
    "switch": lambda s: robot_of(s).manager.switch([], [CONTROLLERS["J1"]]),
    "robot": lambda s: s.spawn(parse_urdf(TURNER), "turner", namespace="/t"),
    "model": lambda s: s.spawn(parse_urdf(BARE), "other"),
    "box": lambda s: s.spawn(parse_urdf(BOX), "box"),
}


@pytest.mark.parametrize("what", DISTURBANCES)
def test_in_what_is_out_of_the_ordinary_python_takes_part(what):
    simulation = arrived(aras())
    simulation.step()
    DISTURBANCES[what](simulation)
    began = simulation.time_ns
    simulation.step(10_000 * MS)
    assert simulation.time_ns == began + MS
    simulation.close()


@pytest.mark.parametrize("step", [one_by_one, in_python, together])
def test_a_world_that_diverges_in_a_row_of_ticks_ends_as_in_one(step):
    simulation = arrived(turner())
    simulation.step()
    step(simulation, simulation.time_ns + MS)
    model, began = robot_of(simulation).model, simulation.time_ns
    model.apply_force("a", (0.0, 0.0, 0.0), model.link_pose("a").xyz, (0.0, 0.0, 1e30))
    with pytest.raises(WorldError, match="'round': the simulation diverged; lower .*then call "
                                         "reset_simulation and unpause_physics"):
        step(simulation, began + 5 * MS)
    assert simulation.time_ns == began
    simulation.close()


@pytest.mark.parametrize("step", [one_by_one, in_python, together])
def test_an_effort_that_is_no_number_stops_the_world_before_the_step(step):
    """A velocity PID of a drive's with gains beyond all numbers."""
    simulation = arrived(motors())
    robot = robot_of(simulation)
    step(simulation, simulation.time_ns + MS)
    robot.hardware.pids["bend"].set_gains(PidGains(p=1e308, d=-1e308))
    robot.hardware.drives[2].row[MAX_EFFORT] = float("inf")
    robot.manager.get("bend").set_command(5.0)
    with pytest.raises(WorldError, match="model 'turner', joint .*'bend'.*: the effort is not fin"):
        for _ in range(20):
            before = simulation.time_ns, [list(part) for part in robot.model.read_joints()]
            step(simulation, simulation.time_ns + MS)
    assert (simulation.time_ns, [list(part) for part in robot.model.read_joints()]) == before
    simulation.close()


CART = f"""<robot name="cart"><link name="base"><inertial><mass value="10"/><origin xyz="0 0 0.1"/>
<inertia ixx="0.3" iyy="0.3" izz="0.6" ixy="0" ixz="0" iyz="0"/></inertial><collision>
<origin xyz="0 0 0.1"/><geometry><box size="0.6 0.6 0.2"/></geometry></collision></link>
{LINK.format("slide").replace('value="1"', 'value="2"')}
<joint name="rail" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="1 0 0"/>
<origin xyz="0 0 0.1"/><limit lower="-20" upper="20" effort="1000" velocity="50"/></joint>
<gazebo reference="base"><mu1>0.5</mu1></gazebo>{DRIVE.format("rail")}{CONTROL}</robot>"""


def test_a_base_is_let_go_in_the_step_in_which_the_ground_cannot_bear_it():
    """12 kg with 0.5 hold 58.8 N: 8 N for 0.02 m are borne, 400 N for 1 m are not."""
    ends = []
    for step in (one_by_one, together):
        simulation = made_of(CART, ["rail"], rail={
            "type": "effort_controllers/JointPositionController", "joint": "rail",
            "interpolate": True, "pid": {"p": 400.0}})
        robot = arrived(simulation).robots["turner"]
        freed = None
        for until_ns, command in ((600 * MS, 0.02), (900 * MS, 1.0)):
            robot.command("rail", command)
            calls = 0
            while simulation.time_ns < until_ns:
                step(simulation, until_ns)
                calls += 1
                if freed is None and not robot.model.fixed_base:
                    freed = simulation.time_ns
            assert calls < 10 or step is one_by_one or command == 1.0
            assert (freed is None) == (command == 0.02)
            ends.append((freed, told(simulation), robot.model.twist()))
        simulation.close()
    assert ends[:2] == ends[2:]
