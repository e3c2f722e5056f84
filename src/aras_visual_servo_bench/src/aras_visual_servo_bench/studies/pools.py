"""Pool of workers that run the chunks (groups of runs) of a study, and one without workers."""

from __future__ import annotations

from abc import abstractmethod
from contextlib import AbstractContextManager

from . import chunk_execution, run_rows
from .chunk_execution import StudyChunk

# finished chunk of runs with its rows; None instead of the rows if the worker has died
FinishedChunk = tuple[StudyChunk, run_rows.RunRows | None]


class Pool(AbstractContextManager):
    """Pool of workers that run several chunks (groups of runs) at the same time, in any order.

    Attributes:
        workers: number of workers.
    """

    workers: int = 1

    @property
    @abstractmethod
    def has_room(self) -> bool:
        """True if another chunk of runs can be submitted now."""

    @abstractmethod
    def submit(self, task: StudyChunk) -> None:
        """Submit a chunk of runs."""

    @abstractmethod
    def wait_for_chunk(self) -> FinishedChunk:
        """Wait until a chunk of runs is finished, and return it.

        Raises:
            StudyError: a chunk failed, or the workers are lost.
        """

    def close(self) -> None:
        """Stop the workers; a second call has no effect."""

    def __exit__(self, *error: object) -> None:
        self.close()


class InProcessPool(Pool):
    """Pool that runs one chunk of runs after the other in this process, for debugging."""

    def __init__(self) -> None:
        self._task: StudyChunk | None = None

    @property
    def has_room(self) -> bool:
        """True if the previous chunk is finished."""
        return self._task is None

    def submit(self, task: StudyChunk) -> None:
        """Store a chunk of runs; `wait_for_chunk` executes it."""
        self._task = task

    def wait_for_chunk(self) -> FinishedChunk:
        """Execute the submitted chunk of runs, and return its rows."""
        task, self._task = self._task, None
        return task, chunk_execution.carry_out(task)
