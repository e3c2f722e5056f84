"""Experiments and studies of visual servoing, without ROS.

`__all__` lists the public interface; `FIRST_PROJECT` lists the names that a first project needs.
Each name is imported when it is first used.
"""

from typing import TYPE_CHECKING

from aras_visual_servo_base.lazy_imports import lazy_exports

if TYPE_CHECKING:
    from .errors import BenchError as BenchError
    from .experiment.experiment import Experiment as Experiment
    from .metrics.decay import predict_decay_rate as predict_decay_rate
    from .metrics.metric import metric as metric
    from .recording.run import Run as Run
    from .run_loading import load_run as load_run
    from .runner.environment import ServoEnv as ServoEnv
    from .runner.loop import Loop as Loop
    from .runner.loop import run as run
    from .setup.assembly import assemble as assemble
    from .studies.replay import run_with_images as run_with_images
    from .studies.results import Results as Results
    from .studies.run_study import run_study as run_study
    from .studies.study import Study as Study
    from .web.report.write import save_figure as save_figure
    from .web.report.write import write_report as write_report

_FIRST = {
    "Experiment": ".experiment.experiment",
    "run": ".runner.loop",
    "Run": ".recording.run",
    "load_run": ".run_loading",
    "write_report": ".web.report.write",
    "Study": ".studies.study",
    "run_study": ".studies.run_study",
    "Results": ".studies.results",
    "metric": ".metrics.metric",
}
_FURTHER = {
    "run_with_images": ".studies.replay",
    "save_figure": ".web.report.write",
    "assemble": ".setup.assembly",
    "Loop": ".runner.loop",
    "ServoEnv": ".runner.environment",
    "predict_decay_rate": ".metrics.decay",
    "BenchError": ".errors",
}
FIRST_PROJECT = tuple(_FIRST)
__all__ = [*_FIRST, *_FURTHER]
# Type checkers do not see `__getattr__`; with it, they would accept any name of this module.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy_exports(__name__, {**_FIRST, **_FURTHER})
