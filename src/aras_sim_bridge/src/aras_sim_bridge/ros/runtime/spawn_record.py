"""What stands in the world, written down on the parameter server, where it outlives the node.

A node that died and is started again in its place (respawn_gazebo) finds there what was spawned
and which controllers were loaded, and brings them back as they were launched, at time 0.
"""

from __future__ import annotations

from collections.abc import Iterable

import rospy
from controller_manager_msgs.srv import LoadController, SwitchController
from gazebo_msgs.srv import SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion

from aras_sim_bridge.control.switching import RUNNING, STRICT, ControllerInfo
from aras_visual_servo_ros.parameters import get_namespace

PARAMETER = "~spawned"


class SpawnRecord:
    """Models and controllers, in the order in which they came."""

    def __init__(self, enabled: bool) -> None:
        """Take what an earlier node left; without `enabled` nothing is read or written."""
        self._is_enabled = enabled
        self._previous = get_namespace(PARAMETER) if enabled else {}
        self._models: dict[str, dict[str, object]] = {}
        self._controllers: dict[str, list[tuple[str, bool]]] = {}

    def add_model(self, service: str, request: SpawnModel) -> None:
        """A model has come by a call of `service`."""
        at, turned = request.initial_pose.position, request.initial_pose.orientation
        self._models[request.model_name] = {
            "service": service,
            "name": request.model_name,
            "xml": request.model_xml,
            "namespace": request.robot_namespace,
            "position": [at.x, at.y, at.z],
            "orientation": [turned.x, turned.y, turned.z, turned.w],
            "frame": request.reference_frame,
        }
        self._write()

    def remove_model(self, name: str) -> None:
        """A model has gone."""
        self._models.pop(name, None)
        self._write()

    def set_controllers(self, namespace: str, controllers: Iterable[ControllerInfo]) -> None:
        """The controllers of the robot in `namespace`, after a change."""
        self._controllers[namespace] = [(info.name, info.state == RUNNING) for info in controllers]
        self._write()

    def clear(self) -> None:
        """The node ends as it should: nothing is to come back."""
        if self._is_enabled and rospy.has_param(PARAMETER):
            rospy.delete_param(PARAMETER)
        self._is_enabled = False

    def restore(self) -> None:
        """Bring back what was left, as a client of this node's own services."""
        for model in self._previous.get("models", ()):
            pose = Pose(Point(*model["position"]), Quaternion(*model["orientation"]))
            rospy.logwarn("model '%s' is brought back after the simulator's end", model["name"])
            given = model["name"], model["xml"], model["namespace"], pose, model["frame"]
            _call_service(f"/gazebo/{model['service']}", SpawnModel, *given)
        for namespace, controllers in self._previous.get("controllers", ()):
            manager = f"{namespace}/controller_manager"
            for name, _ in controllers:
                _call_service(f"{manager}/load_controller", LoadController, name)
            running = [name for name, runs in controllers if runs]
            _call_service(
                f"{manager}/switch_controller", SwitchController, running, [], STRICT, False, 0.0
            )

    def _write(self) -> None:
        if self._is_enabled:
            controllers = [[name, found] for name, found in self._controllers.items() if found]
            models = list(self._models.values())
            rospy.set_param(PARAMETER, {"models": models, "controllers": controllers})


def _call_service(service: str, kind: type, *arguments: object) -> None:
    """Call a service; one failure does not stop the others."""
    try:
        answer = rospy.ServiceProxy(service, kind)(*arguments)
        refused = "" if getattr(answer, "success", True) else answer.status_message
    except rospy.ServiceException as error:
        refused = str(error)
    if refused:
        rospy.logerr("%s: %s; it does not come back", service, refused)
