"""Folder of a study: its settings, its results in one file per chunk, and a manifest.

A chunk is a group of consecutive runs. The folder contains

    study.yaml            settings of the study
    sha256sums.txt        hash of each result file, written before the file
    manifest.json         settings and versions of the code; after the last run, also all hashes
    parts/000012.parquet  results of a chunk, one row per run
    times/                wall times of the runs; they differ between executions
    traces/               one row per image, if the study stores traces or images

A file is written under a temporary name and then renamed, so a file with its final name is
complete. The state of a study is stored in this folder only.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from ..errors import StudyError, find_command, read_first_line
from . import image_table, run_rows, versions
from .study import Study

STUDY, MANIFEST, LOCK = "study.yaml", "manifest.json", ".lock"
PARTS, TIMES, TRACES = "parts", "times", "traces"
CHECKSUM_FILE = "sha256sums.txt"
FORMAT_VERSION = 3  # since version 3, the columns mend and asked are named remedy and desired_twist
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)


class StudyFolder:
    """Open folder of a study.

    Attributes:
        path: path of the folder.
        study: settings of the study.
        manifest: content of manifest.json.
        labels: text of each column that has the same value in all rows, by name of the column.
    """

    def __init__(self, path: Path, study: Study, manifest: dict[str, Any]) -> None:
        self.path, self.study, self.manifest = path, study, manifest
        self.labels = {
            "code": manifest["code"],
            "versions": " ".join(f"{k}={v}" for k, v in manifest["versions"].items()),
        }
        # Content of each file that was read, by its path, with the file's modification time and
        # size.
        self._cached_tables: dict[Path, tuple[tuple[int, int], pa.Table]] = {}

    @classmethod
    def create(cls, path: Path, study: Study, text: str | None = None) -> StudyFolder:
        """Create the folder of a study, or open the existing folder of the same study.

        If the folder contains a study without any stored run, it is created again.

        Args:
            path: path of the folder.
            study: settings of the study.
            text: content of the study's YAML file; None: all settings of the study.

        Raises:
            StudyError: the folder contains another study or other files, or cannot be written.
        """
        if (path / MANIFEST).exists():
            folder = cls.open(path)
            if folder.has_runs:
                folder.check_same(study)
                return folder
            # A folder without stored runs is created again. Its study may have failed at its start,
            # for example because no scheduler answered.
            with folder.lock():
                (path / MANIFEST).unlink()
                (path / STUDY).unlink(missing_ok=True)
        with _catch_write_errors(path):
            if path.exists() and (not path.is_dir() or any(path.iterdir())):
                raise StudyError(
                    f"{path} is not empty and does not contain a study: give another folder"
                )
            path.mkdir(parents=True, exist_ok=True)
            manifest = {
                "format": FORMAT_VERSION, "runs": study.run_count, "chunk": study.chunk_size,
                "chunks": study.chunk_count, "digest": study.digest, "code": versions.read_commit(),
                "versions": versions.read_study_versions(study.to_mapping()),
                "study": study.to_mapping(),
            }  # fmt: skip
            if text is None:
                text = yaml.safe_dump(study.to_mapping(), sort_keys=False)
            (path / STUDY).write_text(text, encoding="utf-8")
            _write_file(path / MANIFEST, _to_json(manifest))
        return cls(path, study, manifest)

    @classmethod
    def open(cls, path: str | Path) -> StudyFolder:
        """Open the folder of a study.

        Raises:
            StudyError: the folder does not contain a study, or its format is not supported.
        """
        path = Path(path)
        try:
            manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
            study = Study.from_mapping(manifest["study"])
        except OSError as error:
            raise StudyError(
                f"{path} has no study ({MANIFEST}: {error.strerror}): give the folder of a study"
            ) from None
        except StudyError as error:
            raise StudyError(
                f"{path} has a study that this version cannot read: {error}; correct its "
                "study.yaml and run it again in a new folder"
            ) from None
        except (ValueError, KeyError, TypeError, RecursionError):
            raise StudyError(
                f"{path / MANIFEST} is not the manifest of a study: run the study again in a new "
                "folder"
            ) from None
        if manifest.get("format") != FORMAT_VERSION:
            raise StudyError(
                f"{path} was written in format {manifest.get('format')}, not {FORMAT_VERSION}, in "
                "which columns have new names (mend is now remedy, asked is now desired_twist): "
                "read it with the version that wrote it, or run the study again"
            )
        if manifest.get("chunk") != study.chunk_size:
            raise StudyError(
                f"{path} was written with another chunk size: run the study again in a new folder"
            )
        return cls(path, study, manifest)

    @property
    def has_runs(self) -> bool:
        """True if results of at least one run have been stored."""
        return any((self.path / kind).exists() for kind in (PARTS, TIMES, TRACES))

    def check_file(self) -> None:
        """Check that study.yaml has not been changed since the start of the study.

        Raises:
            StudyError: study.yaml was changed; the message contains the difference.
        """
        self.check_same(Study.from_yaml(self.path / STUDY))

    def check_same(self, study: Study) -> None:
        """Check that the folder contains the given study.

        Raises:
            StudyError: it contains another study; the message contains the difference.
        """
        if study.digest != self.manifest["digest"]:
            raise StudyError(
                f"{self.path} has another study: {describe_difference(self.study, study)}; name "
                "another folder, or undo the change"
            )

    def check_code(self) -> None:
        """Check that the stored runs were computed with the current version of the code.

        Raises:
            StudyError: they were computed with another version.
        """
        current = versions.read_study_versions(self.study.to_mapping())
        difference = versions.describe_difference(current, self.manifest["versions"])
        if difference:
            raise StudyError(
                f"{self.path} was started with other code ({difference}), so its runs would not be "
                "comparable; run the study again in a new folder, or add --mix"
            )

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the folder for writing.

        Raises:
            StudyError: another process has locked it.
        """
        with _catch_write_errors(self.path), open(self.path / LOCK, "wb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise StudyError(
                    f"{self.path} is being written by another process: wait until it has ended"
                ) from None
            try:
                yield
            finally:
                with contextlib.suppress(OSError):
                    (self.path / LOCK).unlink()

    def find_part(self, chunk: int, kind: str = PARTS) -> Path:
        """Return the path of a chunk's file.

        kind: PARTS for the results, TIMES for the wall times, TRACES for the rows of images.
        """
        return self.path / kind / f"{chunk:06d}.parquet"

    def find_missing_chunks(self) -> list[int]:
        """Return the numbers of the chunks whose results are missing, incomplete or changed.

        Temporary files that a crash has left are removed.
        """
        for temporary in self.path.glob("*/.*.new"):
            temporary.unlink(missing_ok=True)
        folder = self.path / PARTS
        stored = {int(p.stem) for p in folder.glob("*.parquet")} if folder.is_dir() else set()
        sums = self._read_checksums()
        chunks = range(self.study.chunk_count)
        return [c for c in chunks if c not in stored or not self._is_complete(c, sums)]

    def write_chunk(self, chunk: int, chunk_rows: run_rows.RunRows) -> None:
        """Write the rows of a chunk of runs.

        Raises:
            StudyError: the files cannot be written, for example because the disk is full.
        """
        with _catch_write_errors(self.path):
            self._write_table(
                TIMES, chunk, pa.Table.from_pylist(chunk_rows.times, schema=run_rows.TIMES_SCHEMA)
            )
            if self.study.has_image_rows:
                table = pa.Table.from_pylist(
                    chunk_rows.images, schema=image_table.make_schema(self.study)
                )
                self._write_table(TRACES, chunk, table)
            # The file of results is written last, because its existence marks the chunk as
            # finished.
            self._write_table(
                PARTS, chunk, run_rows.make_table(self.study, chunk_rows.values, self.labels)
            )

    def finish(self) -> None:
        """Write the hashes of all result files into the manifest."""
        sums = self._read_checksums()
        names = (
            self._find_name(self.find_part(chunk, kind)) for kind in self._stable_kinds
            for chunk in range(self.study.chunk_count)
        )  # fmt: skip
        hashes = {name: sums[name] for name in names}
        with _catch_write_errors(self.path):
            self.manifest = {**self.manifest, "parts": hashes}
            _write_file(self.path / MANIFEST, _to_json(self.manifest))

    def count_stored_runs(self) -> int:
        """Count the runs whose results are stored in the folder."""
        return self.study.run_count - self.study.count_runs(self.find_missing_chunks())

    def read_results(self, kind: str = PARTS) -> pa.Table:
        """Read all stored rows, in the order of the runs; files are cached until they change.

        kind: PARTS for the results, TIMES for the wall times, TRACES for the rows of images.

        Raises:
            StudyError: there are no rows, or a file does not have its recorded hash.
        """
        paths = sorted((self.path / kind).glob("*.parquet"))
        if not paths:
            raise StudyError(f"{self.path} has no {kind} yet: run the study first")
        sums, tables = self._read_checksums(), []
        for path in paths:
            try:
                stat = path.stat()
                mark = (stat.st_mtime_ns, stat.st_size)
                if self._cached_tables.get(path, (None,))[0] != mark:
                    data = self._read_file(path, kind, sums)
                    self._cached_tables[path] = (mark, pq.read_table(pa.BufferReader(data)))
                tables.append(self._cached_tables[path][1])
            except (OSError, pa.ArrowException) as error:
                why = read_first_line(error)
                raise StudyError(f"cannot read {path}: {why}; resume the study") from None
        return pa.concat_tables(tables)

    @property
    def _stable_kinds(self) -> tuple[str, ...]:
        """Kinds of files whose content is the same on every execution; files of wall times are not.
        """
        return (PARTS, TRACES) if self.study.has_image_rows else (PARTS,)

    def _find_name(self, path: Path) -> str:
        return str(path.relative_to(self.path))

    def _read_checksums(self) -> dict[str, str]:
        """Return the last recorded hash of each file, by file name."""
        file = self.path / CHECKSUM_FILE
        try:
            lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise StudyError(f"cannot read {file}: {error.strerror}") from None
        pairs = (line.split("  ", 1) for line in lines if "  " in line)
        return {name: checksum for checksum, name in pairs}

    def _read_file(self, path: Path, kind: str, sums: Mapping[str, str]) -> bytes:
        """Return the content of a result file.

        Raises:
            StudyError: the file is missing, or does not have its recorded hash.
        """
        # is_file() is False for a pipe, from which reading might never end
        if not path.is_file():
            raise StudyError(f"{path} is missing or not a file: resume the study")
        data = path.read_bytes()
        name = self._find_name(path)
        if kind in self._stable_kinds and hashlib.sha256(data).hexdigest() != sums.get(name):
            raise StudyError(f"{path} was changed since it was written: resume the study")
        return data

    def _is_complete(self, chunk: int, sums: Mapping[str, str]) -> bool:
        """Return True if the files of a chunk have the recorded hashes and contain all of its runs.

        Args:
            chunk: number of the chunk.
            sums: recorded hashes, by file name.
        """
        try:
            data = {kind: self._read_file(self.find_part(chunk, kind), kind, sums)
                    for kind in self._stable_kinds}  # fmt: skip
            runs = pq.read_table(pa.BufferReader(data[PARTS]), columns=["run"])["run"]
        except (OSError, pa.ArrowException, StudyError):
            return False
        return runs.to_pylist() == list(self.study.list_chunk_runs(chunk))

    def _write_table(self, kind: str, chunk: int, table: pa.Table) -> None:
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        path, data = self.find_part(chunk, kind), sink.getvalue().to_pybytes()
        path.parent.mkdir(exist_ok=True)
        if kind in self._stable_kinds:
            # The hash of a file is written before the file, because the existence of the file marks
            # the chunk as finished.
            with open(self.path / CHECKSUM_FILE, "a", encoding="utf-8") as sums:
                sums.write(f"{hashlib.sha256(data).hexdigest()}  {self._find_name(path)}\n")
        _write_file(path, data)


