"""The studies below some folders, as they stand now: their rows in one table, kept in memory.

Rows stay where the studies wrote them, in Parquet; a part is read once, and again where it has
changed. 100 000 runs of 28 columns take 24 MB and 3.5 s, once. Arrow answers what the page asks of
them in 1 to 20 ms, as DuckDB does (filter 17 and 14 ms, sort 6 and 6, groups 8 and 6), which would
be 68 MB more to install.
"""

from __future__ import annotations

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
from ...studies import rows
from ...studies.results import Results
from ...studies.study_folder import MANIFEST, PARTS, TIMES, StudyFolder

READ_PERIOD = 1.0  # s, at least, between two looks at the folders
MAX_FOLDER_DEPTH = 4  # folders below one that is given, in which studies are looked for
MAX_STUDIES = 200  # studies
STUDY, END = "study", "end"  # columns beside those of the rows
SETTING, METRIC, OTHER = "setting", "metric", "run"


@dataclass
class StudyEntry:
    """A study that was found.

    Attributes:
        name: that no other has. path: its folder. of: how many runs it is to have.
        note: what is wrong with it, '' for nothing. results: None: no row could be read yet.
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
        """Rows that are there."""
        return 0 if self.results is None else self.results.table.num_rows


@dataclass(frozen=True)
class Snapshot:
    """All studies at one time.

    Attributes:
        version: another one where anything is another.
        note: what is not shown, '' for nothing.
        table: rows of all, each with its study's name and how it ended.
        units, roles: of its columns, by name; a role is 'setting', 'metric' or 'run'.
    """

    version: int
    studies: tuple[StudyEntry, ...]
    table: pa.Table
    units: dict[str, str] = field(default_factory=dict)
    roles: dict[str, str] = field(default_factory=dict)
    note: str = ""

    def find_study(self, name: str) -> StudyEntry:
        """That of a name; StudyError where there is none."""
        for seen in self.studies:
            if seen.name == name:
                return seen
        raise StudyError(f"there is no study {name[:60]!r} here")


class Studies:
    """Looks at folders, from any thread."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """`folders`: folders of studies, or of folders of studies.

        Raises:
            StudyError: one of them is none.
        """
        for path in folders:
            if not path.is_dir():
                raise StudyError(f"there is no folder {path}")
        self._folders = [path.resolve() for path in folders]
        self._entries: dict[Path, StudyEntry] = {}
        self._lock, self._read_time = threading.Lock(), float("-inf")
        self._snapshot = Snapshot(0, (), pa.table({}))

    def read_snapshot(self, is_forced: bool = False) -> Snapshot:
        """How they stand; read anew at most once a second, unless `is_forced`."""
        with self._lock:
            if is_forced or time.monotonic() - self._read_time > READ_PERIOD:
                self._update()
                self._read_time = time.monotonic()
            return self._snapshot

    def _update(self) -> None:
        found = list(self._find_folders())
        note = ""
        if len(found) > MAX_STUDIES:
            note = f"only the first {MAX_STUDIES} studies are shown: name folders that hold fewer"
        changed = note != self._snapshot.note
        for path in found[:MAX_STUDIES]:
            if path not in self._entries:
                self._entries[path] = StudyEntry(self._choose_name(path), path)
                changed = True
        for seen in self._entries.values():
            changed |= _update_entry(seen)
        if changed:
            studies = tuple(self._entries.values())
            table, units, roles = _join_tables(studies)
            self._snapshot = Snapshot(
                self._snapshot.version + 1, studies, table, units, roles, note
            )

    def _find_folders(self) -> Iterator[Path]:
        """Folders with a manifest, none of them by a link that leads elsewhere; one more than the
        most that are shown."""
        count = 0
        for given in self._folders:
            for at, folders, files in os.walk(given):
                if MANIFEST in files:
                    yield Path(at)
                    count += 1
                deep = len(Path(at).relative_to(given).parts) >= MAX_FOLDER_DEPTH
                folders[:] = [] if MANIFEST in files or deep else sorted(folders)
                if count > MAX_STUDIES:
                    return

    def _choose_name(self, path: Path) -> str:
        """The folder's, with as many of those above as tell it from the others."""
        taken = {seen.name for seen in self._entries.values()}
        for parts in range(1, len(path.parts) + 1):
            name = make_printable("/".join(path.parts[-parts:]))
            if name not in taken:
                return name
        return f"{make_printable(path)} ({len(taken) + 1})"


