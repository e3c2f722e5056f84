"""`bench dataset STUDY --out DIR` writes the runs of a study as a data set for learning."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import yaml

from ..studies import engine, images
from ..studies.study import Study
from ..studies.study_folder import StudyFolder, count_stored_runs
from . import run


def add_parser(commands: Any) -> None:
    """Add the parser of `dataset`."""
    one = commands.add_parser(
        "dataset", help="run a study, and store image, joints, pose and twist of every image")
    one.add_argument("study", type=Path, metavar="FILE|NAME",
                     help="YAML file of a study, or name of a shipped study")
    one.add_argument("overrides", nargs="*", metavar="key=value",
                     help="changed settings, for example repeats=1000 or features=images")
    one.add_argument("--out", type=Path, required=True,
                     help="folder of the data set; an existing one of the same study is continued")
    one.add_argument("--views", action="store_true",
                     help="store only the first image of each run, the view from the start")
    one.add_argument("--depth", action="store_true", help="also store depth images")
    run.add_workers(one)
    one.set_defaults(carry_out=_make_dataset, fail_fast=False, no_report=True, mix=False)


def _make_dataset(options: argparse.Namespace) -> int:
    from ..experiment.overrides import parse_overrides

    path = run.find_study_file(options.study)
    changed = {**parse_overrides(options.overrides), "pictures": "first" if options.views
        else "all",
               "depth": options.depth}  # fmt: skip
    study = Study.from_yaml(path, changed)
    engine.check_study(study)
    print(images.check_room(study, options.out, count_stored_runs(options.out)))
    text = yaml.safe_dump(study.to_mapping(), sort_keys=False)
    return run.carry_out(StudyFolder.create(options.out, study, text), options)
