"""Faults of services: random requests to every service of the nodes."""

from __future__ import annotations

import rosservice
from gazebo_msgs.srv import SetPhysicsPropertiesRequest

from .arbitrary import Arbitrary
from .bed import JOINTS, ROBOT, Bed, UnansweredError
from .outcome import Outcome
from .traffic import judged

# What a client may rightly ask for and that ends the robot or the run is not asked by its name.
DESTRUCTIVE = ("delete_model", "unload_controller", "stop_controller", "switch_controller",
               "set_model_configuration", "reset")  # fmt: skip
# Kills every controller when it is asked to.
LEFT_OUT = ("reload_controller_libraries",)


def fuzzed(bed: Bed, scale: float, seed: int) -> Outcome:
    """Call every service with random requests, and restore the world's settings after each."""
    with bed.group("services by type") as outcome:
        physics = bed.call("/gazebo/get_physics_properties")
        each = max(round(130 * scale), 3)
        refused, diverged = 0, []
        for name in bed.services():
            if name.rpartition("/")[2] in LEFT_OUT:
                continue
            try:
                kind = rosservice.get_service_class_by_name(name)
            except rosservice.ROSServiceException as error:
                outcome.lost.append(f"{name}: {error}")
                continue
            known = () if any(word in name for word in DESTRUCTIVE) else _names()
            draw = Arbitrary(seed + len(name), known)
            for _ in range(each):
                outcome.injected += 1
                try:
                    answer = bed.call(name, draw.message(kind._request_class))
                    refused += not getattr(answer, "success", getattr(answer, "ok", True))
                except UnansweredError as error:
                    refused += 1
                    if error.hangs:
                        outcome.hung.append(str(error))
                        break
            diverged += [name] * put_back(bed, physics)
            judged(bed, outcome, each, f"after {each} calls of {name}")
        outcome.note = f"{len(bed.services())} services, {refused} calls refused"
        if diverged:
            outcome.note += f"; reset_simulation was needed after {', '.join(diverged)}"
    return outcome


def _names() -> tuple[str, ...]:
    return (ROBOT, "ground_plane", f"{ROBOT}::base_link", "base_link", "J1", "J6",
            *(f"{joint}_position_controller" for joint in JOINTS))  # fmt: skip


def put_back(bed: Bed, physics: object) -> bool:
    """Restore time step, gravity and posture; return whether the simulation had diverged."""
    bed.calm()
    fields = ("time_step", "max_update_rate", "gravity", "ode_config")
    bed.call(
        "/gazebo/set_physics_properties",
        SetPhysicsPropertiesRequest(**{name: getattr(physics, name) for name in fields}),
    )
    return reset_world(bed)


def reset_world(bed: Bed) -> bool:
    """Everything is put where it began. Whether the simulation had diverged: a step of half a
    second, or of two milliseconds with the shipped gains, may rightly be asked for, and
    reset_simulation fixes what comes of it, as it is said then."""
    try:
        bed.call("/gazebo/reset_world")
    except UnansweredError as error:
        if "then call reset_simulation" not in str(error):
            raise
        bed.call("/gazebo/reset_simulation")
        return True
    return False


GROUPS = (fuzzed,)
