"""Games with time: pauses, resets and other steps while the arm servoes."""

from __future__ import annotations

import random
import time

from gazebo_msgs.srv import SetPhysicsPropertiesRequest

from .bed import Bed
from .outcome import Outcome
from .traffic import judged


def games(bed: Bed, scale: float, seed: int) -> Outcome:
    """Pause, go on, resets and other steps, in any order and close together."""
    draw = random.Random(seed)
    with bed.group("games with the clock") as outcome:
        physics = bed.call("/gazebo/get_physics_properties")
        for turn in range(max(round(30 * scale), 3)):
            outcome.injected += 1
            if turn == 0:
                _play(bed, draw, physics, "reset_simulation")  # the one that sets time back
            for _ in range(draw.randint(1, 4)):
                _play(bed, draw, physics)
                time.sleep(draw.choice((0.0, 0.05, 0.3)))
            _play(bed, draw, physics, "step back")
            bed.calm()
            judged(bed, outcome, 1, "after games with the clock")
    return outcome


def _play(bed: Bed, draw: random.Random, physics: object, what: str = "") -> None:
    what = what or draw.choice(("pause", "go on", "reset_world", "reset_simulation", "step"))
    if what == "pause":
        bed.call("/gazebo/pause_physics")
    elif what == "go on":
        bed.calm()
    elif what.startswith("reset"):
        bed.call(f"/gazebo/{what}")
    else:
        step = 0.001 if what == "step back" else draw.choice((0.0005, 0.002, 0.004))
        fields = {name: getattr(physics, name) for name in ("gravity", "ode_config")}
        bed.call(
            "/gazebo/set_physics_properties",
            SetPhysicsPropertiesRequest(time_step=step, max_update_rate=1.0 / step, **fields),
        )


GROUPS = (games,)
