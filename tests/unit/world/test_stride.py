"""Cycles made in a row are those made one by one, bit for bit, and stop where somebody looks."""

import random

import pytest
from aras_robot import CONTROLLERS, ArasRobot

from aras_sim_bridge.control.controllers.joint_state import JointStateController
from aras_sim_bridge.control.controllers.pid_controllers import PidPositionController
from aras_sim_bridge.control.pid import Gains
from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.simulation import Simulation, SimulationConfig

MS = 1_000_000
LINK = ('<link name="{0}"><inertial><mass value="1"/><origin xyz="0.2 0 0"/><inertia ixx="0.02" '
        'iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>')
TURNER = f"""<robot name="turner"><link name="world"/>{LINK.format("a")}{LINK.format("b")}
{LINK.format("c")}
<joint name="round" type="continuous"><parent link="world"/><child link="a"/><axis xyz="0 0 1"/>
  <limit effort="30" velocity="8"/></joint>
<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
  <limit lower="-0.5" upper="0.5" effort="60" velocity="3"/></joint>
<joint name="bend" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" effort="20" velocity="6"/><dynamics friction="0.1" damping="0.2"/>
</joint>""" + "".join(
    f'<transmission name="{j}_t"><type>transmission_interface/SimpleTransmission</type>'
    f'<joint name="{j}"><hardwareInterface>hardware_interface/EffortJointInterface'
    f'</hardwareInterface></joint><actuator name="{j}_m"/></transmission>'
    for j in ("round", "slide", "bend")
) + '<gazebo><plugin name="p" filename="libgazebo_ros_control.so"/></gazebo></robot>'  # fmt: skip
WOUND = {"p": 30.0, "i": 40.0, "d": 3.0, "i_clamp_max": 6.0, "i_clamp_min": -2.0}


SOFT = {"p": 3.0, "d": 0.02}  # even half a turn off asks for less than the effort limit


def turner(antiwindup=False, pid=WOUND):
    """A joint that turns for ever, one that slides, one that bends; a group and a single one."""
    simulation = Simulation(SimulationConfig())
    gains = {"pid": {**pid, "antiwindup": antiwindup}}
    simulation.spawn(parse_urdf(TURNER), "turner", namespace="/t", parameters={
        "states": {"type": "joint_state_controller/JointStateController", "publish_rate": 60.0},
        "group": {"type": "effort_controllers/JointGroupPositionController",
                  "joints": ["bend", "round"], "bend": gains, "round": gains},
        "slide": {"type": "effort_controllers/JointPositionController", "joint": "slide",
                  "interpolate": True, "pid": {"p": 300.0, "d": 20.0}},
    })  # fmt: skip
    simulation.robots["turner"].start(["states", "slide", "group"])
    return simulation


def aras(**options):
    """The shipped robot."""
    return ArasRobot(**options).simulation


def robot_of(simulation):
    (robot,) = simulation.robots.values()
    return robot


def told(simulation):
    """All that cycles leave behind."""
    robot = robot_of(simulation)
    drives = [(d._good, d._limited._last_ns) for d in robot.hardware.drives]
    handles = [(h.position, h.velocity, h.effort, h.effort_command)
               for h in robot.hardware.handles.values()]  # fmt: skip
    running = [entry.controller for entry in robot.manager._order]
    pids = [(*pid.memory, pid.command, pid._error, pid._error_dot)
            for controller in running for pid in controller.pids.values()]  # fmt: skip
    loops = [(loop.set_point, loop.error, loop.output, loop.begin_stride())
             for controller in running for loop in getattr(controller, "loops", ())]  # fmt: skip
    joints = [list(part) for part in robot.model.read_joints()]
    return simulation.time_ns, joints, handles, drives, pids, loops


def run(simulation, script, in_strides):
    """Carry out a script of (ns, what to do then); all that was told at each, and strided steps."""
    strided, seen, states = 0, [], []
    manager = robot_of(simulation).manager
    manager.get([name for name in manager._entries if "state" in name][0]).on_state = (
        lambda state: states.append((state.stamp_ns, state.positions, state.efforts))
    )
    for at_ns, act in script:
        while simulation.time_ns < at_ns:
            before = simulation.time_ns
            if in_strides:
                simulation.stride(at_ns)
                strided += (simulation.time_ns - before) // simulation.step_ns
            if simulation.time_ns < at_ns:
                simulation.step()
        seen.append(told(simulation))
        act(simulation)
    simulation.close()
    return seen, states, strided


