"""`bench protocol NAME --out DIR` runs a published protocol, which is a study of this package.

In addition to the files of the study, it writes table.csv with a row for each run.
"""

from __future__ import annotations

import argparse
import dataclasses

from aras_visual_servo_base.names import suggest

from ..errors import StudyError
from ..studies import study_execution
from ..studies.results import Results
from ..studies.study import Study
from ..studies.study_folder import StudyFolder
from . import run
from .arguments import AXIS_OPTIONS

TABLE_FILE = "table.csv"


def run_protocol(options: argparse.Namespace) -> int:
    """Run the selected cases of a protocol, and write its table."""
    study = _select_cases(Study.from_yaml(run.find_study_file(options.study)), options)
    study_execution.check_study(study)
    status = run.carry_out(StudyFolder.create(options.out, study), options)
    written = Results.read(options.out).write_csv(options.out / TABLE_FILE)
    print(f"wrote {options.out / TABLE_FILE}: {written} runs")
    return status


def _select_cases(study: Study, options: argparse.Namespace) -> Study:
    """Return a copy of the study with only those cases that the options select.

    Raises:
        StudyError: an option names an unknown case.
    """
    changes: dict[str, object] = {}
    if options.seeds is not None:
        changes["repeats"] = options.seeds
    if options.first is not None:
        changes["seed"] = options.first
    for option, axis in AXIS_OPTIONS.items():
        names = getattr(options, option)
        if not names:
            continue
        known = [case.name for case in study.case_axes.get(axis, ())]
        for name in names:
            if name not in known:
                raise StudyError(f"{option} '{name}': {suggest(name, known)}")
        cases = [dict(case) for case in study.cases[axis] if case["name"] in names]
        changes["cases"] = {**(changes.get("cases") or study.cases), axis: cases}
    return dataclasses.replace(study, **changes)
