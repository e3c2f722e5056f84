"""`bench run` runs an experiment or a study, `bench resume` continues a study."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import ExperimentError, StudyError, find_program_name
from ..experiment import overrides
from ..experiment.experiment import Experiment
from ..experiment.experiment_keys import check_key
from ..experiment.packages import PackagePath
from ..metrics.formatting import format_count
from ..runner import loop
from ..studies import card, engine, images, tables
from ..studies.pools import CHUNKS_BEFORE_RESTART, DaskPool, InProcessPool, Pool
from ..studies.progress import format_duration
from ..studies.results import Results
from ..studies.study import Study
from ..studies.study_folder import StudyFolder, count_stored_runs

SCREEN_ROWS = 40  # a table with more rows is not printed
SCREEN_METRICS = ("settled", "final_distance", "image_excursion")


def add_parsers(commands: Any) -> None:
    """Add the parsers of `run` and `resume`."""
    run = commands.add_parser("run", help="run an experiment or a study")
    run.add_argument("study", nargs="?", type=Path, metavar="FILE|NAME",
                     help="YAML file of an experiment or a study, or name of a shipped study "
                          "(default: the experiment of the demo)")
    run.add_argument("overrides", nargs="*", metavar="key=value",
                     help="changed settings, for example gain=2.0 or repeats=5")
    run.add_argument("--out", type=Path, help="output folder: new, or of the same study; for an "
                                              "experiment the folder of its report")
    run.add_argument("--dry-run", action="store_true", help="only print what would be run")
    run.set_defaults(carry_out=_run)
    resume = commands.add_parser("resume", help="continue an unfinished study")
    resume.add_argument("folder", type=Path, help="study folder")
    resume.set_defaults(carry_out=_resume)
    for one in (run, resume):
        add_workers(one)
        one.add_argument("--fail-fast", action="store_true", help="stop after the first failed run")
        one.add_argument("--no-report", action="store_true",
                         help="do not write a table and figures")
        one.add_argument("--mix", action="store_true", help="continue even if the code has changed")


def add_workers(one: argparse.ArgumentParser) -> None:
    """Add the options of the worker processes."""
    one.add_argument("--workers", type=int, default=0, metavar="N",
                     help="number of processes on this machine (default: one per core)")
    one.add_argument("--in-process", action="store_true",
                     help="run everything in this process, without workers")
    one.add_argument("--scheduler", default="", metavar="ADDRESS",
                     help="address of a Dask scheduler with workers")
    one.add_argument("--cluster", default="", metavar="FILE",
                     help="YAML file with a Dask cluster class, its arguments and its workers")
    one.add_argument("--renew", type=int, default=CHUNKS_BEFORE_RESTART, metavar="N",
                     help="restart workers every N chunks (default %(default)s)")


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


def _run(options: argparse.Namespace) -> int:
    # The first argument is an override, not a file: change the experiment of the demo.
    if "=" in str(options.study or "") and not options.study.exists():
        options.overrides.insert(0, str(options.study))
        options.study = None
    changed = overrides.parse_overrides(options.overrides)
    experiment = _read_experiment(options.study, changed)
    if experiment is not None:
        return _run_experiment(experiment, options)
    options.study = find_study_file(options.study)
    study = Study.from_yaml(options.study, changed)
    engine.check_study(study)
    out = options.out or Path()
    room = images.check_room(study, out, count_stored_runs(out))
    if options.dry_run:
        if room:
            print(room)
        for line in engine.dry_run(study, _read_workers(options)):
            print(line)
        return 0
    if options.out is None:
        raise StudyError("give an output folder by --out DIR, or use --dry-run")
    text = options.study.read_text(encoding="utf-8")
    if changed or "experiment" in text and Study.from_yaml(options.study).digest != study.digest:
        text = yaml.safe_dump(study.to_mapping(), sort_keys=False)
    return carry_out(StudyFolder.create(options.out, study, text), options)


def _read_experiment(name: Path | None, changes: dict[str, Any]) -> Experiment | None:
    """Return the experiment in a file, with changed settings; return None if it is a study.

    If no file is given, it is the experiment of the demo.
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
    from ..studies import replay  # this import takes 0.5 s, and the workers do not need it
    from . import analyze

    for name in ("dry_run", "workers", "in_process", "scheduler", "cluster", "fail_fast", "mix"):
        if getattr(options, name):
            raise StudyError(f"--{name.replace('_', '-')} applies to studies, not to an experiment")
    name, source = ("demo", "") if options.study is None else (options.study.stem, options.study)
    out = None if options.no_report else options.out
    if out is None:
        run = loop.run(experiment)
        run.name = name
    else:
        run = replay.run_with_images(experiment, name, str(source))
    analyze.write_reports([run], out)
    return 0