def commands(seed, names, spread):
    """Commands at uneven times, some far out, gains changed on the way."""
    draw, at, script = random.Random(seed), 0, []

    def command(values):
        def act(simulation):
            robot = robot_of(simulation)
            for name, value in values.items():
                robot.command(name, value)
        return act

    def softer(i):
        def act(simulation):
            manager = robot_of(simulation).manager
            for name in names:
                for pid in manager.get(name).pids.values():
                    pid.set_gains(Gains(*pid.gains)._replace(p=0.7 * pid.gains.p, i=i))
        return act

    for k in range(90):
        at += (200 if k % 12 == 0 else draw.randrange(1, 45)) * MS
        far = 4.0 if k % 9 == 0 and spread > 1e-3 else spread
        values = {name: draw.uniform(-far, far) if name != "group" else
                  [draw.uniform(-far, far), draw.uniform(-far, 2.5 * far)] for name in names}
        changes = {40: softer(5.0), 60: softer(-4.0)}
        script.append((at, changes.get(k) or command(values)))
    return script


@pytest.mark.parametrize("make, names, spread", [
    (aras, tuple(CONTROLLERS.values()), 0.05),
    (lambda: aras(interpolate=False), tuple(CONTROLLERS.values()), 1e-4),
    (turner, ("slide", "group"), 0.6),
    (lambda: turner(antiwindup=True), ("slide", "group"), 0.6),
    (lambda: turner(pid=SOFT), ("slide", "group"), 1.9),
], ids=["interpolated", "steps", "wound up", "antiwindup", "the short way round"])  # fmt: skip
def test_strides_are_the_steps_bit_for_bit(make, names, spread):
    script = commands(3, names, spread)
    one_by_one, states, _ = run(make(), script, in_strides=False)
    seen, strided_states, strided = run(make(), script, in_strides=True)
    assert seen == one_by_one
    assert strided_states == states
    assert strided > 300


def arrived(simulation):
    """Let it come to rest, in steps."""
    while simulation.time_ns < 300 * MS:
        simulation.step()
    return simulation


def test_a_stride_ends_before_a_sample_of_the_joints_and_before_a_picture():
    simulation = arrived(aras(cameras={"labrob": {"camera": {"update_rate": 15.0}}}))
    simulation.stride(10_000 * MS)
    assert simulation.time_ns == 300 * MS  # 301 ms is the sample's
    simulation.step()
    simulation.stride(10_000 * MS)
    assert simulation.time_ns == 310 * MS
    robot_of(simulation).manager.switch([], ["joint_state_controller"])
    simulation.step()
    (camera,) = simulation.cameras
    camera.enabled = True
    simulation.stride(10_000 * MS)
    assert simulation.time_ns == 311 * MS  # it begins to look
    simulation.step()
    simulation.stride(10_000 * MS)
    assert simulation.time_ns == 333 * MS  # a picture falls at 333.3
    camera.enabled = False
    simulation.stride(400 * MS)
    assert simulation.time_ns == 400 * MS
    simulation.close()


def test_a_bolted_robot_goes_as_far_in_one_stride():
    simulation = arrived(turner())
    simulation.step()
    began = simulation.time_ns
    simulation.stride(10_000 * MS)
    assert simulation.time_ns >= began + 10 * MS  # of 16 between two samples
    simulation.close()


class Shy(PidPositionController):
    """A user's own."""

    def update(self, time_ns, period):
        super().update(time_ns, period)


def _stop(simulation):
    robot_of(simulation).hardware.e_stop = True


def _listen(simulation):
    robot_of(simulation).manager.get(CONTROLLERS["J3"]).on_state = lambda state: None


def _listen_to_a_pid(simulation):
    robot_of(simulation).manager.get(CONTROLLERS["J3"]).pids["pid"].on_state = lambda state: None


def _push(simulation):
    robot_of(simulation).model.apply_effort("J6", 0.1)


def _switch(simulation):
    robot_of(simulation).manager.switch([], [CONTROLLERS["J1"]])


def _idle_joint(simulation):
    _switch(simulation)
    simulation.step()


def _second_robot(simulation):
    simulation.spawn(parse_urdf(TURNER), "turner", namespace="/t")


def _another_model(simulation):
    bare = TURNER[: TURNER.index("<gazebo>")] + "</robot>"
    simulation.spawn(parse_urdf(bare), "other")


def _something_to_touch(simulation):
    box = ('<robot name="box"><link name="box"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
           'izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry><box size="1 1 1"/>'
           '</geometry></collision></link></robot>')  # fmt: skip
    simulation.spawn(parse_urdf(box), "box")


