"""What the live page does on a graph: services, gains, nodes begun anew, the robot spawned anew."""

from __future__ import annotations

import contextlib
import math
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import rosnode
import rospkg
import rospy
import rosservice
from aras_sim_bridge.srv import StepWorld
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from gazebo_msgs.srv import DeleteModel, GetModelState, GetWorldProperties, SpawnModel
from geometry_msgs.msg import Pose
from std_srvs.srv import Empty, Trigger

from aras_visual_servo_base.poses import pose_difference, transform
from aras_visual_servo_base.yaml_files import read_yaml
from aras_visual_servo_controller.errors import ConfigurationError, ServoError
from aras_visual_servo_controller.goals.goal import REACHABLE, Goal
from aras_visual_servo_controller.laws import LAWS
from aras_visual_servo_controller.schemes import SCHEMES
from aras_visual_servo_controller.settings import Settings

from ..errors import RefusedError, writing
from ..recording.described import preset_of
from .keeping import LOGGED
from .listener import Listener
from .processes import Launch
from .target_place import TARGET
from .target_watch import TARGET_DESCRIPTION

CONTROLLER, CAMERA = "/aras_visual_servo_controller", "/aras_visual_servo_camera"
CAMERA_PARAMETERS = "/gazebo/cameras/labrob/camera"
PATIENCE = 5.0  # s of wall time for a service to be there
START = 60.0  # s of wall time for nodes to come up; their loops may have to be compiled first
STRICT = 2
EXACT = 1e-5  # m and rad: a pose this near is the one that was asked for
BEGIN = {"scheme": "moments", "law": "proportional", "start": "2016", "goal": "auto"}


