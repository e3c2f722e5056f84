"""From what the tests were seen to run: the tests that can notice a fault, the fastest first."""

from __future__ import annotations

import ast
import bisect
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property

from .edits import COMPILED
from .faults import Fault
from .recording import COLLECTING

_CLASSES_S = (0.05, 0.3, 1.5)  # tests are run by classes of so many processor seconds


@dataclass(frozen=True)
class _Scope:
    """A function, or a statement outside all functions, and the names that it makes.

    `of_class`: a statement within a class.
    """

    first: int
    last: int
    names: tuple[str, ...]
    runs: bool  # a function that a tracer sees
    of_class: bool = False
    compiled: bool = False


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
        self._making: dict[str, dict[str, float]] = {}  # by test: its shared fixtures' seconds
        self.failed: set[str] = set()
        self._of_line: dict[str, dict[int, set[str]]] = {}
        self._collected: dict[str, dict[int, set[str]]] = {}
        self._sources = sources
        for test_file, recording in recordings.items():
            self.seconds |= recording["seconds"]
            self.failed |= set(recording["failed"])
            for fixture, seconds in recording.get("making", {}).items():
                for test in recording["shared"].get(fixture, ()):
                    self._making.setdefault(test, {})[fixture] = seconds
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
        that runs while a test file is imported may concern all tests of that file, and a name that
        it imports does. Of these, tests that import it or run something of its folder come first;
        of what is compiled then those that call it through the fewest others, which are compiled
        again. Before all of them, those that run what numba would compile as plain Python, which
        leaves a trace; then quick ones of files that import the faulty module or something of it,
        or are named after it.
        """
        steps: dict[str, int] = {}
        near: set[str] = set()
        plain: set[str] = set()
        if fault.names:
            steps, plain = self._users(fault.names, fault.file)
            naming = self._naming(fault.names, fault.file)
            if fault.compiled:
                plain |= self._tests(fault.file, *fault.lines)
            found = set(steps) | naming | plain
            found = found or self._tests(fault.file, 1, 10**9)
            found = found or self._importing(fault.file, 1, 10**9)
            near = self._near(fault.file) | naming
            if self._files[fault.file].of_classes.issuperset(fault.names):
                plain = set()  # what is compiled reads nothing that a class declares
        else:
            found = self._tests(fault.file, *fault.lines)
            found |= self._importing(fault.file, *fault.lines)
        about = self._about(fault.file)
        return self._ordered(found - self.failed, plain, about, near,
                             steps if fault.compiled else {})

    def alone(self, test: str) -> float:
        """Processor seconds that a test took when it was recorded, with the fixtures that it shares
        with others."""
        return self.seconds[test] + sum(self._making.get(test, {}).values())

    def total(self, tests: list[str]) -> float:
        """What these tests take one after another."""
        return sum(self._costs(tests))

    def within(self, tests: list[str], budget: float) -> list[str]:
        """The first of them, that take so many seconds together; one at least."""
        total, kept = 0.0, []
        for name, cost in zip(tests, self._costs(tests), strict=True):
            total += cost
            if kept and total > budget:
                break
            kept.append(name)
        return kept

    def _costs(self, tests: Iterable[str]) -> Iterator[float]:
        """Of each in this order: what a file's tests share is made anew when they come again."""
        file, made = "", set()
        for name in tests:
            if _file_of(name) != file:
                file, made = _file_of(name), set()
            new = {k: v for k, v in self._making.get(name, {}).items() if k not in made}
            made |= set(new)
            yield self.seconds[name] + sum(new.values())

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
        return {name for name in self.seconds if _file_of(name) in files}

    def _naming(self, names: tuple[str, ...], home: str) -> set[str]:
        files = {file for file, words in self._test_words.items()
                 if any(self._takes(words, name, home) for name in names)}
        return {name for name in self.seconds if _file_of(name) in files}

    @cache  # noqa: B019  one map a run
    def _about(self, file: str) -> set[str]:
        """The quick tests of files that import a module, or something of it, or have its name."""
        stem = file.rpartition("/")[2].removesuffix(".py")
        files = {test for test, words in self._test_words.items()
                 if stem in words.modules or test.endswith(f"/test_{stem}.py")}
        return {name for name in self.seconds
                if _file_of(name) in files and self.alone(name) < _CLASSES_S[-1]}

    @cache  # noqa: B019  one map a run
    def _near(self, file: str) -> set[str]:
        """The tests that run anything of the folder of a file."""
        folder = file.rpartition("/")[0]
        return {test for one in self._of_line if one.rpartition("/")[0] == folder
                for test in self._tests(one, 1, 10**9)}

    def _ordered(
        self, tests: set[str], plain: set[str], about: set[str], near: set[str],
        steps: dict[str, int],
    ) -> list[str]:
        """Plain ones first, those about it, near ones, those of few steps, then quick tests
        before slow ones, file by file so that shared fixtures are made once. A test is as slow as
        it is with the fixtures that it needs, whichever other test made them when recorded."""
        alone = {name: self.alone(name) for name in tests}
        classes = {name: bisect.bisect(_CLASSES_S, alone[name]) for name in tests}
        groups: dict[tuple[int, str], list[str]] = {}
        for name in tests:
            groups.setdefault((classes[name], _file_of(name)), []).append(name)
        totals = {group: self.total(names) for group, names in groups.items()}

        def rank(name: str) -> tuple[bool, bool, bool, bool, int, int, float, str, float, str]:
            slow, file = classes[name], _file_of(name)
            return ("::" not in name, name not in plain, name not in about, name not in near,
                    steps.get(name, 0), slow, totals[slow, file], file, alone[name], name)

        return sorted(tests, key=rank)

    # -- who uses a name -------------------------------------------------------------------

    def _users(self, names: tuple[str, ...], file: str) -> tuple[dict[str, int], set[str]]:
        """The tests that run a function which uses a name, and through how many others; and those
        that run one as plain Python which is compiled otherwise."""
        found: dict[str, int] = {}
        plain: set[str] = set()
        pending = [(name, file, 0) for name in names]
        done, seen = {(name, file) for name in names}, set()
        for name, home, steps in pending:  # it grows
            for user in self._takers(name, home):
                for scope in self._files[user].using.get(name, ()):
                    if (user, scope) in seen:
                        continue
                    seen.add((user, scope))
                    if scope.runs:
                        for test in self._tests(user, scope.first, scope.last):
                            found.setdefault(test, steps)
                    else:
                        if scope.compiled:
                            plain |= self._tests(user, scope.first, scope.last)
                        new = {(n, user) for n in scope.names} - done
                        pending += [(*one, steps + 1) for one in sorted(new)]
                        done |= new
        return found, plain

    def _takers(self, name: str, home: str) -> list[str]:
        """The files in which a name of one file means what it means there: those that import it,
        or have attributes of its name where it is one of a module or class."""
        return [user for user, words in self._files.items()
                if user == home or self._takes(words, name, home)]

    def _takes(self, words: _Words, name: str, home: str) -> bool:
        stem = home.rpartition("/")[2].removesuffix(".py")
        of_class = name in self._files[home].of_classes
        return name in words.imported or name in words.attributes and (
            of_class or stem in words.imported)

    @cached_property
    def _files(self) -> dict[str, _Words]:
        return {file: _words(source.decode()) for file, source in self._sources.items()}

    @cached_property
    def _test_words(self) -> dict[str, _Words]:
        return {file: _words(source.decode()) for file, source in self._test_sources.items()}