def _own_class(simulation):
    manager = robot_of(simulation).manager
    manager.get(CONTROLLERS["J5"]).__class__ = Shy


class Chatty(JointStateController):
    """A user's own, which looks in every cycle."""

    def update(self, time_ns, period):
        super().update(time_ns, period)


def _own_states(simulation):
    robot_of(simulation).manager.get("joint_state_controller").__class__ = Chatty


@pytest.mark.parametrize("disturb", [
    _own_states, _stop, _listen, _listen_to_a_pid, _push, _switch, _idle_joint, _second_robot,
    _another_model, _something_to_touch, _own_class,
])  # fmt: skip
def test_what_is_out_of_the_ordinary_is_stepped(disturb):
    simulation = arrived(aras())
    simulation.step()
    disturb(simulation)
    began = simulation.time_ns
    simulation.stride(10_000 * MS)
    assert simulation.time_ns == began
    simulation.close()


def test_the_rhythm_of_a_state_topic_goes_on():
    stamps = {}
    for in_strides in (False, True):
        simulation = arrived(aras())
        script = [(347 * MS, lambda simulation: None)]
        run_on = simulation.stride if in_strides else lambda until_ns: None
        while simulation.time_ns < script[0][0]:
            run_on(script[0][0])
            if simulation.time_ns < script[0][0]:
                simulation.step()
        heard = stamps[in_strides] = []
        controller = robot_of(simulation).manager.get(CONTROLLERS["J2"])
        controller.on_state = lambda state, heard=heard: heard.append(state.stamp_ns)
        for _ in range(40):
            simulation.step()
        simulation.close()
    assert stamps[True] == stamps[False] != []


def test_a_world_that_diverges_in_a_stride_ends_as_in_a_step():
    def explode(simulation):
        model = robot_of(simulation).model
        model.apply_force("a", (0.0, 0.0, 0.0), model.link_pose("a").xyz, (0.0, 0.0, 1e30))

    ends = []
    for in_strides in (False, True):
        simulation = arrived(turner())
        simulation.step()
        explode(simulation)
        with pytest.raises(WorldError, match="then call reset_simulation and unpause_physics"):
            if in_strides:
                simulation.stride(simulation.time_ns + 5 * MS)
            simulation.step()
        ends.append((simulation.time_ns, robot_of(simulation).loop._updated_ns))
        simulation.close()
    assert ends[0] == ends[1]


CART = """<robot name="cart"><link name="base"><inertial><mass value="10"/><origin xyz="0 0 0.1"/>
<inertia ixx="0.3" iyy="0.3" izz="0.6" ixy="0" ixz="0" iyz="0"/></inertial><collision>
<origin xyz="0 0 0.1"/><geometry><box size="0.6 0.6 0.2"/></geometry></collision></link>
<link name="slide"><inertial><mass value="2"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0"
ixz="0" iyz="0"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="1 0 0"/>
<origin xyz="0 0 0.1"/><limit lower="-20" upper="20" effort="1000" velocity="50"/></joint>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="rail">
<hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
<actuator name="m"/></transmission>
<gazebo reference="base"><mu1>0.5</mu1></gazebo>
<gazebo><plugin name="p" filename="libgazebo_ros_control.so"/></gazebo></robot>"""


def test_a_base_is_let_go_in_the_step_in_which_the_ground_cannot_bear_it():
    """12 kg with 0.5 hold 58.8 N: 8 N for 0.02 m are borne, 400 N for 1 m are not."""
    ends = {}
    for in_strides in (False, True):
        simulation = Simulation(SimulationConfig())
        simulation.spawn(parse_urdf(CART), "cart", namespace="/c", parameters={
            "rail": {"type": "effort_controllers/JointPositionController", "joint": "rail",
                     "interpolate": True, "pid": {"p": 400.0}},
        })  # fmt: skip
        robot = simulation.robots["cart"]
        robot.start(["rail"])
        for _ in range(300):
            simulation.step()
        ends[in_strides], freed = [], None
        for until_ns, command in ((600 * MS, 0.02), (900 * MS, 1.0)):
            robot.command("rail", command)
            while simulation.time_ns < until_ns:
                began = simulation.time_ns
                if in_strides:
                    simulation.stride(until_ns)
                    assert command == 1.0 or simulation.time_ns > began
                if simulation.time_ns == began:
                    simulation.step()
                if freed is None and not robot.model.fixed_base:
                    freed = simulation.time_ns
            assert (freed is None) == (command == 0.02)
            ends[in_strides].append((freed, told(simulation), robot.model.twist()))
        simulation.close()
    assert ends[True] == ends[False]
