"""Apply the remedy, a suggested change of settings after a failure, to a run's experiment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from aras_visual_servo_base.poses import exponential, logarithm, relative_pose, xyz_rpy_from_matrix
from aras_visual_servo_controller.errors import UnreachableError
from aras_visual_servo_controller.goals.goal import REACH_TOLERANCE
from aras_visual_servo_controller.records.remedy import Remedy, SettingChange
from aras_visual_servo_controller.settings import ControllerSettings

from ..errors import ExperimentError
from ..experiment.experiment import (
    FREE_CAMERA_PLANTS,
    CameraPoseSpec,
    Experiment,
    RandomStart,
)
from ..experiment.loop_settings import make_loop_settings
from ..experiment.overrides import with_override
from ..setup.assembly import Assembly, assemble
from ..targets.geometry import DEFAULT_SIZE
from ..targets.target_factory import find_shape

LAW_PREFIX = "controller_parameters.law_options."


def apply_remedy(experiment: Experiment, remedy: Remedy) -> Experiment:
    """Return the experiment with the changes that the remedy of its run suggests.

    Changes that cannot be applied are skipped.

    Raises:
        ExperimentError: the remedy contains no change, or none of its changes can be applied.
    """
    refused = [f"the remedy changes no setting: '{remedy}'"]
    changed = experiment
    for change in remedy.changes:
        try:
            changed = _apply_change(changed, change)
        except ExperimentError as error:
            refused.append(str(error))
    if changed is experiment:
        raise ExperimentError(refused[-1])
    return changed


def _apply_change(experiment: Experiment, change: SettingChange) -> Experiment:
    if change.operation == "multiply" and change.key in SCALE_FUNCTIONS:
        return SCALE_FUNCTIONS[change.key](experiment, float(change.value))
    key, values = _to_experiment_key(change.key), experiment.to_mapping()
    if change.operation == "remove":
        return Experiment.from_mapping(_remove_key(values, key.split("."), change.key))
    value = change.value
    if change.operation == "multiply":
        value = _multiply(_read_effective_value(experiment, key), value, change.key)
    return Experiment.from_mapping(with_override(values, key, value))


def _to_experiment_key(key: str) -> str:
    """Return the dotted key of the experiment for a controller parameter or an experiment key."""
    head = key.partition(".")[0]
    if head in {f.name for f in fields(Experiment)}:
        return key
    if head in {f.name for f in fields(ControllerSettings)}:
        return f"controller_parameters.{key}"
    raise ExperimentError(f"an experiment has no key '{key}'")


def _remove_key(values: Mapping[str, Any], path: list[str], key: str) -> dict[str, Any]:
    """Return a copy of nested mappings without the entry at `path`.

    key: dotted key of the entry, for the error message.

    Raises:
        ExperimentError: the key is not set.
    """
    head, rest = path[0], path[1:]
    if head not in values or rest and not isinstance(values[head], Mapping):
        raise ExperimentError(f"{key} is not set, so it cannot be removed")
    others = {name: value for name, value in values.items() if name != head}
    return {**others, head: _remove_key(values[head], rest, key)} if rest else others


def _read_effective_value(experiment: Experiment, key: str) -> Any:
    """Return the value of a dotted key; if it is not set, the default of the controller."""
    value: Any = experiment
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else getattr(value, part)
        if value is None:
            break
    if value is None:
        settings = make_loop_settings(experiment)
        if key == "gain" or key.startswith(LAW_PREFIX):
            return settings.make_law().list_tunable_parameters().get(key.removeprefix(LAW_PREFIX))
        value = getattr(settings, key.removeprefix("controller_parameters."))
    return value


def _multiply(value: Any, factor: float, key: str) -> Any:
    """Multiply a number, or all numbers of a list or mapping.

    Raises:
        ExperimentError: a value is not a number.
    """
    if isinstance(value, Mapping):
        return {name: _multiply(one, factor, key) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_multiply(one, factor, key) for one in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ExperimentError(f"{key} is {value!r}: it cannot be multiplied by {factor:g}")
    return value * factor


def _scale_target(experiment: Experiment, factor: float) -> Experiment:
    """Return the experiment with the lengths of its target multiplied by a factor."""
    target = experiment.target
    named = find_shape(target.shape)
    if target.is_link or named is not None and not hasattr(named, "size"):
        raise ExperimentError(
            f"target.size: {target.link or target.shape} has a fixed size; use another shape"
        )
    changes: dict[str, Any] = {}
    if isinstance(target.shape, tuple):
        changes["shape"] = _multiply(target.shape, factor, "target.shape")
        if target.size is not None:
            changes["size"] = _multiply(target.size, factor, "target.size")
    elif target.scale is not None:
        changes["scale"] = target.scale * factor
    else:
        changes["size"] = _multiply(
            target.size or getattr(named, "size", DEFAULT_SIZE), factor, "target.size"
        )
    if target.occluder is not None:
        changes["occluder"] = _multiply(target.occluder, factor, "target.occluder")
    values = experiment.to_mapping()
    return Experiment.from_mapping({**values, "target": {**values["target"], **changes}})


def _scale_start(experiment: Experiment, factor: float) -> Experiment:
    """Return the experiment with the offset of its start from its goal multiplied by a factor.

    For an arm, the offset of the joints is multiplied; for a free camera, the offset of the pose.
    """
    parts = assemble(experiment)
    try:
        if isinstance(experiment.start, RandomStart):
            return experiment.with_changes(start=_scale_sampler(experiment.start, parts, factor))
        if experiment.plant in FREE_CAMERA_PLANTS:
            offset = logarithm(relative_pose(parts.goal_pose, parts.plant.read_pose()))
            xyz, rpy = xyz_rpy_from_matrix(parts.goal_pose @ exponential(factor * offset))
            pose = CameraPoseSpec((*map(float, xyz), *map(float, rpy)))
            return experiment.with_changes(start=pose)
        first = np.array(parts.plant.read_joints()[0])
        goal = parts.postures.arm.inverse_kinematics(parts.goal_pose, first, REACH_TOLERANCE)
        return experiment.with_changes(start=tuple((goal + factor * (first - goal)).tolist()))
    except UnreachableError as error:
        raise ExperimentError(f"start: {error}") from error
    finally:
        parts.plant.close()


def _scale_sampler(sampler: RandomStart, parts: Assembly, factor: float) -> RandomStart:
    """Return a sampler of starts with its maximum offsets from the goal multiplied by a factor."""
    target = parts.target.world_T_target(0.0)
    goal_height = float(parts.goal_pose[2, 3] - target[2, 3])
    low, high = (goal_height + factor * (height - goal_height) for height in sampler.height)
    return replace(
        sampler, height=(low, high), side=factor * sampler.side, turn=factor * sampler.turn,
        tilt=factor * sampler.tilt,
    )  # fmt: skip


def _scale_goal(experiment: Experiment, factor: float) -> Experiment:
    """Return the experiment with the offset of its goal from its start multiplied by a factor.

    The goal is then given by joint positions.
    """
    if experiment.plant in FREE_CAMERA_PLANTS:
        raise ExperimentError("goal: a free camera reaches every pose, so the goal needs no change")
    parts = assemble(experiment)
    try:
        first = parts.plant.read_pose()
        offset = logarithm(relative_pose(first, parts.goal_pose))
        pose = first @ exponential(factor * offset)
        joints = np.array(parts.plant.read_joints()[0])
        joints = parts.postures.arm.inverse_kinematics(pose, joints, 0.1)
        return experiment.with_changes(goal=tuple(joints.tolist()))
    except UnreachableError as error:
        raise ExperimentError(f"goal: {error}") from error
    finally:
        parts.plant.close()


SCALE_FUNCTIONS = {"target.size": _scale_target, "start": _scale_start, "goal": _scale_goal}
