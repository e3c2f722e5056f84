"""A recorded run by the name of its bag, folder, study or experiment."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from .errors import BenchError, ExperimentError
from .recording.run import Run

STUDY_RUN = re.compile(r"(.+):(\d+)$")


def _ignore_progress(part: float) -> None:
    """Show no progress."""


def load_run(source: str | Path, progress: Callable[[float], None] = _ignore_progress) -> Run:
    """Return the run that a bag, a folder, a study or an experiment holds, with its images.

    Args:
        source: one of
            a bag of ROS, also one whose recorder was cut off (needs ROS's Python packages);
            a folder with run.bag, as the demo writes it;
            FOLDER:NUMBER, a run of a study, which is carried out again;
            a YAML file of an experiment, which is carried out.
        progress: called with the part of a bag, 0 to 1, that is read.

    Raises:
        BenchError: there is no such run, or it cannot be read.
    """
    given = str(source)
    match, path = STUDY_RUN.match(given), Path(given)
    if match and not path.exists():
        from .studies import replay
        from .studies.study_folder import StudyFolder

        folder = StudyFolder.open(Path(match[1]))
        return replay.replay(folder, int(match[2]), f"{folder.path.name}:{match[2]}")[0]
    path = _find_file(path)
    if path.suffix in (".yaml", ".yml"):
        from .studies import replay

        try:
            return replay.run_with_images(path, path.stem, str(path))
        except ExperimentError as error:
            text = str(error)
            raise BenchError(text if text.startswith(str(path)) else f"{path}: {text}") from None
    try:
        from .ros.bag import read_bag
    except ImportError as error:
        raise BenchError(f"bags need ROS's Python packages: {error}") from None
    return read_bag(path, progress)


def _find_file(path: Path) -> Path:
    """The file that a path names, or the bag in a folder; BenchError if there is none."""
    if path.is_dir():
        bags = [path / name for name in ("run.bag", "run.bag.active") if (path / name).is_file()]
        if not bags:
            raise BenchError(
                f"{path} holds no run.bag; a study's run is named as {path}:NUMBER"
            )
        path = bags[0]
    active = path.with_name(path.name + ".active")  # of a recorder that was cut off
    if not path.is_file() and active.is_file():
        path = active
    if not path.is_file():
        raise BenchError(f"there is no file {path}")
    return path
