"""`bench dataset STUDY --out DIR` writes the runs of a study as a data set for learning."""

from __future__ import annotations

import argparse

from ..experiment.overrides import parse_overrides
from ..studies import image_table, study_execution
from ..studies.study import Study
from ..studies.study_folder import StudyFolder, count_stored_runs
from . import run


def make_dataset(options: argparse.Namespace) -> int:
    """Run a study, and store its images as a data set; return the exit status."""
    path = run.find_study_file(options.study)
    changed = {
        **parse_overrides(options.overrides),
        "pictures": "first" if options.views else "all", "depth": options.depth,
    }  # fmt: skip
    study = Study.from_yaml(path, changed)
    study_execution.check_study(study)
    print(image_table.check_room(study, options.out, count_stored_runs(options.out)))
    return run.carry_out(StudyFolder.create(options.out, study), options)
