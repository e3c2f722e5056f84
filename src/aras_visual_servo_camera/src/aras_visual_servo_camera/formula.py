"""Formulas that are written once and differentiated by rule.

An interaction matrix that is typed in beside its feature can disagree with it (ViSP's L of C5
did, for years). Here a feature is one expression; its partial derivatives come from the
expression itself, so a feature and its interaction matrix cannot drift apart.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
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
        self.names: tuple[str, ...] = tuple(_variables(tree))
        partials = [_differentiate(tree, name) for name in self.names]
        arguments = ", ".join(self.names)
        body = ast.unparse(ast.Tuple(elts=[tree, *partials], ctx=ast.Load()))
        code = compile(f"lambda {arguments}: {body}", f"<formula {source}>", "eval")
        self._evaluate: Callable[..., tuple[float, ...]] = eval(  # noqa: S307 - our own text
            code, {"sqrt": sqrt, "atan2": atan2, "__builtins__": {}}
        )

    def value_and_partials(self, values: Sequence[float]) -> tuple[float, ...]:
        """Value, then the derivative by each of `names`; `values` in the order of `names`."""
        return self._evaluate(*values)

    def __repr__(self) -> str:
        return f"Formula({self.source!r})"


def _variables(tree: ast.expr) -> list[str]:
    functions = {n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call)}
    found: dict[str, None] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id not in functions:
            found.setdefault(node.id)
    return list(found)


def _is(node: ast.expr, number: float) -> bool:
    return isinstance(node, ast.Constant) and node.value == number


def _sum(a: ast.expr, b: ast.expr, sign: ast.operator) -> ast.expr:
    if _is(b, 0.0):
        return a
    if _is(a, 0.0) and isinstance(sign, ast.Sub):
        return ast.UnaryOp(ast.USub(), b)
    return b if _is(a, 0.0) else ast.BinOp(a, sign, b)


def _product(a: ast.expr, b: ast.expr) -> ast.expr:
    if _is(a, 0.0) or _is(b, 0.0):
        return _ZERO
    if _is(a, 1.0):
        return b
    return a if _is(b, 1.0) else ast.BinOp(a, ast.Mult(), b)


def _quotient(a: ast.expr, b: ast.expr) -> ast.expr:
    return _ZERO if _is(a, 0.0) else ast.BinOp(a, ast.Div(), b)


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
            return _sum(_ZERO, _differentiate(a, name), ast.Sub())
        case ast.BinOp(left=a, op=(ast.Add() | ast.Sub()) as sign, right=b):
            return _sum(_differentiate(a, name), _differentiate(b, name), sign)
        case ast.BinOp(left=a, op=ast.Mult(), right=b):
            da, db = _differentiate(a, name), _differentiate(b, name)
            return _sum(_product(da, b), _product(a, db), ast.Add())
        case ast.BinOp(left=a, op=ast.Div(), right=b):
            da, db = _differentiate(a, name), _differentiate(b, name)
            return _sum(_quotient(da, b), _quotient(_product(a, db), _square(b)), ast.Sub())
        case ast.BinOp(left=a, op=ast.Pow(), right=ast.Constant(value=n)):
            power = a if n == 2 else ast.BinOp(a, ast.Pow(), ast.Constant(n - 1))
            return _product(_product(ast.Constant(n), power), _differentiate(a, name))
        case ast.Call(func=ast.Name(id="sqrt"), args=[a]):
            return _quotient(_differentiate(a, name), _product(ast.Constant(2.0), node))
        case ast.Call(func=ast.Name(id="atan2"), args=[s, c]):
            ds, dc = _differentiate(s, name), _differentiate(c, name)
            turn = _sum(_product(c, ds), _product(s, dc), ast.Sub())
            return _quotient(turn, ast.BinOp(_square(s), ast.Add(), _square(c)))
    raise ValueError(f"no rule to differentiate {ast.unparse(node)!r}")
