"""Commands of the live page: call services, set gains, and replace nodes, robot and target."""

from __future__ import annotations

import contextlib
import math
import threading
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

from aras_visual_servo_base.poses import matrix_from_xyz_rpy, pose_difference
from aras_visual_servo_base.yaml_files import read_yaml
from aras_visual_servo_controller.errors import ConfigurationError, ServoError
from aras_visual_servo_controller.goals.goal import REACH_TOLERANCE, Goal
from aras_visual_servo_controller.laws import LAWS
from aras_visual_servo_controller.schemes import SCHEMES
from aras_visual_servo_controller.settings import ControllerSettings

from ..errors import RefusedRequestError, catch_write_errors
from ..recording.recorded_experiment import find_preset
from .graph_listener import GraphListener
from .ros_launch import RosLaunch, wait_until
from .session_files import LOG_PREFIX
from .target_drawing_updater import TARGET_DESCRIPTION
from .target_pose_reader import TARGET

CONTROLLER, CAMERA = "/aras_visual_servo_controller", "/aras_visual_servo_camera"
CAMERA_PARAMETERS = "/gazebo/cameras/labrob/camera"
SERVICE_TIMEOUT = 5.0  # longest time to wait for a service, s of wall time
# Longest time to wait for restarted nodes, s of wall time, including the compilation of functions.
START_TIMEOUT = 60.0
STRICT_SWITCHING = 2
# smallest deviation of the camera from the requested pose that is reported, m and rad
POSE_TOLERANCE = 1e-5
DEFAULT_NODES = {"scheme": "moments", "law": "proportional", "start": "2016", "goal": "auto"}


