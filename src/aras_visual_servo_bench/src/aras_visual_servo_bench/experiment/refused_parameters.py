"""Parameters of the controller node that `controller_parameters` of an experiment cannot set."""

from __future__ import annotations

from collections.abc import Iterable

from ..errors import require

# Controller parameters that an experiment sets by a key of its own, with this key.
EXPERIMENT_KEYS = {
    "scheme": "scheme", "law": "law", "gain": "gain", "duration": "duration", "delay": "delay",
    "desired": "goal", "lockstep": "commands", "cameras": "cameras",
    "camera_frame": "robot.camera_frame", "target_frame": "robot.target_frame",
}  # fmt: skip
# Controller parameters that concern only the node and its ROS graph.
GRAPH_PARAMETERS = (
    "autostart", "base_frame", "camera_namespace", "command_topic", "controllers", "description",
    "dry", "image_timeout", "joint_timeout", "listeners", "namespace", "wall_watchdog",
)  # fmt: skip


def check_names(names: Iterable[str]) -> None:
    """Check that an experiment can set these controller parameters.

    Raises:
        ExperimentError: a parameter is set by another key, or has no effect without a ROS graph.
    """
    for name in names:
        require(name not in EXPERIMENT_KEYS,
                f"controller_parameters.{name} cannot be set: set the experiment's key "
                f"{EXPERIMENT_KEYS.get(name)} instead")
        require(name not in GRAPH_PARAMETERS,
                f"controller_parameters.{name} concerns the controller's ROS node, and an "
                "experiment has none: leave it out")
