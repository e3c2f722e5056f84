"""`bench dataset STUDY --out DIR`: pictures and numbers of a study's runs, for those who learn."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import yaml

from ..study import engine, images
from ..study.folder import Folder, kept_runs
from ..study.study import Study
from . import running


def add(commands: Any) -> None:
    """The command's own parser."""
    one = commands.add_parser(
        "dataset", help="a study's runs with pictures, joints, poses and twists of every image")
    one.add_argument("study", type=Path, metavar="FILE|NAME",
                     help="YAML file of a study, or a shipped study's name")
    one.add_argument("overrides", nargs="*", metavar="key=value",
                     help="other values, as in repeats=1000 or features=pictures")
    one.add_argument("--out", type=Path, required=True,
                     help="folder of the data set; new, or of the same one, which is gone on with")
    one.add_argument("--views", action="store_true",
                     help="the first image of each run alone: views from the study's starts")
    one.add_argument("--depth", action="store_true", help="depth images too")
    running.add_workers(one)
    one.set_defaults(carry_out=_dataset, fail_fast=False, no_report=True, mix=False)


def _dataset(options: argparse.Namespace) -> int:
    from ..asked.overrides import parsed

    given = running.study_file(options.study)
    changed = {**parsed(options.overrides), "pictures": "first" if options.views else "all",
               "depth": options.depth}  # fmt: skip
    study = Study.from_yaml(given, changed)
    engine.check_study(study)
    print(images.check_room(study, options.out, kept_runs(options.out)))
    text = yaml.safe_dump(study.to_mapping(), sort_keys=False)
    return running.carry_out(Folder.create(options.out, study, text), options)