class PageCommands:
    """Commands of the live page.

    Each command returns an answer for the user. If it fails, it raises RefusedRequestError with the
    reason.
    """

    def __init__(self, listener: GraphListener, settings: ControllerSettings, directory: Path,
                 robot: str) -> None:  # fmt: skip
        """Create the commands for a robot.

        Args:
            listener: subscriber of the robot's topics.
            settings: settings of the controller.
            directory: folder for goals, bags, reports and logs.
            robot: name of the robot's model in the simulator.
        """
        self._listener, self._settings, self.directory = listener, settings, directory
        self.robot, self._namespace = robot, settings.namespace.rstrip("/")
        # held by the command that is executed, so that only one command runs at a time
        self._lock = threading.Lock()
        self.gains: dict[str, float] = {}
        self.selection: dict[str, str] = {}
        self._launch: RosLaunch | None = None
        # package with the camera presets and the targets
        self._gazebo = Path(rospkg.RosPack().get_path("aras_visual_servo_gazebo"))
        # Settings of the camera in the robot description, and the name of the preset that has the
        # same settings.
        self._camera: tuple[dict[str, Any] | None, str] = None, ""
        rospy.Subscriber(f"{CONTROLLER}/gains/parameter_updates", Config, self._on_gains)

    def list_choices(self) -> dict[str, list[str]]:
        """Return the names in each selection list of the page, by the key of the list."""
        package, selection = self._settings.package, self.read_selection()
        shipped = sorted(p.stem[5:] for p in package.glob("config/goal_*.yaml"))
        taught = sorted(p.stem for p in self.directory.glob("goals/*.yaml"))
        of_one_camera = sorted(
            name for name, scheme in SCHEMES.items() if getattr(scheme, "camera_count", 1) == 1
        )
        starts = read_yaml(package / "config" / "starts.yaml", ConfigurationError)
        choices = {
            "scheme": of_one_camera,
            "law": sorted(LAWS),
            "start": ["none", *sorted(starts)],
            "goal": ["auto", *shipped, *taught],
        }
        for key, names in choices.items():
            if selection.get(key):
                names.append(selection[key])
        trace = self._listener.run_trace
        return {
            **{f"{key}s": list(dict.fromkeys(names)) for key, names in choices.items()},
            "cameras": sorted(p.stem for p in self._gazebo.glob("config/cameras/*.yaml")),
            "targets": sorted(p.stem for p in self._gazebo.glob("targets/*.urdf")),
            "gains": sorted(self.gains),
            "joints": [] if trace is None else list(trace.arm.names),
        }

    def read_selection(self) -> dict[str, str]:
        """Return the names of the current scheme, law, start, goal and camera.

        If the nodes are not running, the result contains the defaults. If the ROS master does not
        answer, the result is empty.
        """
        names = {"scheme": "scheme", "law": "law", "start": "start", "desired": "goal"}
        try:
            parameters = rospy.get_param(CONTROLLER, {})
            camera = self._find_preset_name(rospy.get_param(CAMERA_PARAMETERS, {}))
        except OSError:
            return {}
        found = {**DEFAULT_NODES, "camera": camera, **self.selection}
        if isinstance(parameters, dict):
            found |= {names[k]: str(v) for k, v in parameters.items() if k in names}
        return found

    def _find_preset_name(self, settings: dict[str, Any]) -> str:
        """Return the name of the camera preset that has these settings; '' if there is none."""
        if self._camera[0] != settings:
            preset = find_preset(settings)
            self._camera = settings, preset if isinstance(preset, str) else ""
        return self._camera[1]

    def control_loop(self, name: str) -> str:
        """Call the controller's service start, stop or hold."""
        answer = self._call(f"{self._namespace}/controller/{name}", Trigger,
                            "is the controller node running?")  # fmt: skip
        return answer.message

    def control_clock(self, name: str) -> str:
        """Call the simulator's service pause_physics, unpause_physics or reset_simulation."""
        self._call(f"/gazebo/{name}", Empty, "is the simulator running?")
        return {"pause_physics": "simulation paused", "unpause_physics": "simulation resumed",
                "reset_simulation": "simulation reset to time 0"}[name]  # fmt: skip

    def check_simulator(self) -> None:
        """Check that a simulator is running.

        Raises:
            RefusedRequestError: no simulator answers.
        """
        name = "/gazebo/get_world_properties"
        self._call(name, GetWorldProperties, "is the simulator running?")

    def step(self, steps: int) -> str:
        """Advance the paused simulation by a number of time steps."""
        answer = self._call("/gazebo/step_world", StepWorld, "is the simulator running?", steps)
        if not answer.success:
            raise RefusedRequestError(answer.status_message)
        return f"{steps} steps, to {answer.sim_time.to_sec():.3f} s"

    def set_gain(self, name: str, value: float) -> str:
        """Set a gain of the control law in the running controller."""
        config = Config(doubles=[DoubleParameter(name, value)])
        answer = self._call(f"{CONTROLLER}/gains/set_parameters", Reconfigure,
                            "is the controller node running?", config)  # fmt: skip
        after = {entry.name: entry.value for entry in answer.config.doubles}
        if name not in after:
            raise RefusedRequestError(
                f"the running control law has no gain {name}; its gains: {', '.join(after)}"
            )
        return f"{name} is {after[name]:.4g}"

    def restart_nodes(self, scheme: str, law: str, start: str, goal: str) -> str:
        """Restart the camera node and the controller node with a scheme, law, start and goal."""
        taught_goal = self.directory / "goals" / f"{goal}.yaml"
        if taught_goal.is_file():
            goal = str(taught_goal)
        return self._start_nodes(scheme, law, start, goal)

    def move_goal(self, x: float, y: float, z: float, turn: float) -> str:
        """Servo to a pose with an offset from the goal.

        If the arm cannot reach this pose exactly, the goal is the nearest reachable pose within
        REACH_TOLERANCE, and the answer contains the deviation.

        Args:
            x, y, z: translation of the camera in its frame at the goal, m.
            turn: rotation of the camera about its optical axis, rad.

        Raises:
            RefusedRequestError: there is no robot, or no pose within REACH_TOLERANCE is reachable.
        """
        selection, trace = self.read_selection(), self._listener.run_trace
        if trace is None:
            raise RefusedRequestError("there is no robot yet")
        settings = self._settings.from_mapping(
            {"start": selection.get("start", "none"), "desired": selection.get("goal", "auto")},
            self._settings.package,
        )
        try:
            before = self.selection.get("goal before", str(settings.find_goal_file()))
            goal = Goal.load(before).for_arm(trace.arm)
            moved = goal.world_T_camera @ matrix_from_xyz_rpy((x, y, z), (0.0, 0.0, turn))
            joints = trace.arm.inverse_kinematics(
                moved, goal.get_joints(trace.arm.names), REACH_TOLERANCE
            )
            reached = trace.arm.pose(joints)
            predicted = goal.predict_from_pose(reached)
        except ServoError as error:
            raise RefusedRequestError(f"this goal is not possible: {error}") from error
        values = dict(zip(trace.arm.names, joints.tolist(), strict=True))
        moved_goal = replace(predicted, joints=values)
        path = self.directory / "goals" / "moved.yaml"
        with catch_write_errors(path, RefusedRequestError):
            path.parent.mkdir(parents=True, exist_ok=True)
            text = moved_goal.to_yaml("Goal with an offset from the live page.")
            path.write_text(text, encoding="utf-8")
        answer = self._start_nodes(
            selection.get("scheme", "moments"), selection["law"], "none", str(path)
        )
        self.selection["goal before"] = before
        distance, angle = pose_difference(moved, reached)
        if max(distance, angle) < POSE_TOLERANCE:
            return answer
        return (f"{answer}; the nearest reachable pose differs from the requested one by "
                f"{1e3 * distance:.3f} mm and {math.degrees(angle):.3f} degrees")

    def _start_nodes(self, scheme: str, law: str, start: str, goal: str) -> str:
        with self._lock:
            self.selection.pop("goal before", None)
            self._end_nodes()
            self.directory.joinpath("log").mkdir(parents=True, exist_ok=True)
            self._launch = RosLaunch(
                ["aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch", f"scheme:={scheme}",
                 f"law:={law}", f"start:={start}", f"goal:={goal}"],
                self.directory / "log" / "nodes.txt",
            )  # fmt: skip
            ended = wait_until(
                lambda: self._launch.find_death_message() or self._is_ready(), START_TIMEOUT
            )
            if ended is not True:
                last_line = self._launch.read_last_lines(1).strip()
                why = last_line if ended else "the nodes do not answer"
                self._end_nodes()
                raise RefusedRequestError(
                    f"the controller did not start: {LOG_PREFIX.sub('', why)}"
                )
        return f"servoing with {scheme}, law {law}, from {start} to {Path(goal).stem}"

    def _is_ready(self) -> bool:
        """Return whether the controller node that this page starts offers its services."""
        try:
            return rosservice.get_service_node(f"{self._namespace}/controller/start") == CONTROLLER
        except (rosservice.ROSServiceException, OSError):
            return False

    def has_controller(self) -> bool:
        """Return whether a controller, started by any program, offers its services.

        Return True if the ROS master does not answer.
        """
        try:
            return rosservice.get_service_uri(f"{self._namespace}/controller/start") is not None
        except (rosservice.ROSServiceException, OSError):
            return True

    def _end_nodes(self) -> None:
        if self._launch is not None:
            self._launch.stop()
            self._launch = None
        with contextlib.suppress(rosnode.ROSNodeException, OSError):
            nodes = [name for name in (CONTROLLER, CAMERA) if name in rosnode.get_node_names()]
            rosnode.kill_nodes(nodes)
            wait_until(lambda: not set(nodes) & set(rosnode.get_node_names()), SERVICE_TIMEOUT)
        with contextlib.suppress(KeyError, OSError):
            rospy.delete_param(CONTROLLER)
        self.gains = {}

    def change_camera(self, preset: str) -> str:
        """Respawn the robot with another camera preset, and reload its controllers."""
        path = self._gazebo / "config" / "cameras" / f"{preset}.yaml"
        settings = read_yaml(path, ConfigurationError)
        manager = f"{self._namespace}/controller_manager"
        with self._lock:
            controllers = self._call(f"{manager}/list_controllers", ListControllers,
                               "are the robot's controllers loaded?").controller  # fmt: skip
            if rospy.has_param(CAMERA_PARAMETERS):
                rospy.delete_param(CAMERA_PARAMETERS)
            rospy.set_param(CAMERA_PARAMETERS, settings or {})
            self._call("/gazebo/delete_model", DeleteModel, "", self.robot)
            spawned = self._call("/gazebo/spawn_urdf_model", SpawnModel, "", self.robot,
                                 rospy.get_param(self._settings.description), "", Pose(), "")
            if not spawned.success:
                raise RefusedRequestError(
                    f"the robot could not be respawned: {spawned.status_message}"
                )
            for controller in controllers:
                self._call(f"{manager}/load_controller", LoadController, "", controller.name)
            running = [c.name for c in controllers if c.state == "running"]
            switched = self._call(f"{manager}/switch_controller", SwitchController, "", running,
                                  [], STRICT_SWITCHING, False, 0.0)  # fmt: skip
            if not switched.ok:
                raise RefusedRequestError(
                    "the robot was respawned, but its controllers did not start: "
                    "reset the simulation"
                )
        self.selection["camera"] = preset
        return f"the robot has the camera {preset}"

    def change_target(self, name: str) -> str:
        """Replace the target by the shipped target `name`, at the same pose."""
        text = (self._gazebo / "targets" / f"{name}.urdf").read_text(encoding="utf-8")
        with self._lock:
            state = self._call("/gazebo/get_model_state", GetModelState, "", TARGET, "")
            if not state.success:
                raise RefusedRequestError("there is no model named target to replace; launch the "
                                          f"simulator with target:={name}")
            self._call("/gazebo/delete_model", DeleteModel, "", TARGET)
            answer = self._call("/gazebo/spawn_urdf_model", SpawnModel, "", TARGET, text, "",
                                state.pose, "")  # fmt: skip
            if not answer.success:
                raise RefusedRequestError(answer.status_message)
            rospy.set_param(TARGET_DESCRIPTION, text)
        self.selection["target"] = name
        return f"the target is {name}"

    def close(self) -> None:
        """Stop the nodes that were started by `restart_nodes` and `move_goal`."""
        if self._launch is not None:
            self._launch.stop()

    def _on_gains(self, message: Config) -> None:
        self.gains = {entry.name: round(entry.value, 6) for entry in message.doubles}

    @staticmethod
    def _call(name: str, kind: type, hint: str, *arguments: object) -> Any:
        """Call a service, and return its response.

        Args:
            name: name of the service.
            kind: type of the service.
            hint: probable cause of a failure, for the message.
            arguments: fields of the request.

        Raises:
            RefusedRequestError: the service does not exist or fails.
        """
        try:
            rospy.wait_for_service(name, SERVICE_TIMEOUT)
            return rospy.ServiceProxy(name, kind)(*arguments)
        except (rospy.ROSException, rospy.ServiceException, OSError) as error:
            why = f"{name} does not answer" + (f" ({hint})" if hint else f": {error}")
            raise RefusedRequestError(why) from error
