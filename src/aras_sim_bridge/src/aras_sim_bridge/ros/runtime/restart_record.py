"""Record of spawned models and loaded controllers on the parameter server.

The record survives a crash of the node. If the node is restarted (respawn_gazebo), it reads the
record at simulated time 0, spawns the models again at their initial poses, and loads and starts the
controllers.
"""

from __future__ import annotations

from collections.abc import Iterable

import rospy
from controller_manager_msgs.srv import LoadController, SwitchController
from gazebo_msgs.srv import SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion

from aras_sim_bridge.control.switching import STRICT, LoadedController
from aras_visual_servo_ros.parameters import get_namespace

PARAMETER = "~spawned"


class RestartRecord:
    """Spawned models and loaded controllers, in the order of spawning."""

    def __init__(self, enabled: bool) -> None:
        """Read the record that a previous node has left.

        If `enabled` is False, no record is read or written.
        """
        self._is_enabled = enabled
        self._previous = get_namespace(PARAMETER) if enabled else {}
        self._models: dict[str, dict[str, object]] = {}
        self._controllers: dict[str, list[tuple[str, bool]]] = {}

    def add_model(self, service: str, request: SpawnModel) -> None:
        """Record a model that was spawned by a call of `service`."""
        position, orientation = request.initial_pose.position, request.initial_pose.orientation
        self._models[request.model_name] = {
            "service": service,
            "name": request.model_name,
            "xml": request.model_xml,
            "namespace": request.robot_namespace,
            "position": [position.x, position.y, position.z],
            "orientation": [orientation.x, orientation.y, orientation.z, orientation.w],
            "frame": request.reference_frame,
        }
        self._write()

    def remove_model(self, name: str) -> None:
        """Remove a deleted model from the record."""
        self._models.pop(name, None)
        self._write()

    def set_controllers(self, namespace: str, controllers: Iterable[LoadedController]) -> None:
        """Record the controllers of the robot in `namespace`, and which of them are running."""
        self._controllers[namespace] = [(one.name, one.is_running) for one in controllers]
        self._write()

    def clear(self) -> None:
        """Delete the record; called when the node ends normally, so that nothing is restored."""
        if self._is_enabled and rospy.has_param(PARAMETER):
            rospy.delete_param(PARAMETER)
        self._is_enabled = False

    def restore(self) -> None:
        """Restore the recorded models and controllers by calling this node's own services."""
        for model in self._previous.get("models", ()):
            pose = Pose(Point(*model["position"]), Quaternion(*model["orientation"]))
            rospy.logwarn("model '%s' is restored after a restart of the simulator", model["name"])
            arguments = model["name"], model["xml"], model["namespace"], pose, model["frame"]
            _call_service(f"/gazebo/{model['service']}", SpawnModel, *arguments)
        for namespace, controllers in self._previous.get("controllers", ()):
            manager = f"{namespace}/controller_manager"
            for name, _ in controllers:
                _call_service(f"{manager}/load_controller", LoadController, name)
            running = [name for name, is_running in controllers if is_running]
            _call_service(
                f"{manager}/switch_controller", SwitchController, running, [], STRICT, False, 0.0
            )

    def _write(self) -> None:
        if self._is_enabled:
            controllers = [[name, loaded] for name, loaded in self._controllers.items() if loaded]
            models = list(self._models.values())
            rospy.set_param(PARAMETER, {"models": models, "controllers": controllers})


def _call_service(service: str, kind: type, *arguments: object) -> None:
    """Call a service and log an error if it fails, so that the restoration continues."""
    try:
        response = rospy.ServiceProxy(service, kind)(*arguments)
        reason = "" if getattr(response, "success", True) else response.status_message
    except rospy.ServiceException as error:
        reason = str(error)
    if reason:
        rospy.logerr("restoring by service %s failed: %s", service, reason)
