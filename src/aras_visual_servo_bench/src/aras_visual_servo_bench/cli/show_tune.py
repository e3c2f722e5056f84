"""`bench show DIR RUN`, `bench show BAG` and `bench tune STUDY --over key=low:high --out DIR`."""

from __future__ import annotations

import argparse
import dataclasses
import traceback
from pathlib import Path
from typing import Any

import yaml

from ..errors import BenchError, StudyError, catch_write_errors, find_program_name
from ..experiment import overrides
from ..studies import engine
from ..studies.progress import Progress
from ..studies.study import Study
from ..studies.study_folder import StudyFolder
from . import run


def add_parsers(commands: Any) -> None:
    """The commands' own parsers."""
    show = commands.add_parser("show", help="a study's run again, with report and video; of a bag, "
                               "the experiment that it holds")  # fmt: skip
    show.add_argument("folder", type=Path, metavar="DIR|BAG", help="a study's folder, or a bag")
    show.add_argument("run", type=int, nargs="?", help="number of the study's run")
    show.add_argument("--out", type=Path, metavar="DIR", help="of a run, default: show-RUN in the "
                      "folder; of a bag: where experiment, parameters, description and goal go")
    show.set_defaults(carry_out=_show)
    tune = commands.add_parser("tune", help="search settings that make a metric best")
    tune.add_argument("study", type=Path, help="YAML file: the runs that every candidate meets")
    tune.add_argument("overrides", nargs="*", metavar="key=value",
                      help="other values, as in repeats=5")
    tune.add_argument("--over", action="append", default=[], metavar="key=low:high",
                      help="a setting and its range, as in gain=0.5:4; as often as is needed")
    tune.add_argument("--metric", default="settled", help="default: %(default)s")
    tune.add_argument("--evaluations", type=int, default=48, metavar="N", help="%(default)s")
    tune.add_argument("--success", type=float, default=1.0, metavar="PART",
                      help="of the runs that must succeed (%(default)s)")
    tune.add_argument("--out", type=Path, required=True, help="folder of the candidates")
    run.add_workers(tune)
    tune.set_defaults(carry_out=_tune)


def _show(options: argparse.Namespace) -> int:
    if options.folder.is_file():
        return _show_bag(options)
    if options.run is None:
        raise StudyError(f"say which run: {find_program_name()} show {options.folder} 0")
    from ..studies import replay  # half a second that the others need not wait for
    from ..web.report.video import write_with_video

    folder = StudyFolder.open(options.folder)
    out = options.out or options.folder / f"show-{options.run}"
    try:
        run, changed = replay.replay(folder, options.run)
    except StudyError as error:
        if error.__cause__ is None or isinstance(error.__cause__, BenchError):
            raise
        raise StudyError(
            f"{error}; where it was raised: {_write_traceback(error.__cause__, out)}"
        ) from None
    for path in write_with_video(run, out):
        print(path)
    for key, (old, new) in changed.items():
        print(f"not as it was recorded: {key} was {old}, is {new}")
    return 0


def _write_traceback(error: BaseException, out: Path) -> Path:
    """The file in the folder that now says where an exception was raised."""
    path = out / "traceback.txt"
    with catch_write_errors(f"into {out}"):
        out.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
    return path


def _show_bag(options: argparse.Namespace) -> int:
    """The experiment of a bag, to be run again; and into --out whatever it was made of."""
    from ..ros.bag import read_recorded_experiment

    if options.run is not None:
        raise StudyError(f"{options.folder} is a bag: it holds one run")
    found = read_recorded_experiment(options.folder)
    told = yaml.safe_dump(found.make_mapping(), sort_keys=False, default_flow_style=None)
    files = {**found.collect_files(), "experiment.yaml": told}
    print(told, end="")
    for note in found.notes:
        print(f"# {note}")
    if options.out is not None:
        with catch_write_errors(f"into {options.out}"):
            options.out.mkdir(parents=True, exist_ok=True)
            for name, text in files.items():
                (options.out / name).write_text(text, encoding="utf-8")
    return 0


def _tune(options: argparse.Namespace) -> int:
    from ..studies.tuner import SearchRange, Tuner

    study = Study.from_yaml(
        run.find_study_file(options.study), overrides.parse_overrides(options.overrides)
    )
    ranges = [SearchRange.parse(text) for text in options.over]
    sought = {r.key for r in ranges}  # what is looked for no longer varies, as with key=value
    study = dataclasses.replace(
        study, vary={key: given for key, given in study.vary.items() if key not in sought}
    )
    engine.check_study(study)
    with run.make_pool(options) as workers:

        def carry_out(generation: Study, path: Path) -> None:
            text = yaml.safe_dump(generation.to_mapping(), sort_keys=False)
            folder = StudyFolder.create(path, generation, text)
            folder.check_code()
            with folder.lock():
                progress = Progress(generation.run_count, folder.count_stored_runs())
                engine.carry_out(folder, workers, progress)
                progress.close()

        tuner = Tuner(study, ranges, options.metric, options.out, carry_out, options.success)
        best = tuner.search(options.evaluations)
    path = tuner.write()
    told = ", ".join(f"{r.key}={v:g}" for r, v in zip(ranges, best.values, strict=True))
    print(f"{told}: {options.metric} {abs(best.cost):.4g}, success {best.success:.0%}, farthest in "
          f"the image {best.excursion:.2f}; of {len(tuner.candidates)} candidates ({path})")
    if best.violation:
        raise StudyError("no candidate keeps all in the image and succeeds often enough")
    return 0
