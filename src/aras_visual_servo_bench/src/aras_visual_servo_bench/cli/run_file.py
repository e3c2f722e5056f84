"""`bench run` runs an experiment or a study."""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path
from typing import Any

from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import ExperimentError, StudyError
from ..experiment import overrides
from ..experiment.experiment import Experiment
from ..experiment.experiment_keys import check_key
from ..metrics.formatting import make_printable
from ..runner import loop
from ..studies.study import Study
from . import analyze, compilation


def run_file(options: argparse.Namespace) -> int:
    """Run the experiment or the study of a file."""
    # If the first argument is an override (key=value) instead of a file, it changes the demo's
    # experiment.
    if "=" in str(options.study or "") and not options.study.exists():
        options.overrides.insert(0, str(options.study))
        options.study = None
    changes = overrides.parse_overrides(options.overrides)
    experiment = _read_experiment(options.study, changes)
    if experiment is not None:
        return _run_experiment(experiment, options)
    # this import takes 0.3 s and is needed only for studies
    from . import run

    return run.run_study(options, changes)


def _read_experiment(name: Path | None, changes: dict[str, Any]) -> Experiment | None:
    """Return the experiment in a file, with changed settings; None if the file contains a study.

    Without a file, the experiment is that of the demo.
    """
    values: Any = {}
    if name is not None:
        if not name.is_file():
            return None
        values = read_yaml(name, ExperimentError)
        keys = set(values) if isinstance(values, dict) else set()
        experiment_keys = {f.name for f in fields(Experiment)} - {f.name for f in fields(Study)}
        if not keys & experiment_keys:
            return None
    for key in changes:
        check_key(key)
    return Experiment.from_mapping(overrides.with_overrides(values, changes))


def _run_experiment(experiment: Experiment, options: argparse.Namespace) -> int:
    """Run an experiment, print its summary, and write its report into --out."""
    for name in ("dry_run", "workers", "in_process", "scheduler", "cluster", "renew", "fail_fast",
                 "mix"):  # fmt: skip
        if getattr(options, name):
            raise StudyError(f"--{name.replace('_', '-')} applies to studies, not to an experiment")
    if options.no_report and options.out is not None:
        raise StudyError("--out is the folder of an experiment's report, and --no-report writes no "
                         "report: leave out one of them")  # fmt: skip
    file = options.study
    name, source = ("demo", "") if file is None else map(make_printable, (file.stem, file))
    out = options.out
    compilation.prepare_simulation()
    if out is None:
        run = loop.run(experiment)
        run.name = name
    else:
        # this import takes 0.3 s, and only an experiment with a report needs it
        from ..studies import replay

        run = replay.run_with_images(experiment, name, source)
    analyze.write_reports([run], out)
    if out is None and not options.no_report:
        print("\nno report was written; --out DIR writes one: a page with curves, images and "
              "camera path, figures, and tables")  # fmt: skip
    return 0
