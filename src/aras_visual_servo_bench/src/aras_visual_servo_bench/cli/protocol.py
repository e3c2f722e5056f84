"""`bench protocol NAME --out DIR`: a published protocol, as `bench run` of the study of that name.

Besides the study's folder it leaves table.csv, a row a run.
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
    """The command's own parser."""
    parser = commands.add_parser("protocol", help="carry out a published protocol, as a table")
    parser.add_argument("study", metavar="NAME", type=Path, help="of a shipped study, or a file")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, help="fewer or more than the file says")
    parser.add_argument("--first", type=int, help="first seed")
    for option in AXIS_OPTIONS:
        parser.add_argument(f"--{option}", action="append", help=f"only these {option}s")
    parser.add_argument("--mix", action="store_true", help="go on although the code has changed")
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
    """The study with what the command line says; StudyError: a name that it has not."""
    changes: dict[str, object] = {}
    if options.seeds is not None:
        changes["repeats"] = options.seeds
    if options.first is not None:
        changes["seed"] = options.first
    for option, axis in AXIS_OPTIONS.items():
        wanted = getattr(options, option)
        if not wanted:
            continue
        known = [case.name for case in study.case_axes.get(axis, ())]
        for name in wanted:
            if name not in known:
                raise StudyError(f"{option} '{name}': {suggest(name, known)}")
        kept = [dict(case) for case in study.cases[axis] if case["name"] in wanted]
        changes["cases"] = {**(changes.get("cases") or study.cases), axis: kept}
    return dataclasses.replace(study, **changes)