def _update_entry(entry: StudyEntry) -> bool:
    """Read what has changed of a study; whether anything has."""
    mark = _compute_fingerprint(entry.path)
    if mark == entry.fingerprint:
        return False
    before, entry.fingerprint, entry.note = entry.fingerprint, mark, ""
    try:
        if entry.folder is None or before[:1] != mark[:1]:  # another manifest
            entry.folder = StudyFolder.open(entry.path)
            entry.run_count = entry.folder.study.run_count
        entry.results = Results.from_folder(entry.folder)
    except StudyError as error:  # the rows that were there before are shown on
        entry.note = str(error)
        if not mark[0]:
            entry.results, entry.folder, entry.note = None, None, f"{entry.path} is gone"
    return True


def _compute_fingerprint(path: Path) -> tuple:
    """What changes where the folder changes: of its manifest, and of each part."""
    try:
        manifest = (path / MANIFEST).stat()
    except OSError:
        return (0,)
    parts = []
    for kind in (PARTS, TIMES):
        try:
            with os.scandir(path / kind) as entries:
                for entry in entries:
                    if entry.name.endswith(".parquet"):
                        stat = entry.stat()
                        parts.append((kind, entry.name, stat.st_mtime_ns, stat.st_size))
        except OSError:
            continue
    return ((manifest.st_mtime_ns, manifest.st_size), *sorted(parts))


def _join_tables(studies: Sequence[StudyEntry]) -> tuple[pa.Table, dict[str, str], dict[str, str]]:
    """One table of all rows; and of its columns the units, and what they are."""
    tables, units, roles = [], {}, {}
    for seen in studies:
        if seen.results is None:
            continue
        results = seen.results
        table = results.table.drop_columns(
            [name for name in rows.LABEL_COLUMNS if name in results.table.column_names]
        )
        success = pa.array(results.compute_successes(), pa.float64())
        if metrics.success.name in table.column_names:
            table = table.drop_columns([metrics.success.name])
        columns = {
            STUDY: pa.repeat(seen.name, table.num_rows),
            **dict(zip(table.column_names, table.columns, strict=True)),
            END: results.make_end_column(), metrics.success.name: success,
        }  # fmt: skip
        tables.append(pa.table(columns))
        roles |= {key: SETTING for key in results.study.keys if key in columns}
        units |= {key: find_unit(key) for key in results.study.keys}
        roles |= {one.name: METRIC for one in results.metrics}
        units |= {one.name: one.unit for one in results.metrics}
        roles[metrics.success.name] = METRIC
    units |= {"simulated": "s"}
    joined = _unify_types(tables)
    return joined, units, {name: roles.get(name, OTHER) for name in joined.column_names}


def _unify_types(tables: Sequence[pa.Table]) -> pa.Table:
    """The tables below each other; what is a number here and a word there is a word."""
    if not tables:
        return pa.table({})
    kinds: dict[str, set[pa.DataType]] = {}
    for table in tables:
        for column in table.schema:
            kinds.setdefault(column.name, set()).add(column.type)
    wanted = {}
    for name, types in kinds.items():
        types.discard(pa.null())
        if len(types) == 1:
            wanted[name] = types.pop()
        elif all(pa.types.is_integer(kind) or pa.types.is_floating(kind) for kind in types):
            wanted[name] = pa.float64()
        else:
            wanted[name] = pa.string()
    even = []
    for table in tables:
        columns = {
            name: table[name].cast(kind) if name in table.column_names
            else pa.nulls(table.num_rows, kind) for name, kind in wanted.items()
        }  # fmt: skip
        even.append(pa.table(columns))
    return pa.concat_tables(even).combine_chunks()
