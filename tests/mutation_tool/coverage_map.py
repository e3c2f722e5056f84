"""From what the tests were seen to run: the tests that can notice a fault, the fastest first."""

from __future__ import annotations

import ast
import bisect
import re
from dataclasses import dataclass
from functools import cached_property

from .edits import COMPILED
from .faults import Fault
from .recording import COLLECTING

_CLASSES_S = (0.05, 0.3, 1.5)  # tests are run by classes of so many processor seconds


@dataclass(frozen=True)
class _Scope:
    """A function, or a statement outside all functions, and the names that it makes."""

    first: int
    last: int
    names: tuple[str, ...]
    runs: bool  # a function that a tracer sees


class CoverageMap:
    """Recordings of all test files of an area.

    Args:
        recordings: by test file, what `recording.record` wrote.
        sources: all sources by file, from the workspace's top: also those outside the area,
            through which its constants and compiled functions are used.
        tests: the test files' own sources, which may use them by name.
    """

    def __init__(
        self, recordings: dict[str, dict], sources: dict[str, bytes],
        tests: dict[str, bytes] | None = None,
    ) -> None:
        self._test_sources = tests or {}
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self._of_line: dict[str, dict[int, set[str]]] = {}
        self._collected: dict[str, dict[int, set[str]]] = {}
        self._sources = sources
        for test_file, recording in recordings.items():
            self.seconds |= recording["seconds"]
            self.failed |= set(recording["failed"])
            for file, lines in recording["lines"].items():
                of_line = self._of_line.setdefault(file, {})
                for line, contexts in lines.items():
                    tests = of_line.setdefault(int(line), set())
                    for context in contexts:
                        if context == COLLECTING:
                            collected = self._collected.setdefault(file, {})
                            collected.setdefault(int(line), set()).add(test_file)
                        else:
                            tests |= set(recording["shared"].get(context, (context,)))

    def tests_of(self, fault: Fault) -> list[str]:
        """The tests that run the fault, in the order to run them in; none where none does.

        What stands outside functions, and what numba compiles, leaves no trace: there, the tests
        that run a function which uses it, through as many such steps as it takes. A function
        that runs while a test file is imported may concern all tests of that file, and a name in
        its text does.
        """
        if fault.names:
            found = self._users(fault.names, fault.file) | self._naming(fault.names)
            found = found or self._tests(fault.file, 1, 10**9)
            found = found or self._importing(fault.file, 1, 10**9)
        else:
            found = self._tests(fault.file, *fault.lines)
            found |= self._importing(fault.file, *fault.lines)
        return self._ordered(found - self.failed)

    def total(self, tests: list[str]) -> float:
        """Processor seconds that these tests took when they were recorded."""
        return sum(self.seconds[name] for name in tests)

    def within(self, tests: list[str], budget: float) -> list[str]:
        """The first of them, that take so many seconds together; one at least."""
        total, kept = 0.0, []
        for name in tests:
            total += self.seconds[name]
            if kept and total > budget:
                break
            kept.append(name)
        return kept

    def imports(self, fault: Fault) -> bool:
        """Whether it runs while test files are imported."""
        return not fault.names and bool(self._importing(fault.file, *fault.lines))

    def _tests(self, file: str, first: int, last: int) -> set[str]:
        lines = self._of_line.get(file, {})
        found: set[str] = set()
        for line, tests in lines.items():
            if first <= line <= last:
                found |= tests
        return {name for name in found if name in self.seconds}

    def _importing(self, file: str, first: int, last: int) -> set[str]:
        lines = self._collected.get(file, {}).items()
        files = {f for line, several in lines if first <= line <= last for f in several}
        return {name for name in self.seconds if name.partition("::")[0] in files}

    def _naming(self, names: tuple[str, ...]) -> set[str]:
        words = re.compile(rb"\b(" + "|".join(names).encode() + rb")\b")
        files = {file for file, source in self._test_sources.items() if words.search(source)}
        return {name for name in self.seconds if name.partition("::")[0] in files}

    def _ordered(self, tests: set[str]) -> list[str]:
        """Quick tests before slow ones, file by file so that shared fixtures are made once."""
        def file_of(name: str) -> str:
            return name.partition("::")[0]

        classes = {name: bisect.bisect(_CLASSES_S, self.seconds[name]) for name in tests}
        totals: dict[tuple[int, str], float] = {}
        for name in tests:
            group = classes[name], file_of(name)
            totals[group] = totals.get(group, 0.0) + self.seconds[name]

        def rank(name: str) -> tuple[bool, int, float, str, float, str]:
            slow, graph, file = classes[name], "::" not in name, file_of(name)
            return graph, slow, totals[slow, file], file, self.seconds[name], name

        return sorted(tests, key=rank)

    # -- who uses a name -------------------------------------------------------------------

    def _users(self, names: tuple[str, ...], file: str) -> set[str]:
        found: set[str] = set()
        pending, done = [(name, file) for name in names], set(names)
        while pending:
            name, home = pending.pop()
            files = (home,) if name.startswith("_") else self._sources
            for user in files:
                for scope in self._scopes_with(user, name):
                    if scope.runs:
                        found |= self._tests(user, scope.first, scope.last)
                    else:
                        pending += [(n, user) for n in scope.names if n not in done]
                        done |= set(scope.names)
        return found

    def _scopes_with(self, file: str, name: str) -> list[_Scope]:
        lines = self._words[file].get(name, ())
        return [s for s in self._scopes[file] if any(s.first <= k <= s.last for k in lines)]

    @cached_property
    def _words(self) -> dict[str, dict[str, list[int]]]:
        words: dict[str, dict[str, list[int]]] = {}
        for file, source in self._sources.items():
            of_file = words.setdefault(file, {})
            for number, line in enumerate(source.decode().splitlines(), 1):
                for word in re.findall(r"[A-Za-z_]\w*", line.partition("#")[0]):
                    of_file.setdefault(word, []).append(number)
        return words

    @cached_property
    def _scopes(self) -> dict[str, list[_Scope]]:
        return {
            file: list(_scopes(ast.parse(source).body, source.decode()))
            for file, source in self._sources.items()
        }


def _scopes(body: list[ast.stmt], text: str, outer: str = "") -> list[_Scope]:
    scopes = []
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            decorators = [ast.get_source_segment(text, d) or "" for d in node.decorator_list]
            runs = not any(COMPILED.search(d) for d in decorators)
            scopes.append(_Scope(node.body[0].lineno, node.end_lineno, (node.name,), runs))
        elif isinstance(node, ast.ClassDef):
            scopes += _scopes(node.body, text, node.name)
        else:
            targets = getattr(node, "targets", None) or [getattr(node, "target", None)]
            names = tuple(n.id for t in targets if t for n in ast.walk(t)
                          if isinstance(n, ast.Name))
            names = (*names, outer) if outer else names
            scopes.append(_Scope(node.lineno, node.end_lineno, names, False))
    return scopes
