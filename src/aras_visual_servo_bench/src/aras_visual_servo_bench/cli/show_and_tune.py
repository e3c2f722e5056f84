"""`bench show` repeats a run or prints the experiment of a bag; `bench tune` optimises settings."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import sys
import traceback
from pathlib import Path

import yaml

from ..errors import BenchError, StudyError, catch_write_errors, find_command
from ..experiment import overrides
from ..studies import study_execution
from ..studies.study import Study
from ..studies.study_folder import StudyFolder
from . import compilation, run


def show(options: argparse.Namespace) -> int:
    """Repeat a run of a study, or print the experiment of a bag."""
    if options.folder.is_file():
        return _show_bag(options)
    if options.run is None:
        raise StudyError(f"give the number of a run: {find_command()} show {options.folder} 0")
    from ..studies import replay  # this import takes 0.5 s, and only this command needs it
    from ..web.report.video import write_with_video

    folder = StudyFolder.open(options.folder)
    out = options.out or options.folder / f"show-{options.run}"
    compilation.prepare_simulation()
    try:
        run, changed = replay.replay(folder, options.run)
    except StudyError as error:
        if error.__cause__ is None or isinstance(error.__cause__, BenchError):
            raise
        with catch_write_errors(f"into {out}"):
            out.mkdir(parents=True, exist_ok=True)
            text = "".join(traceback.format_exception(error.__cause__))
            (out / "traceback.txt").write_text(text, encoding="utf-8")
        raise StudyError(f"{error}; traceback: {out / 'traceback.txt'}") from None
    for path in write_with_video(run, out):
        print(path)
    for key, (old, new) in changed.items():
        print(f"differs from the recorded run: {key} was {old}, is {new}")
    return 0


def _show_bag(options: argparse.Namespace) -> int:
    """Print the experiment of a bag; write it, and the files that it needs, into the folder --out.
    """
    from ..ros.bag import read_recorded_experiment

    if options.run is not None:
        raise StudyError(f"{options.folder} is a bag and contains only one run: omit the number")
    found = read_recorded_experiment(options.folder)
    text = yaml.safe_dump(found.make_mapping(), sort_keys=False, default_flow_style=None)
    files = {**found.collect_files(), "experiment.yaml": text}
    print(text, end="")
    for note in found.notes:
        print(f"# {note}")
    if options.out is not None:
        with catch_write_errors(f"into {options.out}"):
            options.out.mkdir(parents=True, exist_ok=True)
            for name, content in files.items():
                (options.out / name).write_text(content, encoding="utf-8")
    return 0


def tune(options: argparse.Namespace) -> int:
    """Search for settings that optimize a metric of a study."""
    from ..studies.tuner import SearchRange, Tuner

    study = Study.from_yaml(
        run.find_study_file(options.study), overrides.parse_overrides(options.overrides)
    )
    ranges = [SearchRange.parse(text) for text in options.over]
    # The search sets the keys of the tuned settings, so the study's own variations of these keys
    # are removed.
    keys = {r.key for r in ranges}
    study = dataclasses.replace(
        study, vary={key: values for key, values in study.vary.items() if key not in keys}
    )
    study_execution.check_study(study)
    with run.make_pool(options) as workers:

        def carry_out(generation: Study, path: Path) -> None:
            # the same workers run all generations, so a generation does not close them
            study_execution.run_in_folder(
                generation, path, lambda: contextlib.nullcontext(workers), sys.stderr
            )

        tuner = Tuner(study, ranges, options.metric, options.out, carry_out, options.success)
        best = tuner.search(options.evaluations)
    path = tuner.write()
    settings = ", ".join(f"{r.key}={v:g}" for r, v in zip(ranges, best.values, strict=True))
    print(f"{settings}: {options.metric} {abs(best.cost):.4g}, success {best.success:.0%}, image "
          f"excursion {best.excursion:.2f}; best of {len(tuner.candidates)} candidates ({path})")
    if best.violation:
        raise StudyError(
            "no candidate keeps the target in the image and reaches the required success rate"
        )
    return 0
