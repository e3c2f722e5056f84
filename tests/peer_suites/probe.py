"""Inspect a launched package: `probe.py JSON` prints as JSON which parts work.

Started by packages.py in the environment of the launch. Only names are used that Gazebo and
ros_control have, so it would say the same of them.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from xml.etree import ElementTree

import rosgraph
import rospy
from actionlib import SimpleActionClient
from control_msgs.msg import GripperCommandAction, GripperCommandGoal
from controller_manager_msgs.srv import ListControllers
from gazebo_msgs.srv import (
    GetJointProperties,
    GetModelState,
    GetPhysicsProperties,
    GetWorldProperties,
)
from geometry_msgs.msg import Twist
from rosgraph_msgs.msg import Clock
from rostopic import get_topic_class
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Empty
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

STEP = 0.1  # rad or m that a joint is asked to move; less where its range is small
LEAST = 1e-4  # rad or m: a joint with less room is not asked to move
ANYWHERE = (-math.inf, math.inf)
REACHED = 0.5  # part of the step that a joint has to make: PIDs of their authors may sag
LOADED = 20.0  # s of wall time for controllers to be loaded before time passes
PATIENCE = 90.0  # s of wall time for a joint, a message or a service
REMAPPED: dict[str, str] = {}  # topics of controllers that the package gives other names
SECONDS = 2.0  # of a trajectory


def wait(good: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if good():
            return True
        time.sleep(0.2)
    return good()


def call(name: str, kind: type, *arguments: object) -> object:
    """Call a service that must exist within PATIENCE."""
    rospy.wait_for_service(name, PATIENCE)
    return rospy.ServiceProxy(name, kind)(*arguments)


class Joint:
    """Position and speed of a joint, read from the simulator."""

    def __init__(self, name: str) -> None:
        self.name = name

    def read(self) -> tuple[float, float]:
        """Return position (rad or m) and speed; RuntimeError if there is no such joint."""
        answer = call("/gazebo/get_joint_properties", GetJointProperties, self.name)
        if not answer.success or not answer.position:
            raise RuntimeError(f"no joint {self.name}: {answer.status_message}")
        return answer.position[0], answer.rate[0]


def descriptions() -> Iterator[ElementTree.Element]:
    for name in rospy.get_param_names():
        if not name.endswith("_description"):
            continue
        try:
            yield ElementTree.fromstring(str(rospy.get_param(name)).strip().encode())
        except ElementTree.ParseError:
            continue


def range_of(joint: ElementTree.Element) -> tuple[float, float]:
    """Return the range of a joint within its limits and soft limits; infinite without limits."""
    low, high = -math.inf, math.inf
    limit, soft = joint.find("limit"), joint.find("safety_controller")
    if joint.get("type") in ("revolute", "prismatic") and limit is not None:
        low, high = float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))
    if soft is not None:
        low = max(low, float(soft.get("soft_lower_limit", 0.0)))
        high = min(high, float(soft.get("soft_upper_limit", 0.0)))
    return low, high


def goal_of(position: float, bounds: tuple[float, float]) -> float:
    """Return a position at a distance of STEP on the side with more room, or the same position."""
    up, down = max(bounds[1] - position, 0.0), max(position - bounds[0], 0.0)
    step = min(STEP, 0.5 * max(up, down))
    return position + step if up >= down else position - step


class Controllers:
    """Commands controllers by their standard topics and actions, and checks that joints follow."""

    def __init__(self) -> None:
        joints = [joint for root in descriptions() for joint in root.findall("joint")]
        self._bounds = {joint.get("name"): range_of(joint) for joint in joints}
        self._mimics = {joint.get("name") for joint in joints if joint.find("mimic") is not None}

    def check(self, controller: str, kind: str) -> str:
        joints = rospy.get_param(f"{controller}/joints", None) or rospy.get_param(
            f"{controller}/joint", None)
        joints = [joints] if isinstance(joints, str) else joints
        if joints and set(joints) <= self._mimics:
            return "runs; its joint follows another one"
        for part, run in (
                ("JointStateController", self._states), ("JointTrajectory", self._trajectory),
                ("GripperActionController", self._gripper), ("DiffDrive", self._drive),
                ("JointGroup", self._group), ("Joint", self._single)):
            if part in kind:
                return run(controller, kind, joints)
        raise RuntimeError(f"{controller} has the type {kind}, which this program cannot command")

    def _states(self, controller: str, _kind: str, _joints: object) -> str:
        topic = controller.rpartition("/")[0] + "/joint_states"
        return f"{topic}: {len(message(topic).name)} joints"

    def _follows(self, name: str, goal: float, send: Callable[[], None], again: bool = True) -> str:
        joint = Joint(name)
        start, _ = joint.read()
        send()
        if abs(goal - start) < LEAST:
            return f"{name} has no room within its limits"
        last = [time.monotonic()]

        def reached() -> bool:
            if again and time.monotonic() - last[0] > 1.0:
                send()
                last[0] = time.monotonic()
            position, _ = joint.read()
            return (position - start) * math.copysign(1.0, goal - start) >= REACHED * abs(
                goal - start)

        if not wait(reached, PATIENCE):
            raise RuntimeError(f"{name} was to move from {start:.3f} to {goal:.3f} and is at "
                               f"{joint.read()[0]:.3f}")
        return f"{name} follows"

    def _trajectory(self, controller: str, _kind: str, joints: list[str]) -> str:
        starts = [Joint(name).read()[0] for name in joints]
        goals = [goal_of(at, self._bounds.get(name, ANYWHERE))
                 for at, name in zip(starts, joints, strict=True)]
        point = JointTrajectoryPoint(positions=goals, time_from_start=rospy.Duration(SECONDS))
        publisher = publish(f"{controller}/command", JointTrajectory)
        asked = [one for one in zip(joints, starts, goals, strict=True)
                 if abs(one[2] - one[1]) >= LEAST]
        sent = [-math.inf]

        def reached(name: str, start: float, goal: float) -> bool:
            # A node of the package's may have commanded a posture of its own meanwhile.
            if time.monotonic() - sent[0] > PATIENCE / 5.0:
                publisher.publish(JointTrajectory(joint_names=joints, points=[point]))
                sent[0] = time.monotonic()
            return (Joint(name).read()[0] - start) / (REACHED * (goal - start)) >= 1.0

        for name, start, goal in asked:
            if not wait(lambda one=(name, start, goal): reached(*one), PATIENCE):
                raise RuntimeError(f"{name} was to move from {start:.3f} to {goal:.3f} and is at "
                                   f"{Joint(name).read()[0]:.3f}")
        if not asked:
            raise RuntimeError(f"{controller}: no joint has room within its limits")
        return f"{len(asked)} joints follow"

    def _single(self, controller: str, kind: str, joints: list[str]) -> str:
        (name,) = joints
        publisher = publish(f"{controller}/command", Float64)
        return self._commanded(kind, name, lambda value: publisher.publish(value))

    def _group(self, controller: str, kind: str, joints: list[str]) -> str:
        publisher = publish(f"{controller}/command", Float64MultiArray)
        if "Position" in kind:
            starts = {name: Joint(name).read()[0] for name in joints}
            for name in joints:
                goal = goal_of(starts[name], self._bounds.get(name, ANYWHERE))
                starts[name] = goal
                self._follows(name, goal, lambda: publisher.publish(
                    Float64MultiArray(data=list(starts.values()))))
        else:
            for k, name in enumerate(joints):
                self._commanded(kind, name, lambda value, k=k: publisher.publish(
                    Float64MultiArray(data=[value * (n == k) for n in range(len(joints))])))
        return f"{len(joints)} joints follow"

    def _commanded(self, kind: str, name: str, send: Callable[[float], None]) -> str:
        start = Joint(name).read()[0]
        goal = goal_of(start, self._bounds.get(name, ANYWHERE))
        way = goal - start
        if "Position" in kind:
            return self._follows(name, goal, lambda: send(goal))
        sign = math.copysign(1.0, way)
        strength = 0.5 * sign if "Velocity" in kind else 20.0 * sign
        try:
            return self._follows(name, start + 0.5 * way, lambda: send(strength))
        finally:
            send(0.0)

    def _gripper(self, controller: str, _kind: str, joints: list[str]) -> str:
        (name,) = joints
        goal = goal_of(Joint(name).read()[0], self._bounds.get(name, ANYWHERE))
        client = SimpleActionClient(f"{controller}/gripper_cmd", GripperCommandAction)
        if not wait(lambda: client.wait_for_server(rospy.Duration(0.2)), PATIENCE):
            raise RuntimeError(f"{controller}/gripper_cmd has no server")
        wish = GripperCommandGoal()
        wish.command.position, wish.command.max_effort = goal, 100.0
        return self._follows(name, goal, lambda: client.send_goal(wish), again=False)

    def _drive(self, controller: str, _kind: str, _joints: object) -> str:
        publisher, odometry = publish(f"{controller}/cmd_vel", Twist), f"{controller}/odom"
        start = message(odometry).pose.pose.position
        forward = Twist()
        forward.linear.x = 0.2

        def moved() -> bool:
            publisher.publish(forward)
            now = message(odometry).pose.pose.position
            return math.hypot(now.x - start.x, now.y - start.y) > 0.05

        try:
            if not wait(moved, PATIENCE):
                raise RuntimeError(f"{controller} was to drive and has not moved")
        finally:
            publisher.publish(Twist())
        return "drives"


def publish(topic: str, kind: type) -> rospy.Publisher:
    publisher = rospy.Publisher(REMAPPED.get(topic, topic), kind, queue_size=1)
    if not wait(lambda: publisher.get_num_connections() > 0, PATIENCE):
        raise RuntimeError(f"no subscriber of {topic}")
    return publisher


def message(topic: str) -> object:
    kinds = []
    if not wait(lambda: kinds.append(get_topic_class(topic)[0]) or kinds[-1] is not None, PATIENCE):
        raise RuntimeError(f"no publisher of {topic}")
    found = []
    subscriber = rospy.Subscriber(topic, kinds[-1], found.append, queue_size=1)
    try:
        if not wait(lambda: bool(found), PATIENCE):
            raise RuntimeError(f"no message on {topic}")
    finally:
        subscriber.unregister()
    return found[0]


def check_topic(topic: str) -> str:
    got = message(topic)
    if "Image" in type(got).__name__:
        if not got.data:
            raise RuntimeError(f"an empty image on {topic}")
        return f"{topic}: {got.width} x {got.height} {got.encoding}"
    return topic


def check_service(name: str) -> str:
    rospy.wait_for_service(name, PATIENCE)
    return name


def check_attach(entry: str) -> str:
    """Check that two attached links, `model1::link1 model2::link2`, move together; detach them."""
    from gazebo_ros_link_attacher.srv import Attach
    names = [part for word in entry.split() for part in word.split("::", 1)]
    for service in ("attach", "detach"):
        if not call(f"/link_attacher_node/{service}", Attach, *names).ok:
            raise RuntimeError(f"/link_attacher_node/{service} of {entry} failed")
    return f"attach and detach {entry}"


def tried(check: Callable[[], str], works: list[str], faults: list[str]) -> None:
    try:
        works.append(check())
    except (RuntimeError, ValueError, rospy.ROSException, rospy.ServiceException,
            ImportError) as error:
        faults.append(" ".join(str(error).split())[:300])


def start_simulation(wanted: Mapping[str, object]) -> list[str]:
    """Wait for models, let time pass, wait for controllers; return what is missing."""
    seconds = float(wanted["start"])
    if not wait(lambda: rosgraph.is_master_online(), seconds):
        return ["no master"]
    rospy.init_node("probe", anonymous=True, disable_signals=True, disable_rostime=True)
    try:
        rospy.wait_for_service("/gazebo/get_world_properties", seconds)
    except rospy.ROSException:
        return [f"no simulator after {seconds:.0f} s"]
    world = rospy.ServiceProxy("/gazebo/get_world_properties", GetWorldProperties)
    missing = set(wanted["models"])
    wait(lambda: not missing - set(world().model_names), seconds)
    missing -= set(world().model_names)
    faults = [f"no model {name}" for name in sorted(missing)]
    if call("/gazebo/get_physics_properties", GetPhysicsProperties).pause:
        wait(lambda: all(set(names) <= set(listed(manager))
                         for manager, names in wanted["controllers"].items()), LOADED)
        call("/gazebo/unpause_physics", Empty)  # what the user's play button does
    first, second = message_of_clock(), message_of_clock()
    if second <= first:
        faults.append("the clock stands")
    for name in sorted(set(wanted["models"]) - missing):
        state = call("/gazebo/get_model_state", GetModelState, name, "")
        if not all(map(math.isfinite, (state.pose.position.x, state.pose.position.z))):
            faults.append(f"{name} has no finite pose")
    return faults


def message_of_clock() -> float:
    time.sleep(0.5)
    found = []
    subscriber = rospy.Subscriber("/clock", Clock, found.append, queue_size=1)
    wait(lambda: bool(found), PATIENCE)
    subscriber.unregister()
    return found[-1].clock.to_sec() if found else 0.0


def listed(manager: str) -> dict[str, tuple[str, str]]:
    service = f"{manager.rstrip('/')}/controller_manager/list_controllers"
    try:
        answer = rospy.ServiceProxy(service, ListControllers)()
    except rospy.ServiceException:
        return {}
    return {one.name: (one.state, one.type) for one in answer.controller}


def check_controllers(wanted: Mapping[str, Iterable[str]], seconds: float, works: list[str],
                      faults: list[str]) -> None:
    """Check that each named controller runs, and that its joints follow it."""
    for manager, names in wanted.items():
        root = manager.rstrip("/")

        def running(manager: str = manager, names: Iterable[str] = names) -> bool:
            states = listed(manager)
            return all(states.get(name, ("", ""))[0] == "running" for name in names)

        wait(running, seconds)
        states, commander = listed(manager), Controllers()
        for name in names:
            state, kind = states.get(name, ("not loaded", ""))
            if state != "running":
                faults.append(f"{root}/{name} is {state}")
                continue
            path = f"{root}/{name}"
            tried(lambda p=path, k=kind, c=commander: f"{p}: {c.check(p, k)}", works, faults)


def main() -> None:
    wanted = json.loads(sys.argv[1])
    REMAPPED.update(wanted["remapped"])
    works: list[str] = []
    faults = start_simulation(wanted)
    if not faults:
        works.extend(wanted["models"])
        check_controllers(wanted["controllers"], float(wanted["start"]), works, faults)
        for check, entries in ((check_topic, wanted["topics"]),
                               (check_service, wanted["services"]),
                               (check_attach, wanted["attach"])):
            for entry in entries:
                tried(lambda c=check, e=entry: c(e), works, faults)
    json.dump({"works": works, "faults": faults}, sys.stdout)


if __name__ == "__main__":
    main()
