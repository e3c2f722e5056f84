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


class CompiledFormulas:
    """Several formulas, which may use each other, compiled to one function without loops.

    A leaf is a variable that has no formula, such as a moment.

    Attributes:
        leaves: names of the arguments of `evaluate`, in order.
        used_leaves: names of the leaves that affect the result.
        evaluate: compiled function of the leaves. It returns the values of the formulas, and for
            each formula its derivatives with respect to the leaves.
    """

    def __init__(
        self,
        names: Sequence[str],
        find_formula: Callable[[str], Formula | None],
        leaves: Sequence[str],
        same_slope: Mapping[str, str],
    ) -> None:
        """Write the source of `evaluate` and compile it.

        A leaf is a variable that has no formula, such as a moment.

        Args:
            names: names of the formulas or leaves whose values `evaluate` returns.
            find_formula: function that returns the formula of a name, or None for a leaf.
            leaves: names of all leaves; some may be unused.
            same_slope: for some leaves, the name of a formula. The derivatives of this formula are
                used as the derivatives of the leaf.
        """
        self.leaves = tuple(leaves)
        self.used_leaves: set[str] = set()
        self._find_formula, self._same_slope = find_formula, same_slope
        self._lines: list[str] = []
        # For each formula or variable: the variable of the generated source that contains its
        # value; and for each leaf (variable without formula), the variable of the source that
        # contains the derivative with respect to the leaf.
        self._local_names: dict[str, tuple[str, dict[str, str]]] = {}
        found = [self._get_locals(name) for name in names]
        values = _format_tuple(value for value, _ in found)
        rows = _format_tuple(
            _format_tuple(slopes.get(n, "0.0") for n in self.leaves) for _, slopes in found
        )
        body = "\n    ".join([*self._lines, f"return {values}, {rows}"])
        self.evaluate = _compile_function(
            f"def evaluate({', '.join(self.leaves)}):\n    {body}", "evaluate"
        )

    def _get_locals(self, name: str) -> tuple[str, dict[str, str]]:
        """Return the names of the variables that represent a formula or leaf in the source.

        A leaf is a variable that has no formula, such as a moment.

        The first call for each formula writes the lines of source that set these variables.

        Returns:
            The variable that contains the value of the formula; and for each leaf, the variable
            that contains the derivative with respect to this leaf.
        """
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
        arguments = [self._get_locals(name) for name in formula.names]
        variable = f"_{len(self._local_names)}"
        partials = [f"{variable}_{k}" for k in range(len(arguments))]
        # In the formula, replace each name by the variable of the generated source that contains
        # its value.
        local_values = {
            name: value for name, (value, _) in zip(formula.names, arguments, strict=True)
        }
        expression = _rename_variables(formula.body, local_values)
        self._lines.append(f"{', '.join([variable, *partials])} = {expression}")
        sums: dict[str, list[str]] = {}
        for (_, slopes), partial in zip(arguments, partials, strict=True):
            for leaf, slope in slopes.items():
                sums.setdefault(leaf, []).append(
                    partial if slope == "1.0" else f"{partial} * {slope}"
                )
        slopes = {}
        for k, (leaf, terms) in enumerate(sums.items()):
            slopes[leaf] = f"{variable}_by_{k}"
            self._lines.append(f"{slopes[leaf]} = {' + '.join(terms)}")
        return variable, slopes


def _format_tuple(entries: Iterable[str]) -> str:
    return f"({''.join(f'{entry}, ' for entry in entries)})"


def _compile_function(source: str, name: str) -> Callable[..., tuple]:
    """Compile generated source and return the function `name` that it defines."""
    namespace: dict[str, object] = {"sqrt": sqrt, "atan2": atan2, "__builtins__": {}}
    exec(compile(source, f"<formulas {source}>", "exec"), namespace)  # noqa: S102
    return namespace[name]


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