def _resume(options: argparse.Namespace) -> int:
    folder = StudyFolder.open(options.folder)
    folder.check_file()
    return carry_out(folder, options)


def carry_out(folder: StudyFolder, options: argparse.Namespace) -> int:
    """Carry out the missing runs of a study, write its report, and return the exit status."""
    if not options.mix:
        folder.check_code()
    with folder.lock():
        has_all_runs = folder.count_stored_runs() == folder.study.run_count
        try:
            done = engine.run_missing(
                folder, lambda: make_pool(options), sys.stderr, options.fail_fast, options.mix
            )
        except StudyError as error:
            raise StudyError(f"{error}; {_describe_progress(folder)}") from error
        except KeyboardInterrupt:
            raise StudyError(f"interrupted; {_describe_progress(folder)}") from None
        if not has_all_runs:
            failed = "" if folder.study.pictures == "first" else (
                f"{done.failed} new runs failed, ")
            print(
                f"{done.runs} of {format_count(folder.study.run_count, 'run')} in {folder.path}, "
                f"{failed}"
                f"{format_duration(done.seconds)}"
            )
            if done.stopped:
                row = done.stopped
                print(f"stopped at run {row['run']}, {row['outcome']}: "
                      f"{row['reason'] or row['verdict']}; "
                      f"{find_program_name()} show {folder.path} {row['run']}")
                return 1
        else:
            print(f"all {done.runs} runs are in {folder.path}")
        if folder.study.has_image_rows:
            print(f"{card.write_card(folder)} describes the stored images and how to read them")
        if not options.no_report:
            _write_report(folder.path)
        return 0


def _write_report(path: Path) -> None:
    """Write the table and figures into the study's folder, and print a short table."""
    from ..plots import study_figures  # slow import (0.5 s) that the workers do not need

    found = [Results.read(path)]
    table = tables.make_table(found)
    (path / "table.md").write_text(tables.format_table(table, "md"), encoding="utf-8")
    names = [name for name in SCREEN_METRICS if name in found[0].study.metric_names]
    short = tables.format_table(tables.make_table(found, metrics=names), "md") if names else ""
    if short and len(table.rows) <= SCREEN_ROWS:
        print(f"\n{short}")
    drawn = study_figures.write_figures(found, path / "plots", paths=[path])
    print(f"{path / 'table.md'} has all metrics; figures: {', '.join(map(str, drawn))}")


def _describe_progress(folder: StudyFolder) -> str:
    return (
        f"{folder.count_stored_runs()} of {folder.study.run_count} runs are stored; continue with "
        f"{find_program_name()} resume {folder.path}"
    )


def _read_workers(options: argparse.Namespace) -> int:
    return 1 if options.in_process else options.workers or os.cpu_count() or 1


def make_pool(options: argparse.Namespace) -> Pool:
    """Create the workers that the options select.

    Raises:
        StudyError: the options are invalid or contradict each other.
    """
    if options.workers < 0 or options.renew < 1:
        raise StudyError("--workers must be 0 or more, and --renew 1 or more")
    if bool(options.scheduler) + bool(options.cluster) + options.in_process > 1:
        raise StudyError("use only one of --in-process, --scheduler and --cluster")
    if options.in_process:
        return InProcessPool()
    return DaskPool(options.workers, options.scheduler, options.cluster, options.renew)
