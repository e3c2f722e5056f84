"""`bench protocol NAME --out DIR` runs a published protocol, which is one of the shipped studies.

In addition to the files of the study, it writes table.csv with a row for each run.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import yaml

from aras_visual_servo_base.names import suggest

from ..errors import StudyError
from ..studies import engine
from ..studies.results import Results
from ..studies.study import Study
from ..studies.study_folder import StudyFolder
from . import run

TABLE_FILE = "table.csv"
AXIS_OPTIONS = {"case": "scheme", "condition": "condition", "start": "start"}  # option: axis


def add_parser(commands: Any) -> None:
    """Add the parser of `protocol`."""
    parser = commands.add_parser("protocol", help="run a published protocol, and write a table")
    parser.add_argument("study", metavar="NAME", type=Path,
                        help="name of a shipped study, or a study's YAML file")
    parser.add_argument("--out", type=Path, required=True, help="output folder")
    parser.add_argument("--seeds", type=int, help="number of seeds (default: that of the study)")
    parser.add_argument("--first", type=int, help="first seed (default: that of the study)")
    for option in AXIS_OPTIONS:
        parser.add_argument(f"--{option}", action="append",
                            help=f"run only this {option}; can be repeated")
    parser.add_argument("--mix", action="store_true", help="continue even if the code has changed")
    run.add_workers(parser)
    parser.set_defaults(fail_fast=False, no_report=True, carry_out=_carry_out)


def _carry_out(options: argparse.Namespace) -> int:
    study = _select_cases(Study.from_yaml(run.find_study_file(options.study)), options)
    engine.check_study(study)
    text = yaml.safe_dump(study.to_mapping(), sort_keys=False)
    status = run.carry_out(StudyFolder.create(options.out, study, text), options)
    written = Results.read(options.out).write_csv(options.out / TABLE_FILE)
    print(f"wrote {options.out / TABLE_FILE}: {written} runs")
    return status


def _select_cases(study: Study, options: argparse.Namespace) -> Study:
    """Return the study with the cases that the options select.

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
