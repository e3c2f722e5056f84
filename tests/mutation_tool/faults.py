"""Single faults of a Python source: small wrong edits, and a draw of them."""

from __future__ import annotations

import ast
import hashlib
import re
from dataclasses import dataclass

from .edits import Walk

OPERATORS = (
    "sign", "scale", "constant", "index", "bound", "condition", "logic", "name", "arguments",
    "transpose", "copy", "call", "statement", "refusal", "exception",
)


@dataclass(frozen=True)
class Fault:
    """One wrong edit.

    Attributes:
        file: path from the workspace's top.
        function: qualified name of the function or class it is in, '' at the top.
        operator: one of OPERATORS.
        lines: first and last line of what must run for the fault to be noticed.
        names: for what runs when the module is imported, or where no tracer looks (compiled
            functions): names that stand where its effect is used; else empty.
        compiled: it is in a function that numba compiles.
        start, end, text: bytes [start, end) become `text`.
        line, was, now: the changed lines, white space made single.
        key: hash of the above but the positions: stays when other lines change.
    """

    file: str
    function: str
    operator: str
    lines: tuple[int, int]
    names: tuple[str, ...]
    compiled: bool
    start: int
    end: int
    text: str
    line: int
    was: str
    now: str
    key: str

    def apply(self, source: bytes) -> bytes:
        """The faulty source."""
        return source[: self.start] + self.text.encode() + source[self.end :]


def faults_of(source: bytes, file: str) -> list[Fault]:
    """All faults of a source, in the order of the text; `is_fault` is not asked here."""
    faults, seen = [], set()
    counts: dict[tuple[str, ...], int] = {}
    for place, operator, start, end, text in Walk(source, file).edits():
        if (start, end, text) in seen:
            continue
        seen.add((start, end, text))
        line, was, now = _changed_lines(source, start, end, text)
        identity = (file, place.function, operator, was, now)
        counts[identity] = counts.get(identity, 0) + 1
        key = hashlib.sha256("\0".join((*identity, str(counts[identity]))).encode()).hexdigest()
        faults.append(Fault(
            file, place.function, operator, place.lines, place.names, place.compiled, start, end,
            text, line, was, now, key[:12],
        ))
    return sorted(faults, key=lambda fault: (fault.start, fault.end, fault.operator, fault.text))


def is_fault(fault: Fault, source: bytes) -> bool:
    """Whether the edit is Python, and another program than the source."""
    faulty = fault.apply(source)
    try:
        compile(faulty, fault.file, "exec")
        return ast.dump(ast.parse(faulty)) != ast.dump(ast.parse(source))
    except (SyntaxError, ValueError):
        return False


def sample(
    sources: dict[str, bytes], count: int, seed: int, only: str = "",
    lines: dict[str, set[int]] | None = None,
) -> list[Fault]:
    """`count` faults of the sources (by file): the same for the same seed and sources.

    Each fault's place in the draw is a hash of the seed and of itself, so an edit elsewhere
    changes nothing about it. `only`: regular expression that "file function was" must contain;
    `lines`: those in which faults may begin, of each file.
    """
    def draw(fault: Fault) -> str:
        return hashlib.sha256(f"{seed} {fault.key}".encode()).hexdigest()

    wanted = re.compile(only)
    faults = [
        fault for file, source in sources.items() for fault in faults_of(source, file)
        if wanted.search(f"{fault.file} {fault.function} {fault.was}")
        and (lines is None or fault.line in lines.get(file, ()))
    ]
    drawn: list[Fault] = []
    for fault in sorted(faults, key=draw):
        if len(drawn) == count:
            break
        if is_fault(fault, sources[fault.file]):
            drawn.append(fault)
    return drawn


def _changed_lines(source: bytes, start: int, end: int, text: str) -> tuple[int, str, str]:
    head = source.rfind(b"\n", 0, start) + 1
    tail = source.find(b"\n", end)
    tail = len(source) if tail < 0 else tail
    was = source[head:tail].decode()
    now = source[head:start].decode() + text + source[end:tail].decode()
    return source.count(b"\n", 0, start) + 1, " ".join(was.split()), " ".join(now.split())
