"""Measurement of the complete control loop in one process; loop.py uses it."""

from __future__ import annotations

import statistics
import time
from typing import Any

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble

RATE = 30
clock = time.process_time_ns  # of all threads: the renderer's too


class _Stopwatch:
    """Sum of the processor time of calls, by name."""

    def __init__(self) -> None:
        self.spent: dict[str, int] = {}

    def wrap(self, owner: Any, method: str, name: str) -> None:
        """Measure the calls of owner.method under a name."""
        call, spent = getattr(owner, method), self.spent
        spent.setdefault(name, 0)

        def timed(*arguments: Any, **options: Any) -> Any:
            began = clock()
            try:
                return call(*arguments, **options)
            finally:
                spent[name] += clock() - began

        setattr(owner, method, timed)


def closed_loop(seconds: float) -> dict[str, Any]:
    """Servo repeatedly from the start of 2016; return the figures of the fastest simulated second.
    """
    experiment = Experiment(time_after_convergence=None, duration=1e6)
    best = float("inf")
    loop = _fresh(experiment)
    for k in range(max(round(seconds), 2)):
        if k % 4 == 0:  # as often under way as arrived
            loop.close()
            loop = _fresh(experiment)
        began = clock()
        _images(loop, RATE)
        best = min(best, (clock() - began) / 1e9)
    loop.close()
    parts, image = _parts(experiment)
    return {
        "real_time_multiple": round(1.0 / best, 1),
        "second_ms": round(best * 1e3, 2),
        "parts_ms": parts,
        "image_to_command_ms": image,
    }


def _fresh(experiment: Experiment) -> Loop:
    loop = Loop(experiment, assemble(experiment))
    _images(loop, 10)  # lists of the renderer, tables of the camera
    return loop


def _images(loop: Loop, count: int) -> None:
    for _ in range(count):
        loop.run_to_image()


def _parts(experiment: Experiment) -> tuple[dict[str, float], float]:
    """Return the time (ms) of each part per simulated second, and the median time of an image."""
    loop, watch = _fresh(experiment), _Stopwatch()
    sensor = loop.plant._simulation.camera("/labrob/camera").sensor
    watch.wrap(sensor.renderer, "render", "drawing")
    watch.wrap(loop.parts, "observe", "features")
    watch.wrap(loop.servo, "process_image", "scheme, law and diagnosis of images")
    watch.wrap(loop.servo, "update", "resolver and limits at joint states")
    watch.wrap(loop, "send", "sending")
    images, before = [], dict(watch.spent)
    began = clock()
    for _ in range(2 * RATE):
        loop.run_to_image()
    whole = clock() - began
    spent = {name: (ns - before[name]) / 2e6 for name, ns in watch.spent.items()}
    for _ in range(RATE):
        before = dict(watch.spent)
        loop.run_to_image()
        per = {name: watch.spent[name] - before[name] for name in before}
        ticks = 100 / RATE
        images.append(
            per["drawing"] + per["features"] + per["scheme, law and diagnosis of images"]
            + (per["resolver and limits at joint states"] + per["sending"]) / ticks
        )  # fmt: skip
    loop.close()
    spent["physics, controllers and the rest"] = whole / 2e6 - sum(spent.values())
    return {k: round(v, 2) for k, v in spent.items()}, round(statistics.median(images) / 1e6, 3)


