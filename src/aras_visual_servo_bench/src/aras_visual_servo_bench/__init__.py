"""Experiments and studies of visual servoing, without ROS.

The names of `__all__` are the public interface; those of `FIRST_PROJECT` come first. Each is
imported when it is first used.
"""

from typing import TYPE_CHECKING

from aras_visual_servo_base.lazy import lazy_exports

if TYPE_CHECKING:
    from .asked.experiment import Experiment as Experiment
    from .errors import BenchError as BenchError
    from .loading import load_run as load_run
    from .numbers.decay import predict_decay_rate as predict_decay_rate
    from .numbers.metrics import metric as metric
    from .recording.run import Run as Run
    from .running.environment import ServoEnv as ServoEnv
    from .running.loop import Loop as Loop
    from .running.loop import run as run
    from .setup.assembly import assemble as assemble
    from .study.replay import run_with_images as run_with_images
    from .study.results import Results as Results
    from .study.run_study import run_study as run_study
    from .study.study import Study as Study
    from .web.report.write import save_figure as save_figure
    from .web.report.write import write_report as write_report

_FIRST = {
    "Experiment": ".asked.experiment",
    "run": ".running.loop",
    "Run": ".recording.run",
    "load_run": ".loading",
    "write_report": ".web.report.write",
    "Study": ".study.study",
    "run_study": ".study.run_study",
    "Results": ".study.results",
    "metric": ".numbers.metrics",
}
_FURTHER = {
    "run_with_images": ".study.replay",
    "save_figure": ".web.report.write",
    "assemble": ".setup.assembly",
    "Loop": ".running.loop",
    "ServoEnv": ".running.environment",
    "predict_decay_rate": ".numbers.decay",
    "BenchError": ".errors",
}
FIRST_PROJECT = tuple(_FIRST)
__all__ = [*_FIRST, *_FURTHER]
if not TYPE_CHECKING:  # a type checker would take any name for one that there is
    __getattr__, __dir__ = lazy_exports(__name__, {**_FIRST, **_FURTHER})