def count_stored_runs(path: Path) -> int:
    """Count the stored runs of a study; return 0 if the folder does not contain a study."""
    return StudyFolder.open(path).count_stored_runs() if (path / MANIFEST).exists() else 0


def describe_difference(old: Study, new: Study) -> str:
    """Describe the differences between two studies, key by key, in one line."""
    before, after = _flatten(old.to_mapping()), _flatten(new.to_mapping())
    keys = [k for k in {**before, **after} if before.get(k) != after.get(k)]
    texts = [f"{k} was {before.get(k, 'not given')}, is {after.get(k, 'not given')}" for k in keys]
    return "; ".join(texts[:5]) + (f"; and {len(texts) - 5} more" if len(texts) > 5 else "")


def _flatten(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            flat |= _flatten(value, f"{before}{key}.")
        elif value != {}:
            flat[f"{before}{key}"] = value
    return flat


def _to_json(values: Mapping[str, Any]) -> bytes:
    return (json.dumps(values, indent=1, ensure_ascii=False) + "\n").encode()


def _write_file(path: Path, data: bytes) -> None:
    """Write a file atomically, and wait until the data are on the disk."""
    new = path.with_name(f".{path.name}.new")
    try:
        with open(new, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(new, path)
    except OSError:
        with contextlib.suppress(OSError):
            new.unlink()
        raise


@contextlib.contextmanager
def _catch_write_errors(path: Path) -> Iterator[None]:
    """Convert an OSError of the `with` block into a StudyError with a one-line message."""
    try:
        yield
    except OSError as error:
        if error.errno in _DISK_FULL:
            raise StudyError(
                f"the disk of {path} is full; the results so far are stored; free some space, then "
                f"run {find_command()} resume {path}"
            ) from error
        raise StudyError(f"cannot write {path}: {error.strerror or error}") from error
