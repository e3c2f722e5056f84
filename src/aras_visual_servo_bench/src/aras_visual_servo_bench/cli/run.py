"""Run and continue studies: `bench run STUDY` and `bench resume`."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import StudyError, find_command
from ..experiment.packages import PackagePath
from ..metrics.formatting import format_count
from ..studies import data_card, image_table, study_execution, tables
from ..studies.cli_defaults import CHUNKS_BEFORE_RESTART
from ..studies.dask_pool import DaskPool
from ..studies.pools import InProcessPool, Pool
from ..studies.results import Results
from ..studies.study import Study
from ..studies.study_folder import StudyFolder, count_stored_runs
from ..studies.study_progress import format_duration
from . import compilation

SCREEN_ROWS = 40  # largest number of rows of a table that is printed
SCREEN_METRICS = ("contradicts", "settled", "final_distance", "image_excursion")


def find_study_file(name: Path) -> Path:
    """Return the path of the file of a study.

    name: path of the file, or name of a shipped study.

    Raises:
        StudyError: there is neither a file nor a shipped study with this name.
    """
    shipped = Path(PackagePath().find("aras_visual_servo_bench")) / "config" / "studies"
    named = shipped / f"{name.name}.yaml"
    if name.exists() or name.suffix or len(name.parts) > 1:
        return name
    if not named.is_file():
        known = sorted(path.stem for path in shipped.glob("*.yaml"))
        raise StudyError(
            f"there is no file {name}, and no shipped study of this name: "
            f"{suggest(name.name, known)}"
        )
    return named


def run_study(options: argparse.Namespace, changes: dict[str, Any]) -> int:
    """Run a study with changed settings, or only estimate its duration (--dry-run)."""
    options.study = find_study_file(options.study)
    study = Study.from_yaml(options.study, changes)
    study_execution.check_study(study)
    out = options.out or Path()
    room = image_table.check_room(study, out, count_stored_runs(out))
    if options.dry_run:
        if room:
            print(room)
        # a dry run simulates run 0 twice to estimate the time of the study
        compilation.prepare_simulation()
        workers = 1 if options.in_process else options.workers or os.cpu_count() or 1
        for line in study_execution.dry_run(study, workers):
            print(line)
        return 0
    if options.out is None:
        raise StudyError("give an output folder by --out DIR, or use --dry-run")
    # A copy of the file would not find the experiment's file by a relative path.
    has_path = isinstance(read_yaml(options.study, StudyError).get("experiment"), str)
    text = None if changes or has_path else options.study.read_text(encoding="utf-8")
    return carry_out(StudyFolder.create(options.out, study, text), options)


def resume(options: argparse.Namespace) -> int:
    """Continue an unfinished study."""
    folder = StudyFolder.open(options.folder)
    folder.check_file()
    return carry_out(folder, options)


def carry_out(folder: StudyFolder, options: argparse.Namespace) -> int:
    """Carry out the runs of a study that have no result yet, and write its report.

    Return the exit status.
    """
    if not options.mix:
        folder.check_code()
    with folder.lock():
        try:
            done = study_execution.run_missing(
                folder, lambda: make_pool(options), sys.stderr, options.fail_fast, options.mix
            )
        except StudyError as error:
            raise StudyError(f"{error}; {_describe_progress(folder)}") from error
        except KeyboardInterrupt:
            raise StudyError(f"interrupted; {_describe_progress(folder)}") from None
        if done.new_runs:
            failed = f"{done.failed} new runs without success, "
            print(
                f"{done.runs} of {format_count(folder.study.run_count, 'run')} in {folder.path}, "
                f"{'' if folder.study.pictures == 'first' else failed}"
                f"{format_duration(done.seconds)}"
            )
            if done.stopped:
                row = done.stopped
                print(f"stopped after run {row['run']}, which ended with {row['outcome']} "
                      f"({row['reason'] or row['verdict']}); repeat it with "
                      f"{find_command()} show {folder.path} {row['run']}")
                return 1
        else:
            print(f"all {done.runs} runs are in {folder.path}")
        if folder.study.has_image_rows:
            path = data_card.write_card(folder)
            print(f"{path} describes the stored images and how to read them")
        if not options.no_report:
            _write_report(folder.path)
        return 0


def _write_report(path: Path) -> None:
    """Write a table and figures of the results into the study's folder, and print a short table."""
    from ..plots import study_figures  # this import takes 0.5 s, and workers do not need it

    found = [Results.read(path)]
    table = tables.make_table(found)
    (path / "table.md").write_text(tables.format_table(table, "md"), encoding="utf-8")
    names = [name for name in SCREEN_METRICS if name in found[0].study.metric_names]
    short = tables.format_table(tables.make_table(found, metrics=names), "md") if names else ""
    if short and len(table.rows) <= SCREEN_ROWS:
        print(f"\n{short}")
    drawn = study_figures.write_figures(found, path / "plots", paths=[path])
    print(f"{path / 'table.md'} has all metrics; figures: {', '.join(map(str, drawn))}")
    print(f"{find_command()} browse {path} shows the runs and their reports in a browser")


def _describe_progress(folder: StudyFolder) -> str:
    return (
        f"{folder.count_stored_runs()} of {folder.study.run_count} runs are stored; continue with "
        f"{find_command()} resume {folder.path}"
    )


def make_pool(options: argparse.Namespace) -> Pool:
    """Create the worker processes that the options select; first compile functions if necessary.

    Raises:
        StudyError: the options are invalid or contradict each other.
    """
    renew = CHUNKS_BEFORE_RESTART if options.renew is None else options.renew
    if options.workers < 0 or renew < 1:
        raise StudyError("--workers must be 0 or more, and --renew 1 or more")
    if bool(options.scheduler) + bool(options.cluster) + options.in_process > 1:
        raise StudyError("use only one of --in-process, --scheduler and --cluster")
    if options.in_process and (options.workers or options.renew is not None):
        raise StudyError("--in-process starts no workers: leave out --workers and --renew")
    if options.workers and (options.scheduler or options.cluster):
        raise StudyError("--scheduler and --cluster determine the number of workers: leave out "
                         "--workers")  # fmt: skip
    compilation.prepare_simulation()
    if options.in_process:
        return InProcessPool()
    return DaskPool(options.workers, options.scheduler, options.cluster, renew)