class Actions:
    """Carries out what a page asks for; each method answers what to say, or raises RefusedError."""

    def __init__(self, listener: Listener, settings: Settings, directory: Path,
                 robot: str) -> None:  # fmt: skip
        """`directory`: where goals, bags, reports and logs go; `robot`: the model's name."""
        self._listener, self._settings, self.directory = listener, settings, directory
        self.robot, self._space = robot, settings.namespace.rstrip("/")
        self._lock = threading.Lock()  # one thing at a time
        self.gains: dict[str, float] = {}
        self.chosen: dict[str, str] = {}
        self._nodes: Launch | None = None
        self._packages = rospkg.RosPack()
        self._camera: tuple[dict[str, Any] | None, str] = None, ""  # its settings, and their name
        rospy.Subscriber(f"{CONTROLLER}/gains/parameter_updates", Config, self._on_gains)

    def choices(self) -> dict[str, list[str]]:
        """What may be chosen now."""
        gazebo = Path(self._packages.get_path("aras_visual_servo_gazebo"))
        starts = read_yaml(
            self._settings.package / "config" / "starts.yaml", ConfigurationError
        )
        shipped = sorted(p.stem[5:] for p in self._settings.package.glob("config/goal_*.yaml"))
        own = sorted(p.stem for p in self.directory.glob("goals/*.yaml"))
        given = self.given()
        more = {kind: [given[key]] if given.get(key) else [] for kind, key in (
            ("schemes", "scheme"), ("laws", "law"), ("starts", "start"), ("goals", "goal"))}
        of_one_camera = sorted(n for n, made in SCHEMES.items() if getattr(made, "reads", 1) == 1)
        return {
            "schemes": _once([*of_one_camera, *more["schemes"]]),
            "laws": _once([*sorted(LAWS), *more["laws"]]),
            "starts": _once(["none", *sorted(starts), *more["starts"]]),
            "goals": _once(["auto", *shipped, *own, *more["goals"]]),
            "cameras": sorted(p.stem for p in gazebo.glob("config/cameras/*.yaml")),
            "targets": sorted(p.stem for p in gazebo.glob("targets/*.urdf")),
            "gains": sorted(self.gains),
            "joints": list(self._listener.story.arm.names) if self._listener.story else [],
        }

    def given(self) -> dict[str, str]:
        """What runs now, as far as it is to be chosen; where no nodes run, what they begin with."""
        names = {"scheme": "scheme", "law": "law", "start": "start", "desired": "goal"}
        try:
            parameters = rospy.get_param(CONTROLLER, {})
            camera = self._camera_name(rospy.get_param(CAMERA_PARAMETERS, {}))
        except OSError:
            return {}
        found = {**BEGIN, "camera": camera, **self.chosen}
        if isinstance(parameters, dict):
            found |= {names[k]: str(v) for k, v in parameters.items() if k in names}
        return found

    def _camera_name(self, settings: dict[str, Any]) -> str:
        """Of the shipped preset that the robot's camera has; '' where it is another."""
        if self._camera[0] != settings:
            preset = preset_of(settings)
            self._camera = settings, preset if isinstance(preset, str) else ""
        return self._camera[1]

    # -- the simulator and the loop ----------------------------------------------------------

    def loop(self, name: str) -> str:
        """start, stop or hold."""
        answer = self._call(f"{self._space}/controller/{name}", Trigger,
                            "is the controller node running?")  # fmt: skip
        return answer.message

    def clock(self, name: str) -> str:
        """pause_physics, unpause_physics or reset_simulation."""
        self._call(f"/gazebo/{name}", Empty, "is the simulator running?")
        return {"pause_physics": "time stands still", "unpause_physics": "time goes on",
                "reset_simulation": "everything begins anew, at time 0"}[name]  # fmt: skip

    def check_simulator(self) -> None:
        """RefusedError where no simulator answers."""
        name = "/gazebo/get_world_properties"
        self._call(name, GetWorldProperties, "is the simulator running?")

    def step(self, steps: int) -> str:
        """So many physics steps of the paused simulation."""
        answer = self._call("/gazebo/step_world", StepWorld, "is the simulator running?", steps)
        if not answer.success:
            raise RefusedError(answer.status_message)
        return f"{steps} steps, to {answer.sim_time.to_sec():.3f} s"

    def gain(self, name: str, value: float) -> str:
        """A gain of the law, while it runs."""
        config = Config(doubles=[DoubleParameter(name, value)])
        answer = self._call(f"{CONTROLLER}/gains/set_parameters", Reconfigure,
                            "is the controller node running?", config)  # fmt: skip
        after = {entry.name: entry.value for entry in answer.config.doubles}
        if name not in after:
            raise RefusedError(f"the law that runs now has no {name}")
        return f"{name} is {after[name]:.4g}"

    # -- nodes begun anew ----------------------------------------------------------------------

    def servo(self, scheme: str, law: str, start: str, goal: str) -> str:
        """End the nodes that servo, wherever they were started, and begin them with these."""
        own = self.directory / "goals" / f"{goal}.yaml"
        return self._begin(scheme, law, start, str(own) if own.is_file() else goal)

    def goal(self, x: float, y: float, z: float, turn: float) -> str:
        """Servo to the goal moved in the camera's frame, m, and turned about its axis, rad.

        Many an arm cannot hold the camera exactly there: the goal is then the nearest pose within
        REACHABLE, and the answer says how far off it is.
        """
        given, story = self.given(), self._listener.story
        if story is None:
            raise RefusedError("there is no robot yet")
        settings = self._settings.from_mapping(
            {"start": given.get("start", "none"), "desired": given.get("goal", "auto")},
            self._settings.package,
        )
        try:
            before = self.chosen.get("goal before", str(settings.goal_path()))
            goal = Goal.load(before).for_arm(story.arm)
            moved = goal.world_T_camera @ transform((x, y, z), (0.0, 0.0, turn))
            joints = story.arm.inverse(moved, goal.joint_values(story.arm.names), REACHABLE)
            reached = story.arm.pose(joints)
            seen = goal.seen_from(reached)
        except ServoError as error:
            raise RefusedError(f"that goal cannot be: {error}") from error
        values = dict(zip(story.arm.names, joints.tolist(), strict=True))
        path = self._written("moved", replace(seen, joints=values).to_yaml(
            "Moved on the live page."))
        text = self._begin(given.get("scheme", "moments"), given["law"], "none", str(path))
        self.chosen["goal before"] = before
        distance, angle = pose_difference(moved, reached)
        if max(distance, angle) < EXACT:
            return text
        return (f"{text}; the arm comes within {1e3 * distance:.3f} mm and "
                f"{math.degrees(angle):.3f} degrees of what was asked for")

    def _begin(self, scheme: str, law: str, start: str, goal: str) -> str:
        with self._lock:
            self.chosen.pop("goal before", None)
            self._end_nodes()
            self.directory.joinpath("log").mkdir(parents=True, exist_ok=True)
            self._nodes = Launch(
                ["aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch", f"scheme:={scheme}",
                 f"law:={law}", f"start:={start}", f"goal:={goal}"],
                self.directory / "log" / "nodes.txt", dict(os.environ),
            )  # fmt: skip
            ended = self._wait(lambda: self._nodes.death() or self._up(), START)
            if ended is not True:
                why = self._nodes.last_lines(1).strip() if ended else "they do not answer"
                self._end_nodes()
                raise RefusedError(f"no controller runs now: {LOGGED.sub('', why)}")
        return f"servoing with {scheme}, law {law}, from {start} to {Path(goal).stem}"

    def _up(self) -> bool:
        """Whether the controller has its robot and serves."""
        try:
            return rosservice.get_service_node(f"{self._space}/controller/start") == CONTROLLER
        except (rosservice.ROSServiceException, OSError):
            return False

    def controller_is_there(self) -> bool:
        """Whether any controller serves; where nobody can be asked, it is believed to."""
        try:
            return rosservice.get_service_uri(f"{self._space}/controller/start") is not None
        except (rosservice.ROSServiceException, OSError):
            return True

    def _end_nodes(self) -> None:
        if self._nodes is not None:
            self._nodes.stop()
            self._nodes = None
        with contextlib.suppress(rosnode.ROSNodeException, OSError):
            there = [name for name in (CONTROLLER, CAMERA) if name in rosnode.get_node_names()]
            rosnode.kill_nodes(there)
            self._wait(lambda: not set(there) & set(rosnode.get_node_names()), PATIENCE)
        with contextlib.suppress(KeyError, OSError):
            rospy.delete_param(CONTROLLER)
        self.gains = {}

    # -- the robot and the target spawned anew ---------------------------------------------------

    def camera(self, preset: str) -> str:
        """The robot taken away and put back with another camera; its controllers with it."""
        gazebo = Path(self._packages.get_path("aras_visual_servo_gazebo"))
        settings = read_yaml(
            gazebo / "config" / "cameras" / f"{preset}.yaml", ConfigurationError
        )
        manager = f"{self._space}/controller_manager"
        with self._lock:
            there = self._call(f"{manager}/list_controllers", ListControllers,
                               "are the robot's controllers loaded?").controller  # fmt: skip
            if rospy.has_param(CAMERA_PARAMETERS):
                rospy.delete_param(CAMERA_PARAMETERS)
            rospy.set_param(CAMERA_PARAMETERS, settings or {})
            self._call("/gazebo/delete_model", DeleteModel, "", self.robot)
            spawned = self._call("/gazebo/spawn_urdf_model", SpawnModel, "", self.robot,
                                 rospy.get_param(self._settings.description), "", Pose(), "")
            if not spawned.success:
                raise RefusedError(f"the robot did not come back: {spawned.status_message}")
            for controller in there:
                self._call(f"{manager}/load_controller", LoadController, "", controller.name)
            running = [c.name for c in there if c.state == "running"]
            switched = self._call(f"{manager}/switch_controller", SwitchController, "", running,
                                  [], STRICT, False, 0.0)  # fmt: skip
            if not switched.ok:
                raise RefusedError("the robot came back without its controllers: reset")
        self.chosen["camera"] = preset
        return f"the robot has the camera {preset}"

    def target(self, name: str) -> str:
        """A target put into the world, in the place of the one that was."""
        gazebo = Path(self._packages.get_path("aras_visual_servo_gazebo"))
        text = (gazebo / "targets" / f"{name}.urdf").read_text(encoding="utf-8")
        with self._lock:
            state = self._call("/gazebo/get_model_state", GetModelState, "", TARGET, "")
            if not state.success:
                raise RefusedError("there is no model named target whose place it could take; "
                                   f"launch the simulator with target:={name}")
            self._call("/gazebo/delete_model", DeleteModel, "", TARGET)
            answer = self._call("/gazebo/spawn_urdf_model", SpawnModel, "", TARGET, text, "",
                                state.pose, "")  # fmt: skip
            if not answer.success:
                raise RefusedError(answer.status_message)
            rospy.set_param(TARGET_DESCRIPTION, text)
        self.chosen["target"] = name
        return f"the target is {name}"

    # -- shared ------------------------------------------------------------------------------------

    def close(self) -> None:
        """End what was started here."""
        if self._nodes is not None:
            self._nodes.stop()

    def _on_gains(self, message: Config) -> None:
        self.gains = {entry.name: round(entry.value, 6) for entry in message.doubles}

    def _written(self, name: str, text: str) -> Path:
        path = self.directory / "goals" / f"{name}.yaml"
        with writing(path, RefusedError):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        return path

    @staticmethod
    def _wait(done: Callable[[], Any], seconds: float) -> Any:
        end = time.monotonic() + seconds
        while not (found := done()) and time.monotonic() < end:
            time.sleep(0.1)
        return found

    @staticmethod
    def _call(name: str, kind: type, hint: str, *given: object) -> Any:
        """A service's answer; RefusedError where it is not there or fails."""
        try:
            rospy.wait_for_service(name, PATIENCE)
            return rospy.ServiceProxy(name, kind)(*given)
        except (rospy.ROSException, rospy.ServiceException, OSError) as error:
            why = f"{name} does not answer" + (f" ({hint})" if hint else f": {error}")
            raise RefusedError(why) from error


def _once(names: list[str]) -> list[str]:
    return list(dict.fromkeys(names))
