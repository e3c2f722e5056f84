"""Names that are easily taken for one another."""

from __future__ import annotations

_FUNCTIONS = (
    ("sin", "cos"), ("asin", "acos"), ("arcsin", "arccos"), ("min", "max"),
    ("minimum", "maximum"), ("argmin", "argmax"), ("floor", "ceil"), ("any", "all"),
    ("zeros", "ones"), ("hstack", "vstack"), ("sum", "mean"), ("fmin", "fmax"),
)
_NAMES = (
    ("fx", "fy"), ("cx", "cy"), ("x", "y"), ("u", "v"), ("xg", "yg"), ("dx", "dy"),
    ("width", "height"), ("rows", "columns"), ("rows", "cols"), ("row", "column"),
    ("lower", "upper"), ("linear", "angular"), ("position", "velocity"),
    ("positions", "velocities"), ("velocity", "effort"), ("force", "torque"), ("roll", "pitch"),
    ("near", "far"), ("left", "right"), ("first", "last"), ("start", "end"), ("low", "high"),
    ("desired", "current"), ("old", "new"), ("parent", "child"), ("source", "target"),
)
_BUILT_IN = {"min", "max", "any", "all"}


def also_attribute(name: str, known: set[str]) -> list[str]:
    """What may stand for an attribute: names that the file uses too, functions everywhere."""
    return [*_others(name, _NAMES, known), *_others(name, _FUNCTIONS)]


def also_variable(name: str, known: frozenset[str]) -> list[str]:
    """What may stand for a variable: others of its function, or a built-in function."""
    return [*_others(name, _NAMES, known), *_others(name, _FUNCTIONS, _BUILT_IN)]


def _others(
    name: str, pairs: tuple[tuple[str, str], ...], known: set[str] | frozenset[str] | None = None
) -> list[str]:
    others = [b if name == a else a for a, b in pairs if name in (a, b)]
    return [other for other in others if known is None or other in known]
