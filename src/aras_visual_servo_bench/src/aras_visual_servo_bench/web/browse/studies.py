"""The results of all studies below some folders, in one table in memory.

The results are read from the Parquet files of the studies, and read again after a file has changed.
100 000 runs with 28 columns need 24 MB and take 3.5 s to read. A query of the page takes 1 to 20 ms
with Arrow.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from ...errors import StudyError
from ...experiment.experiment_keys import find_unit
from ...metrics import metrics
from ...metrics.formatting import make_printable
from ...metrics.metric import Metric
from ...studies.columns import LABEL_COLUMNS
from ...studies.results import Results
from ...studies.study_folder import MANIFEST, PARTS, TIMES, StudyFolder

READ_PERIOD = 1.0  # shortest time between two readings of the folders, s
MAX_FOLDER_DEPTH = 4  # number of folder levels that are searched for studies below a given folder
MAX_STUDIES = 200
# Names of two columns that are added to the results: name of the study, outcome of the run.
STUDY, END = "study", "end"
SETTING, METRIC, OTHER = "setting", "metric", "run"


@dataclass
class StudyEntry:
    """A study in one of the folders.

    Attributes:
        name: unique name of the study.
        path: path of its folder.
        run_count: planned number of runs.
        note: message about a problem with the study; '' if there is none.
        results: stored results; None if they could not be read yet.
        folder: reader of its folder; None if it could not be opened yet.
        fingerprint: modification times and sizes of its files.
    """

    name: str
    path: Path
    run_count: int = 0
    note: str = ""
    results: Results | None = None
    folder: StudyFolder | None = None
    fingerprint: tuple = ()

    @property
    def stored_run_count(self) -> int:
        """Number of runs with stored results."""
        return 0 if self.results is None else self.results.table.num_rows


@dataclass(frozen=True)
class StudiesSnapshot:
    """The state of all studies at one time.

    Attributes:
        version: number that increases with every change of a study.
        studies: all studies.
        table: runs of all studies, with the name of the study and the outcome of each run.
        units: unit of each column, by name.
        roles: role of each column, by name: 'setting', 'metric' or 'run'.
        binary: binary metrics, by the name of their column.
        note: message about studies that are not shown; '' if there are none.
    """

    version: int
    studies: tuple[StudyEntry, ...]
    table: pa.Table
    units: dict[str, str] = field(default_factory=dict)
    roles: dict[str, str] = field(default_factory=dict)
    binary: dict[str, Metric] = field(default_factory=dict)
    note: str = ""

    def find_study(self, name: str) -> StudyEntry:
        """Return the study with the name `name`.

        Raises:
            StudyError: there is no such study.
        """
        for entry in self.studies:
            if entry.name == name:
                return entry
        raise StudyError(
            f"there is no study {name[:60]!r} in the folders of this results browser"
        )


class Studies:
    """Reads the studies in some folders; its methods can be called from any thread."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """Create a reader.

        Args:
            folders: folders of studies, or folders that contain folders of studies.

        Raises:
            StudyError: a folder does not exist.
        """
        for path in folders:
            if not path.is_dir():
                raise StudyError(f"there is no folder {path}")
        self._folders = [path.resolve() for path in folders]
        self._entries: dict[Path, StudyEntry] = {}
        self._lock, self._read_time = threading.Lock(), float("-inf")
        self._snapshot = StudiesSnapshot(0, (), pa.table({}))

    def read_snapshot(self, is_forced: bool = False) -> StudiesSnapshot:
        """Return the current state of all studies.

        The folders are read at most once in READ_PERIOD.

        is_forced: True to read them now, even if they have just been read.
        """
        with self._lock:
            if is_forced or time.monotonic() - self._read_time > READ_PERIOD:
                self._update()
                self._read_time = time.monotonic()
            return self._snapshot

    def _update(self) -> None:
        found = list(self._find_folders())
        note = ""
        if len(found) > MAX_STUDIES:
            note = (
                f"only the first {MAX_STUDIES} studies are shown: start the results browser with "
                "folders that contain fewer studies"
            )
        changed = note != self._snapshot.note
        for path in found[:MAX_STUDIES]:
            if path not in self._entries:
                self._entries[path] = StudyEntry(self._choose_name(path), path)
                changed = True
        for entry in self._entries.values():
            changed |= _update_entry(entry)
        if changed:
            studies = tuple(self._entries.values())
            table, units, roles = _join_tables(studies)
            binary = {m.name: m for entry in studies if entry.results is not None
                      for m in entry.results.metrics if m.is_binary}  # fmt: skip
            self._snapshot = StudiesSnapshot(
                self._snapshot.version + 1, studies, table, units, roles, binary, note
            )

    def _find_folders(self) -> Iterator[Path]:
        """Yield the folders of studies, at most MAX_STUDIES + 1; links are not followed."""
        count = 0
        for root in self._folders:
            for path, folders, files in os.walk(root):
                if MANIFEST in files:
                    yield Path(path)
                    count += 1
                is_deepest = len(Path(path).relative_to(root).parts) >= MAX_FOLDER_DEPTH
                folders[:] = [] if MANIFEST in files or is_deepest else sorted(folders)
                if count > MAX_STUDIES:
                    return

    def _choose_name(self, path: Path) -> str:
        """Return a unique name of a study: its folder's name, with parent folders if necessary."""
        taken = {entry.name for entry in self._entries.values()}
        for parts in range(1, len(path.parts) + 1):
            name = make_printable("/".join(path.parts[-parts:]))
            if name not in taken:
                return name
        return f"{make_printable(path)} ({len(taken) + 1})"


