"""Load a run from a bag, a folder, a study or the settings file of an experiment."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from .errors import BenchError, ExperimentError
from .recording.run import Run

STUDY_RUN = re.compile(r"(.+):(\d+)$")


def _ignore_progress(part: float) -> None:
    """Do nothing; used when the caller does not want to know the progress."""


def load_run(source: str | Path, progress: Callable[[float], None] = _ignore_progress) -> Run:
    """Return a run with its images, from a bag, a folder, a study or an experiment.

    Args:
        source: one of
            a ROS bag, even if its recorder was killed (reading it needs ROS's Python packages);
            a folder with a run.bag, as written by the demo;
            FOLDER:NUMBER: run NUMBER of the study in FOLDER; this function repeats the run;
            a YAML file of an experiment; this function runs the experiment.
        progress: called with the fraction of the bag that has been read, 0 to 1.

    Raises:
        BenchError: the run does not exist or cannot be read.
    """
    source_text = str(source)
    match, path = STUDY_RUN.match(source_text), Path(source_text)
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
        import rosbag  # noqa: F401, of `read_bag`

        from .ros.bag import read_bag
    except ImportError as error:
        raise BenchError(
            f"reading a bag needs ROS's Python packages ({error}); run: source "
            "devel/setup.bash"
        ) from None
    return read_bag(path, progress)


def _find_file(path: Path) -> Path:
    """Return the file at a path, or the bag in a folder.

    Raises:
        BenchError: there is no such file or bag.
    """
    if path.is_dir():
        bags = [path / name for name in ("run.bag", "run.bag.active") if (path / name).is_file()]
        if not bags:
            raise BenchError(
                f"{path} has no run.bag; for a run of a study give {path}:NUMBER"
            )
        path = bags[0]
    # name of the bag if the recorder was killed before it closed the bag
    active = path.with_name(path.name + ".active")
    if not path.is_file() and active.is_file():
        path = active
    if not path.is_file():
        raise BenchError(f"there is no file {path}")
    return path
