"""`bench show DIR RUN` and `bench tune STUDY --over key=low:high --out DIR`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import yaml

from ..errors import StudyError
from ..study import engine, overrides
from ..study.folder import Folder
from ..study.progress import Progress
from ..study.study import Study
from . import running


def add(commands: Any) -> None:
    """The commands' own parsers."""
    show = commands.add_parser("show", help="one run again, with pictures, report and video")
    show.add_argument("folder", type=Path)
    show.add_argument("run", type=int)
    show.add_argument("--out", type=Path, metavar="DIR", help="default: show-RUN in the folder")
    show.set_defaults(carry_out=_show)
    tune = commands.add_parser("tune", help="search settings that make a metric best")
    tune.add_argument("study", type=Path, help="YAML file: the runs that every candidate meets")
    tune.add_argument("overrides", nargs="*", metavar="key=value")
    tune.add_argument("--over", action="append", default=[], metavar="key=low:high")
    tune.add_argument("--metric", default="settled", help="default: %(default)s")
    tune.add_argument("--evaluations", type=int, default=48, metavar="N", help="%(default)s")
    tune.add_argument("--success", type=float, default=1.0, metavar="PART",
                      help="of the runs that must succeed (%(default)s)")
    tune.add_argument("--out", type=Path, required=True)
    running.add_workers(tune)
    tune.set_defaults(carry_out=_tune)


def _show(options: argparse.Namespace) -> int:
    from ..study import replay  # half a second that the others need not wait for

    folder = Folder.open(options.folder)
    shown = replay.replay(folder, options.run)
    for path in replay.write(shown, options.out or options.folder / f"show-{options.run}"):
        print(path)
    for key, (old, new) in shown.changed.items():
        print(f"not as it was recorded: {key} was {old}, is {new}")
    return 0


def _tune(options: argparse.Namespace) -> int:
    from ..study.tuner import Range, Tuner

    study = Study.from_yaml(running.study_file(options.study), overrides.parsed(options.overrides))
    ranges = [Range.parsed(text) for text in options.over]
    engine.check_study(study)
    with running.pool(options) as workers:

        def carry_out(generation: Study, path: Path) -> None:
            text = yaml.safe_dump(generation.to_mapping(), sort_keys=False)
            folder = Folder.create(path, generation, text)
            folder.check_code()
            with folder.locked():
                progress = Progress(generation.runs, folder.done())
                engine.carry_out(folder, workers, progress)
                progress.close()

        tuner = Tuner(study, ranges, options.metric, options.out, carry_out, options.success)
        best = tuner.search(options.evaluations)
    path = tuner.write()
    told = ", ".join(f"{r.key}={v:g}" for r, v in zip(ranges, best.values, strict=True))
    print(f"{told}: {options.metric} {abs(best.cost):.4g}, success {best.success:.0%}, farthest in "
          f"the image {best.excursion:.2f}; of {len(tuner.tried)} candidates ({path})")
    if best.violation:
        raise StudyError("no candidate keeps all in the image and succeeds often enough")
    return 0