def _update_entry(entry: StudyEntry) -> bool:
    """Read the files of a study if they have changed, and return whether they have."""
    fingerprint = _compute_fingerprint(entry.path)
    if fingerprint == entry.fingerprint:
        return False
    before, entry.fingerprint, entry.note = entry.fingerprint, fingerprint, ""
    try:
        # open the folder again if its manifest is new or has changed
        if entry.folder is None or before[:1] != fingerprint[:1]:
            entry.folder = StudyFolder.open(entry.path)
            entry.run_count = entry.folder.study.run_count
        entry.results = Results.from_folder(entry.folder)
    except StudyError as error:  # the results that were read earlier are still shown
        entry.note = str(error)
        if not fingerprint[0]:
            entry.results, entry.folder, entry.note = None, None, f"{entry.path} was removed"
    return True


def _compute_fingerprint(path: Path) -> tuple:
    """Return the modification times and sizes of a study's manifest and Parquet files."""
    try:
        manifest = (path / MANIFEST).stat()
    except OSError:
        return (0,)
    parts = []
    for kind in (PARTS, TIMES):
        with contextlib.suppress(OSError):
            for file in (path / kind).glob("*.parquet"):
                stat = file.stat()
                parts.append((kind, file.name, stat.st_mtime_ns, stat.st_size))
    return ((manifest.st_mtime_ns, manifest.st_size), *sorted(parts))


def _join_tables(studies: Sequence[StudyEntry]) -> tuple[pa.Table, dict[str, str], dict[str, str]]:
    """Return a table with the runs of all studies, and the units and roles of its columns."""
    tables, units, roles = [], {}, {}
    for entry in studies:
        if entry.results is None:
            continue
        results = entry.results
        table = results.table.drop_columns(
            [name for name in LABEL_COLUMNS if name in results.table.column_names]
        )
        success = pa.array(results.compute_successes(), pa.float64())
        if metrics.success.name in table.column_names:
            table = table.drop_columns([metrics.success.name])
        columns = {
            STUDY: pa.repeat(entry.name, table.num_rows),
            **dict(zip(table.column_names, table.columns, strict=True)),
            END: results.make_end_column(), metrics.success.name: success,
        }  # fmt: skip
        tables.append(pa.table(columns))
        roles |= {key: SETTING for key in results.study.keys if key in columns}
        units |= {key: find_unit(key) for key in results.study.keys}
        roles |= {one.name: METRIC for one in results.metrics}
        units |= {one.name: one.unit for one in results.metrics}
        roles[metrics.success.name] = METRIC
    units |= {"simulated": "s", "distance_tolerance": "m", "angle_tolerance": "rad"}
    joined = _unify_types(tables)
    return joined, units, {name: roles.get(name, OTHER) for name in joined.column_names}


def _unify_types(tables: Sequence[pa.Table]) -> pa.Table:
    """Concatenate tables. A column that contains text in any table becomes a text column."""
    if not tables:
        return pa.table({})
    kinds: dict[str, set[pa.DataType]] = {}
    for table in tables:
        for column in table.schema:
            kinds.setdefault(column.name, set()).add(column.type)
    column_types = {}
    for name, types in kinds.items():
        types.discard(pa.null())
        if len(types) == 1:
            column_types[name] = types.pop()
        elif all(pa.types.is_integer(kind) or pa.types.is_floating(kind) for kind in types):
            column_types[name] = pa.float64()
        else:
            column_types[name] = pa.string()
    unified = []
    for table in tables:
        columns = {
            name: table[name].cast(kind) if name in table.column_names
            else pa.nulls(table.num_rows, kind) for name, kind in column_types.items()
        }  # fmt: skip
        unified.append(pa.table(columns))
    return pa.concat_tables(unified).combine_chunks()