@dataclass(frozen=True)
class _Words:
    """The names in a file: those it imports, uses as attributes, gives to attributes of classes;
    and by each the scopes that use it. modules: those that it imports, or something of them."""

    imported: set[str]
    modules: set[str]
    attributes: set[str]
    of_classes: set[str]
    using: dict[str, list[_Scope]]


def _file_of(test: str) -> str:
    return test.partition("::")[0]


def _words(text: str) -> _Words:
    tree = ast.parse(text)
    imported = {
        part for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names for part in alias.name.split(".")
    }
    attributes = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    lines = [re.findall(r"[A-Za-z_]\w*", line.partition("#")[0]) for line in text.splitlines()]
    using: dict[str, list[_Scope]] = {}
    scopes = list(_scopes(tree.body))
    for scope in scopes:
        for word in {word for line in lines[scope.first - 1 : scope.last] for word in line}:
            using.setdefault(word, []).append(scope)
    of_classes = {name for scope in scopes if scope.of_class for name in scope.names}
    modules = imported | {node.module.rpartition(".")[2] for node in ast.walk(tree)
                          if isinstance(node, ast.ImportFrom) and node.module}
    return _Words(imported, modules, attributes, of_classes, using)


def _scopes(body: list[ast.stmt], outer: str = "") -> list[_Scope]:
    scopes = []
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            runs = not any(COMPILED.search(ast.unparse(d)) for d in node.decorator_list)
            arguments = node.args
            first = min((d.lineno for d in (*arguments.defaults, *arguments.kw_defaults) if d),
                        default=node.body[0].lineno)
            scopes.append(_Scope(first, node.end_lineno, (node.name,), runs, compiled=not runs))
        elif isinstance(node, ast.ClassDef):
            scopes += _scopes(node.body, node.name)
        else:
            targets = getattr(node, "targets", None) or [getattr(node, "target", None)]
            names = tuple(n.id for t in targets if t for n in ast.walk(t)
                          if isinstance(n, ast.Name))
            names = (*names, outer) if outer else names
            scopes.append(_Scope(node.lineno, node.end_lineno, names, False, bool(outer)))
    return scopes
