"""A study's folder: its file, its results part by part, and the manifest that says what is what.

    study.yaml            as it was given
    sha256sums.txt        the hash of every part, a line when it is written
    manifest.json         what it is, with which code, and in the end the hash of every part
    parts/000012.parquet  results of a chunk, a row a run
    times/                wall times of the same runs, which are never the same twice
    traces/               of every image, where they are wanted

A part is written under another name and renamed, so what bears its name is whole. The folder is
all there is to know: nothing else remembers what has been done.
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

from ..errors import StudyError, find_program_name, read_first_line
from . import images, rows, versions
from .study import Study

STUDY, MANIFEST, LOCK = "study.yaml", "manifest.json", ".lock"
PARTS, TIMES, TRACES = "parts", "times", "traces"
CHECKSUM_FILE = "sha256sums.txt"
FORMAT_VERSION = 2
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)


class StudyFolder:
    """An open folder.

    Attributes:
        path, study: where and what. labels: words that every row carries.
    """

    def __init__(self, path: Path, study: Study, manifest: dict[str, Any]) -> None:
        self.path, self.study, self.manifest = path, study, manifest
        self.labels = {
            "code": manifest["code"],
            "versions": " ".join(f"{k}={v}" for k, v in manifest["versions"].items()),
        }
        # since when, how large
        self._cached_tables: dict[Path, tuple[tuple[int, int], pa.Table]] = {}

    # -- opening ---------------------------------------------------------------------------

    @classmethod
    def create(cls, path: Path, study: Study, text: str) -> StudyFolder:
        """A new folder; one of the same study is opened as it is, one without a run begun anew.

        Args:
            text: the study's file.

        Raises:
            StudyError: it holds another study or something else, or cannot be written.
        """
        if (path / MANIFEST).exists():
            folder = cls.open(path)
            if folder.has_runs:
                folder.check_same(study)
                return folder
            with folder.lock():  # no run of it was ever kept: a scheduler did not answer
                (path / MANIFEST).unlink()
                (path / STUDY).unlink(missing_ok=True)
        with _catch_write_errors(path):
            if path.exists() and (not path.is_dir() or any(path.iterdir())):
                raise StudyError(f"{path} is not empty and holds no study: name a new folder")
            path.mkdir(parents=True, exist_ok=True)
            manifest = {
                "format": FORMAT_VERSION, "runs": study.run_count, "chunk": study.chunk_size,
                "chunks": study.chunk_count, "digest": study.digest, "code": versions.read_commit(),
                "versions": versions.read_study_versions(study.to_mapping()),
                "study": study.to_mapping(),
            }  # fmt: skip
            (path / STUDY).write_text(text, encoding="utf-8")
            _write_file(path / MANIFEST, _to_json(manifest))
        return cls(path, study, manifest)

    @classmethod
    def open(cls, path: str | Path) -> StudyFolder:
        """The folder of a study that was begun.

        Raises:
            StudyError: there is none, or its study.yaml was changed since.
        """
        path = Path(path)
        try:
            manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
            study = Study.from_mapping(manifest["study"])
        except OSError as error:
            raise StudyError(f"{path} holds no study: {MANIFEST}: {error.strerror}") from None
        except (ValueError, KeyError, TypeError, RecursionError):
            raise StudyError(f"{path / MANIFEST} is damaged: it is no study's manifest") from None
        if manifest.get("format") != FORMAT_VERSION:
            raise StudyError(
                f"{path} was written in format {manifest.get('format')}, not {FORMAT_VERSION}: "
                "read it "
                "with the version that wrote it, or run the study anew"
            )
        if manifest.get("chunk") != study.chunk_size:
            raise StudyError(f"{path} was cut into other chunks: begin it anew")
        return cls(path, study, manifest)

    @property
    def has_runs(self) -> bool:
        """Whether anything of a run was ever kept."""
        return any((self.path / kind).exists() for kind in (PARTS, TIMES, TRACES))

    def check_file(self) -> None:
        """StudyError with the difference where study.yaml was changed since it was begun."""
        self.check_same(Study.from_yaml(self.path / STUDY))

    def check_same(self, study: Study) -> None:
        """StudyError with the difference where the folder's study is another."""
        if study.digest != self.manifest["digest"]:
            raise StudyError(
                f"{self.path} holds another study: {describe_difference(self.study, study)}; name "
                "another "
                "folder, or take the change back"
            )

    def check_code(self) -> None:
        """StudyError where the folder's runs were computed by other code than would go on."""
        here = versions.read_study_versions(self.study.to_mapping())
        told = versions.describe_difference(here, self.manifest["versions"])
        if told:
            raise StudyError(
                f"{self.path} was begun with other code ({told}): its runs would not go together; "
                "run it anew, or say --mix"
            )

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """For one who writes at a time; StudyError where another does."""
        with _catch_write_errors(self.path), open(self.path / LOCK, "wb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise StudyError(f"{self.path} is being written by another bench") from None
            try:
                yield
            finally:
                with contextlib.suppress(OSError):
                    (self.path / LOCK).unlink()

    # -- parts -----------------------------------------------------------------------------

    def find_part(self, chunk: int, kind: str = PARTS) -> Path:
        """The file of a chunk."""
        return self.path / kind / f"{chunk:06d}.parquet"

    def find_missing_chunks(self) -> list[int]:
        """Chunks whose part is not there, or is not the one that was written for it.

        The leavings of a crash are removed.
        """
        for leaving in self.path.glob("*/.*.new"):
            leaving.unlink(missing_ok=True)
        folder = self.path / PARTS
        there = {int(p.stem) for p in folder.glob("*.parquet")} if folder.is_dir() else set()
        sums = self._read_checksums()
        return [
            c
            for c in range(self.study.chunk_count)
            if c not in there or not self._is_complete(c, sums)
        ]

    def write_chunk(self, chunk: int, chunk_rows: rows.Rows) -> None:
        """Keep a chunk's rows; StudyError where the disk is full."""
        with _catch_write_errors(self.path):
            self._write_table(
                TIMES, chunk, pa.Table.from_pylist(chunk_rows.times, schema=rows.TIMES_SCHEMA)
            )
            if self.study.has_image_rows:
                table = pa.Table.from_pylist(
                    chunk_rows.images, schema=images.make_schema(self.study)
                )
                self._write_table(TRACES, chunk, table)
            # The last one, for it is the one that says that the chunk is done.
            self._write_table(
                PARTS, chunk, rows.make_table(self.study, chunk_rows.values, self.labels)
            )

    def finish(self) -> None:
        """Write into the manifest what every part's hash is."""
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
        """How many runs are kept."""
        gone = sum(len(self.study.list_chunk_runs(chunk)) for chunk in self.find_missing_chunks())
        return self.study.run_count - gone

    def read_results(self, kind: str = PARTS) -> pa.Table:
        """All rows that are there, in order of their runs. What was read before and is as it was
        is not read again.

        Raises:
            StudyError: there are none, or a part does not have the hash that it had.
        """
        paths = sorted((self.path / kind).glob("*.parquet"))
        if not paths:
            raise StudyError(f"{self.path} has no {kind} yet")
        sums, tables = self._read_checksums(), []
        for path in paths:
            try:
                stat = path.stat()
                if not path.is_file():
                    raise StudyError(f"{path} is no file: resume the study")
                mark = (stat.st_mtime_ns, stat.st_size)
                if path in self._cached_tables and self._cached_tables[path][0] == mark:
                    tables.append(self._cached_tables[path][1])
                    continue
                data = path.read_bytes()
                if kind in self._stable_kinds and hashlib.sha256(data).hexdigest() != sums.get(
                    self._find_name(path)
                ):
                    raise StudyError(f"{path} is not as it was written: resume the study")
                tables.append(pq.read_table(pa.BufferReader(data)))
                self._cached_tables[path] = (mark, tables[-1])
            except (OSError, pa.ArrowException) as error:
                why = read_first_line(error)
                raise StudyError(f"cannot read {path}: {why}; resume the study") from None
        return pa.concat_tables(tables)

    @property
    def _stable_kinds(self) -> tuple[str, ...]:
        """Those files that are the same whenever they are written; wall times are not."""
        return (PARTS, TRACES) if self.study.has_image_rows else (PARTS,)

    def _find_name(self, path: Path) -> str:
        return str(path.relative_to(self.path))

    def _read_checksums(self) -> dict[str, str]:
        """Hash of each file by its name, as it was written last."""
        try:
            lines = (
                (self.path / CHECKSUM_FILE)
                .read_text(encoding="utf-8", errors="replace")
                .splitlines()
            )
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise StudyError(f"cannot read {self.path / CHECKSUM_FILE}: {error.strerror}") from None
        pairs = (line.split("  ", 1) for line in lines if "  " in line)
        return {name: told for told, name in pairs}

    def _is_complete(self, chunk: int, sums: Mapping[str, str]) -> bool:
        """Whether all files of a chunk are as they were written, and hold its own runs."""
        try:
            for kind in self._stable_kinds:
                path = self.find_part(chunk, kind)
                if not path.is_file():  # a pipe would be read for ever
                    return False
                data = path.read_bytes()
                if hashlib.sha256(data).hexdigest() != sums.get(self._find_name(path)):
                    return False
                if kind == PARTS:
                    runs = pq.read_table(pa.BufferReader(data), columns=["run"])["run"]
                    if runs.to_pylist() != list(self.study.list_chunk_runs(chunk)):
                        return False
        except (OSError, pa.ArrowException):
            return False
        return True

    def _write_table(self, kind: str, chunk: int, table: pa.Table) -> None:
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        path, data = self.find_part(chunk, kind), sink.getvalue().to_pybytes()
        path.parent.mkdir(exist_ok=True)
        if kind in self._stable_kinds:
            # Before the file, which is the one that says that the chunk is done.
            with open(self.path / CHECKSUM_FILE, "a", encoding="utf-8") as sums:
                sums.write(f"{hashlib.sha256(data).hexdigest()}  {self._find_name(path)}\n")
        _write_file(path, data)


def count_stored_runs(path: Path) -> int:
    """How many runs the folder of a study holds; 0 where there is none."""
    return StudyFolder.open(path).count_stored_runs() if (path / MANIFEST).exists() else 0


def describe_difference(old: Study, new: Study) -> str:
    """In what two studies differ, key by key, in a line."""
    before, after = _flatten(old.to_mapping()), _flatten(new.to_mapping())
    keys = [k for k in {**before, **after} if before.get(k) != after.get(k)]
    told = [f"{k} was {before.get(k, 'not given')}, is {after.get(k, 'not given')}" for k in keys]
    return "; ".join(told[:5]) + (f"; and {len(told) - 5} more" if len(told) > 5 else "")


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
    """Whole or not at all, and on the disk when this returns."""
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
    """What cannot be written as one line."""
    try:
        yield
    except OSError as error:
        if error.errno in _DISK_FULL:
            raise StudyError(
                f"the disk of {path} is full: what was done before is kept; make room, then "
                f"{find_program_name()} resume {path}"
            ) from error
        raise StudyError(f"cannot write {path}: {error.strerror or error}") from error
