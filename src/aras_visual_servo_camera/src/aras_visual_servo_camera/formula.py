"""Formulas with automatic symbolic derivatives.

An interaction matrix that is written by hand can disagree with its feature, as the matrix of the
feature C5 did in ViSP for years. Here a feature is one expression, and its partial derivatives are
derived from this expression. The feature and its interaction matrix therefore always agree.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import atan2, sqrt

_ZERO, _ONE = ast.Constant(0.0), ast.Constant(1.0)


class Formula:
    """An expression of real variables with + - * /, ** (constant exponents), sqrt and atan2.

    Attributes:
        source: the expression as text.
        names: names of its variables, in order of their first appearance.
        body: Python source of a tuple: the value of the expression, and its partial derivative with
            respect to each variable in `names`.
    """

    def __init__(self, source: str) -> None:
        self.source = source
        tree = ast.parse(source, mode="eval").body
        self.names: tuple[str, ...] = tuple(_find_variables(tree))
        partials = [_differentiate(tree, name) for name in self.names]
        self.body = ast.unparse(ast.Tuple(elts=[tree, *partials], ctx=ast.Load()))

    def __repr__(self) -> str:
        return f"Formula({self.source!r})"


def compile_formulas(
    names: Sequence[str], leaves: Sequence[str], find_formula: Callable[[str], Formula | None],
    find_source: Callable[[str], str], same_slope: Mapping[str, str],
) -> Callable[..., tuple]:  # fmt: skip
    """Compile several formulas, which may use each other, to one function without loops.

    A leaf is a variable that has no formula, such as a moment.

    Args:
        names: names of the formulas or leaves whose values the function returns.
        leaves: names of all leaves; the function does not read those that are unused.
        find_formula: function that returns the formula of a name, or None for a leaf.
        find_source: function that returns the Python source that reads a leaf from the arguments
            `mu` and `others` of the compiled function.
        same_slope: for some leaves, the name of a formula. The derivatives of this formula are
            used as the derivatives of the leaf.

    Returns:
        Function of `mu` and `others`. It returns the values of the formulas, and for each formula
        its derivatives with respect to all leaves.
    """
    lines: list[str] = []
    # For each formula and leaf: the variable of the generated source that contains its value; and
    # for each leaf on which it depends, the source of the derivative.
    known: dict[str, tuple[str, dict[str, str]]] = {}

    def add(name: str) -> tuple[str, dict[str, str]]:
        """Write the source of a formula or leaf once, and return its entry in `known`."""
        if name in known:
            return known[name]
        formula = find_formula(name)
        if formula is None:
            lines.append(f"{name} = {find_source(name)}")
            same = same_slope.get(name)
            known[name] = name, {name: "1.0"} if same is None else add(same)[1]
            return known[name]
        arguments = [add(argument) for argument in formula.names]
        variable = f"_{len(known)}"
        partials = [f"{variable}_{k}" for k in range(len(arguments))]
        values = {argument: known[argument][0] for argument in formula.names}
        expression = _rename_variables(formula.body, values)
        lines.append(f"{', '.join([variable, *partials])} = {expression}")
        terms: dict[str, list[str]] = {}
        for (_, slopes), partial in zip(arguments, partials, strict=True):
            for leaf, slope in slopes.items():
                product = partial if slope == "1.0" else f"{partial} * {slope}"
                terms.setdefault(leaf, []).append(product)
        slopes = {leaf: f"{variable}_by_{k}" for k, leaf in enumerate(terms)}
        lines.extend(f"{slopes[leaf]} = {' + '.join(terms[leaf])}" for leaf in terms)
        known[name] = variable, slopes
        return known[name]

    found = [add(name) for name in names]
    rows = (_format_tuple(slopes.get(n, "0.0") for n in leaves) for _, slopes in found)
    result = f"{_format_tuple(value for value, _ in found)}, {_format_tuple(rows)}"
    source = "\n    ".join(["def evaluate(mu, others):", *lines, f"return {result}"])
    namespace: dict[str, object] = {"sqrt": sqrt, "atan2": atan2, "__builtins__": {}}
    exec(compile(source, f"<formulas {source}>", "exec"), namespace)  # noqa: S102
    return namespace["evaluate"]


def _format_tuple(entries: Iterable[str]) -> str:
    return f"({''.join(f'{entry}, ' for entry in entries)})"


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
    """Return the syntax tree of the derivative of `node` with respect to the variable `name`."""
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
