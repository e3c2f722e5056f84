"""Formulas that are written once and differentiated by rule.

An interaction matrix that is typed in beside its feature can disagree with it (ViSP's L of C5
did, for years). Here a feature is one expression; its partial derivatives come from the
expression itself, so a feature and its interaction matrix cannot drift apart.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import atan2, sqrt

_ZERO, _ONE = ast.Constant(0.0), ast.Constant(1.0)


class Formula:
    """A real expression of named variables in + - * / ** (constant powers), sqrt and atan2.

    Attributes:
        source: the expression as written.
        names: its variables, in order of first appearance.
    """

    def __init__(self, source: str) -> None:
        self.source = source
        tree = ast.parse(source, mode="eval").body
        self.names: tuple[str, ...] = tuple(_find_variables(tree))
        partials = [_differentiate(tree, name) for name in self.names]
        self.body = ast.unparse(ast.Tuple(elts=[tree, *partials], ctx=ast.Load()))

    def __repr__(self) -> str:
        return f"Formula({self.source!r})"


class Program:
    """Several formulas that rest on each other, and their derivatives by what all rest on, as one
    function without loops.

    Attributes:
        leaves: what it takes, in this order. used: those that matter.
    """

    def __init__(
        self,
        names: Sequence[str],
        find_formula: Callable[[str], Formula | None],
        leaves: Sequence[str],
        same_slope: Mapping[str, str],
    ) -> None:
        """Write it.

        Args:
            names: what it answers: formulas, or leaves themselves.
            formula_of: a name's formula; None for a leaf.
            leaves: all of them; there may be more than are used.
            same_slope: leaves whose derivatives are those of a formula.
        """
        self.leaves = tuple(leaves)
        self.used_leaves: set[str] = set()
        self._find_formula, self._same_slope = find_formula, same_slope
        self._lines: list[str] = []
        # name -> the local variable of its value, and those of its derivatives by leaf
        self._local_names: dict[str, tuple[str, dict[str, str]]] = {}
        found = [self._get_locals(name) for name in names]
        values = _format_tuple(value for value, _ in found)
        rows = _format_tuple(
            _format_tuple(slopes.get(n, "0.0") for n in self.leaves) for _, slopes in found
        )
        body = "\n    ".join([*self._lines, f"return {values}, {rows}"])
        self.evaluate = _compile_function(
            f"def program({', '.join(self.leaves)}):\n    {body}", "program"
        )

    def _get_locals(self, name: str) -> tuple[str, dict[str, str]]:
        """The variables of a value and its derivatives, after writing the lines that set them."""
        if name not in self._local_names:
            formula = self._find_formula(name)
            if formula is not None:
                self._local_names[name] = self._write_formula(formula)
            else:
                self.used_leaves.add(name)
                same = self._same_slope.get(name)
                slopes = {name: "1.0"} if same is None else self._get_locals(same)[1]
                self._local_names[name] = name, slopes
        return self._local_names[name]

    def _write_formula(self, formula: Formula) -> tuple[str, dict[str, str]]:
        below = [self._get_locals(name) for name in formula.names]
        own = f"_{len(self._local_names)}"
        partials = [f"{own}_{k}" for k in range(len(below))]
        # The expression names what it rests on; there they are called otherwise, or are leaves.
        locally = {name: value for name, (value, _) in zip(formula.names, below, strict=True)}
        renamed = _rename_variables(formula.body, locally)
        self._lines.append(f"{', '.join([own, *partials])} = {renamed}")
        sums: dict[str, list[str]] = {}
        for (_, slopes), partial in zip(below, partials, strict=True):
            for leaf, slope in slopes.items():
                sums.setdefault(leaf, []).append(
                    partial if slope == "1.0" else f"{partial} * {slope}"
                )
        slopes = {}
        for k, (leaf, terms) in enumerate(sums.items()):
            slopes[leaf] = f"{own}_by_{k}"
            self._lines.append(f"{slopes[leaf]} = {' + '.join(terms)}")
        return own, slopes


def _format_tuple(entries: Iterable[str]) -> str:
    return f"({''.join(f'{entry}, ' for entry in entries)})"


def _compile_function(source: str, name: str = "") -> Callable[..., tuple]:
    """The function that a text of our own defines, or a lambda."""
    known: dict[str, object] = {"sqrt": sqrt, "atan2": atan2, "__builtins__": {}}
    if not name:
        return eval(compile(source, f"<formula {source}>", "eval"), known)  # noqa: S307
    exec(compile(source, f"<formulas {source}>", "exec"), known)  # noqa: S102
    return known[name]


def _rename_variables(body: str, names: Mapping[str, str]) -> str:
    tree = ast.parse(body, mode="eval")
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            node.id = names.get(node.id, node.id)
    return ast.unparse(tree)


def _find_variables(tree: ast.expr) -> list[str]:
    functions = {n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call)}
    found: dict[str, None] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id not in functions:
            found.setdefault(node.id)
    return list(found)


def _is_number(node: ast.expr, number: float) -> bool:
    return isinstance(node, ast.Constant) and node.value == number


def _add(a: ast.expr, b: ast.expr, sign: ast.operator) -> ast.expr:
    if _is_number(b, 0.0):
        return a
    if _is_number(a, 0.0) and isinstance(sign, ast.Sub):
        return ast.UnaryOp(ast.USub(), b)
    return b if _is_number(a, 0.0) else ast.BinOp(a, sign, b)


def _multiply(a: ast.expr, b: ast.expr) -> ast.expr:
    if _is_number(a, 0.0) or _is_number(b, 0.0):
        return _ZERO
    if _is_number(a, 1.0):
        return b
    return a if _is_number(b, 1.0) else ast.BinOp(a, ast.Mult(), b)


def _divide(a: ast.expr, b: ast.expr) -> ast.expr:
    return _ZERO if _is_number(a, 0.0) else ast.BinOp(a, ast.Div(), b)


def _square(a: ast.expr) -> ast.expr:
    return ast.BinOp(a, ast.Pow(), ast.Constant(2))


def _differentiate(node: ast.expr, name: str) -> ast.expr:
    """The derivative of `node` by the variable `name`, as a tree."""
    match node:
        case ast.Constant():
            return _ZERO
        case ast.Name(id=variable):
            return _ONE if variable == name else _ZERO
        case ast.UnaryOp(op=ast.USub(), operand=a):
            return _add(_ZERO, _differentiate(a, name), ast.Sub())
        case ast.BinOp(left=a, op=(ast.Add() | ast.Sub()) as sign, right=b):
            return _add(_differentiate(a, name), _differentiate(b, name), sign)
        case ast.BinOp(left=a, op=ast.Mult(), right=b):
            da, db = _differentiate(a, name), _differentiate(b, name)
            return _add(_multiply(da, b), _multiply(a, db), ast.Add())
        case ast.BinOp(left=a, op=ast.Div(), right=b):
            da, db = _differentiate(a, name), _differentiate(b, name)
            return _add(_divide(da, b), _divide(_multiply(a, db), _square(b)), ast.Sub())
        case ast.BinOp(left=a, op=ast.Pow(), right=ast.Constant(value=n)):
            power = a if n == 2 else ast.BinOp(a, ast.Pow(), ast.Constant(n - 1))
            return _multiply(_multiply(ast.Constant(n), power), _differentiate(a, name))
        case ast.Call(func=ast.Name(id="sqrt"), args=[a]):
            return _divide(_differentiate(a, name), _multiply(ast.Constant(2.0), node))
        case ast.Call(func=ast.Name(id="atan2"), args=[s, c]):
            ds, dc = _differentiate(s, name), _differentiate(c, name)
            turn = _add(_multiply(c, ds), _multiply(s, dc), ast.Sub())
            return _divide(turn, ast.BinOp(_square(s), ast.Add(), _square(c)))
    raise ValueError(f"no rule to differentiate {ast.unparse(node)!r}")
