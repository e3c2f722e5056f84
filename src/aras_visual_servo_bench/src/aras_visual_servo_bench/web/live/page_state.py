"""State of the live page, and its messages to the viewers.

A new viewer receives a full message. Afterwards, all viewers receive updates that contain only the
values that have changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aras_visual_servo_controller.diagnosis.pose_uncertainty import NEGLIGIBLE_UNCERTAINTY
from aras_visual_servo_controller.records.state import ServoState

from ...visualization.drawing_shapes import DIGITS, TEXT, DrawingShape
from ...visualization.feature_units import find_feature_tolerances, find_feature_units
from ...visualization.run_drawing import RunDrawing
from .plot_samples import PlotSamples, to_json_numbers


class PageState:
    """State of the live page.

    Attributes:
        choices: names in each selection list of the page, by the key of the list.
        state: further values for the page, which can be encoded as JSON. They are sent when they
            change.
    """

    def __init__(self) -> None:
        self.choices: dict[str, list[str]] = {}
        self.state: dict[str, Any] = {}
        self._limits: dict[str, Any] = {}
        self._samples = PlotSamples()
        self._sent_values: dict[str, str | bytes] = {}
        self._controller_state: dict[str, Any] = {}
        self._shapes: dict[str, dict[str, Any]] = {}

    def set_robot(
        self, names: Sequence[str], lower: Sequence[float], upper: Sequence[float],
        velocity: Sequence[float], prismatic: Sequence[bool],
    ) -> None:  # fmt: skip
        """Set the joints of the robot and their limits.

        Args:
            names: name of each joint.
            lower, upper: position limits of each joint, m or rad.
            velocity: velocity limit of each joint, m/s or rad/s.
            prismatic: True for a prismatic joint.
        """
        self._limits = {
            "names": list(names), "lower": to_json_numbers(lower), "upper": to_json_numbers(upper),
            "velocity": to_json_numbers(velocity), "prismatic": [bool(p) for p in prismatic],
        }  # fmt: skip

    def add_sample(self, state: ServoState, joints: Sequence[float]) -> None:
        """Add a state of the controller to the plots.

        joints: joint positions at this state; empty if they are unknown.
        """
        error = () if state.error is None else state.error
        self._samples.add(state.phase, state.names, [
            round(state.stamp, 4), to_json_numbers(error), to_json_numbers(state.desired_twist),
            to_json_numbers(state.achieved_twist), to_json_numbers(joints),
        ])  # fmt: skip

    def make_full_message(self) -> dict[str, Any]:
        """Return the full message for a new viewer."""
        return {
            "kind": "full",
            "limits": self._limits,
            "choices": self.choices,
            "state": self.state,
            "controller": self._controller_state,
            "names": list(self._samples.names),
            "samples": self._samples.rows,
            "shapes": self._shapes,
        }

    def make_update(
        self, run_trace: RunDrawing | None, joints: Sequence[float], velocities: Sequence[float],
        stamp: float,
    ) -> dict[str, Any]:  # fmt: skip
        """Return an update with all values that have changed since the last call.

        Args:
            run_trace: drawing and states of the current run; None if there is no robot.
            joints: joint positions of the robot, m or rad.
            velocities: joint velocities of the robot, m/s or rad/s.
            stamp: stamp of the joint positions, s.
        """
        message: dict[str, Any] = {"kind": "update", "stamp": round(stamp, 3)}
        if run_trace is not None:
            message["joints"] = to_json_numbers(joints)
            message["velocities"] = to_json_numbers(velocities, 4)
            factor = run_trace.factor
            message["real_time_factor"] = None if factor is None else round(factor, 3)
            self._controller_state = _describe_controller(
                run_trace, len(run_trace.state.names or self._samples.names)
            )
            self._add_if_changed(message, "controller", self._controller_state)
            shapes = self._find_changed_shapes(run_trace.make_shapes())
            if shapes:
                message["shapes"] = shapes
        self._add_if_changed(message, "limits", self._limits)
        self._add_if_changed(message, "choices", self.choices)
        self._add_if_changed(message, "state", self.state)
        if news := self._samples.take_news():
            message["samples"], message["names"] = news, list(self._samples.names)
        return message

    def _add_if_changed(self, message: dict[str, Any], key: str, value: Mapping[str, Any]) -> None:
        fingerprint = repr(value)
        if self._sent_values.get(key) != fingerprint:
            self._sent_values[key] = fingerprint
            message[key] = value

    def _find_changed_shapes(
        self, shapes: Sequence[DrawingShape]
    ) -> dict[str, dict[str, Any] | None]:
        """Return the shapes that are new or have changed, by name; None for a removed shape."""
        changed: dict[str, dict[str, Any] | None] = {}
        names = set()
        for shape in shapes:
            if shape.kind == TEXT:
                continue  # the page shows texts next to its 3-D view, not in it
            names.add(shape.name)
            fingerprint = np.round(shape.points, DIGITS).tobytes()
            if self._sent_values.get(f"shape {shape.name}") == fingerprint:
                continue
            self._sent_values[f"shape {shape.name}"] = fingerprint
            changed[shape.name] = self._shapes[shape.name] = shape.to_json()
        for name in set(self._shapes) - names:
            del self._shapes[name]
            del self._sent_values[f"shape {name}"]
            changed[name] = None
        return changed


def _describe_controller(run_trace: RunDrawing, count: int) -> dict[str, Any]:
    """Return the state of the controller, with the units and tolerances of the plotted quantities.

    count: number of features in the plots. It is given because an image without a measurement has
        no features.

    `twist_tolerances` are the linear and angular speed that move the camera in 1 s by the distance
    and angle that the controller neglects. The first is null if the depth of the target is unknown.
    """
    state, depth = run_trace.state, run_trace.compute_target_depth()
    distance, angle = NEGLIGIBLE_UNCERTAINTY
    return {
        "scheme": state.scheme, "phase": state.phase, "outcome": state.outcome,
        "reason": state.reason, "remedy": state.remedy,
        "units": list(find_feature_units(state.scheme, count)),
        "tolerances": list(find_feature_tolerances(state.scheme, count, depth)),
        "twist_tolerances": [None if depth is None else distance * depth, angle],
    }  # fmt: skip
