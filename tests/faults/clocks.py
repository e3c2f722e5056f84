"""Faults of the clock while the arm servoes: pauses, resets and changed time steps."""

from __future__ import annotations

import random
import time

from gazebo_msgs.srv import SetPhysicsPropertiesRequest

from .bed import Bed
from .outcome import Outcome
from .services import reset_world
from .traffic import judged


def games(bed: Bed, scale: float, seed: int) -> Outcome:
    """Pause, resume, reset and change the time step, in random order and close together."""
    draw = random.Random(seed)
    with bed.group("games with the clock") as outcome:
        physics, diverged = bed.call("/gazebo/get_physics_properties"), 0
        for turn in range(max(round(30 * scale), 3)):
            outcome.injected += 1
            if turn == 0:
                _play(bed, draw, physics, "reset_simulation")  # the one that sets time back
            for _ in range(draw.randint(1, 4)):
                _play(bed, draw, physics)
                time.sleep(draw.choice((0.0, 0.05, 0.3)))
            _play(bed, draw, physics, "step back")
            bed.calm()
            diverged += reset_world(bed)
            judged(bed, outcome, 1, "after games with the clock")
        if diverged:
            outcome.note = f"reset_simulation was needed after {diverged} of them"
    return outcome


def _play(bed: Bed, draw: random.Random, physics: object, what: str = "") -> None:
    what = what or draw.choice(("pause", "go on", "reset_world", "reset_simulation", "step"))
    if what == "pause":
        bed.call("/gazebo/pause_physics")
    elif what == "go on":
        bed.calm()
    elif what == "reset_world":
        reset_world(bed)
    elif what == "reset_simulation":
        bed.call("/gazebo/reset_simulation")
    else:
        step = 0.001 if what == "step back" else draw.choice((0.0005, 0.002, 0.004))
        fields = {name: getattr(physics, name) for name in ("gravity", "ode_config")}
        bed.call(
            "/gazebo/set_physics_properties",
            SetPhysicsPropertiesRequest(time_step=step, max_update_rate=1.0 / step, **fields),
        )


GROUPS = (games,)
