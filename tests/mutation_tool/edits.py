"""The edits that a source allows, each as text, each of one operator.

Positions come from `ast`, the edits are made in the text, so a faulty file differs from its
original in that place alone. What no test can be asked to notice is left out: type hints,
docstrings, log lines, the text of messages, `repr`, assertions, and arguments that only guard
(strict=, daemon=, dtype=float).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from .confusions import also_attribute, also_variable

COMPILED = re.compile(r"\b(compiled|inlined|njit|jit|vectorize|guvectorize|cfunc)\b")
_ARITHMETIC = {
    ast.Add: ("+", "-", "sign"), ast.Sub: ("-", "+", "sign"), ast.Mult: ("*", "/", "scale"),
    ast.Div: ("/", "*", "scale"), ast.FloorDiv: ("//", "*", "scale"),
    ast.Pow: ("**", "*", "scale"), ast.BitAnd: ("&", "|", "logic"), ast.BitOr: ("|", "&", "logic"),
}
_COMPARISONS = {
    ast.Lt: ("<", "<=", "bound"), ast.LtE: ("<=", "<", "bound"), ast.Gt: (">", ">=", "bound"),
    ast.GtE: (">=", ">", "bound"), ast.Eq: ("==", "!=", "condition"),
    ast.NotEq: ("!=", "==", "condition"), ast.Is: ("is", "is not", "condition"),
    ast.IsNot: ("is not", "is", "condition"), ast.In: ("in", "not in", "condition"),
    ast.NotIn: ("not in", "in", "condition"),
}
_DROPPED_CALLS = {"abs", "fabs", "sqrt", "radians", "degrees", "deg2rad", "rad2deg", "square"}
_LOGGING = re.compile(r"(log)?(debug|info|warn|warning|err|error|exception|critical|fatal)(_once)?")
_NOT_SWAPPED = {
    "isinstance", "issubclass", "getattr", "hasattr", "setattr", "cast",  # nobody mistakes them
    "min", "max", "minimum", "maximum", "hypot", "logical_and", "logical_or", "gcd",
    "compare_digest",  # the same
}
_GUARDS = {"strict", "daemon"}
_TINY = 1e-5


@dataclass(frozen=True)
class Place:
    """Where in the source the walk is.

    `lines` and `names` are those of Fault; `variables` are the function's, `loop` is the kind of
    the innermost loop, `index` says that it is between brackets, `setting_up` in a constructor.
    """

    function: str = ""
    lines: tuple[int, int] = (0, 0)
    names: tuple[str, ...] = ()
    compiled: bool = False
    variables: frozenset[str] = frozenset()
    loop: str = ""
    index: bool = False
    setting_up: bool = False


Edit = tuple[Place, str, int, int, str]


class Walk:
    """The tree of one source, and the edits that its nodes allow."""

    def __init__(self, source: bytes, file: str) -> None:
        self.source = source
        self.tree = ast.parse(source, file)
        self._line_starts = [0]
        for line in source.splitlines(keepends=True):
            self._line_starts.append(self._line_starts[-1] + len(line))
        # numpy takes any negative length for what is left
        self._lengths = {one.operand for call in ast.walk(self.tree) if isinstance(call, ast.Call)
                         and _called(call) == "reshape" for one in call.args
                         if isinstance(one, ast.UnaryOp)}
        self._attributes = {n.attr for n in ast.walk(self.tree) if isinstance(n, ast.Attribute)}

    def edits(self) -> Iterator[Edit]:
        yield from self._statements(self.tree.body, Place())

    # -- text ------------------------------------------------------------------------------

    def _start(self, node: ast.AST) -> int:
        return self._line_starts[node.lineno - 1] + node.col_offset

    def _end(self, node: ast.AST) -> int:
        return self._line_starts[node.end_lineno - 1] + node.end_col_offset

    def _text(self, node: ast.AST) -> str:
        return self.source[self._start(node) : self._end(node)].decode()

    def _whole(self, place: Place, operator: str, node: ast.AST, text: str) -> Edit:
        return place, operator, self._start(node), self._end(node), text

    def _between(
        self, place: Place, operator: str, left: ast.AST, right: ast.AST, was: str, now: str
    ) -> Iterator[Edit]:
        """Change the operator sign between two neighbours."""
        start, end = self._end(left), self._start(right)
        gap = self.source[start:end].decode()
        at = gap.find(was)
        if at >= 0 and "#" not in gap:
            at = start + len(gap[:at].encode())
            yield place, operator, at, at + len(was), now

    # -- statements ------------------------------------------------------------------------

    def _statements(self, body: list[ast.stmt], place: Place) -> Iterator[Edit]:
        for statement in body:
            yield from self._statement(statement, place)

    def _statement(self, node: ast.stmt, place: Place) -> Iterator[Edit]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from self._function(node, place)
            return
        if isinstance(node, ast.ClassDef):
            inner = Place(_join(place.function, node.name), names=(node.name,))
            yield from self._statements(node.body, inner)
            return
        place = self._placed(node, place)
        handler: Callable[..., Iterator[Edit]] | None = getattr(
            self, f"_on_{type(node).__name__.lower()}", None
        )
        if handler is not None:
            yield from handler(node, place)
        elif not isinstance(node, ast.Import | ast.ImportFrom | ast.Assert):
            yield from self._children(node, place)

    def _placed(self, node: ast.stmt, place: Place) -> Place:
        """The place with the lines of this statement, of its head where it has a body."""
        last = node.end_lineno
        if getattr(node, "body", None):
            last = max(node.lineno, node.body[0].lineno - 1)
        names = place.names
        if names or not place.function:
            targets = getattr(node, "targets", None) or [getattr(node, "target", None)]
            found = [n.id for t in targets if t for n in ast.walk(t) if isinstance(n, ast.Name)]
            names = tuple(dict.fromkeys((*place.names, *found)))
        return replace(place, lines=(node.lineno, last), names=names, index=False)

    def _function(self, node: ast.FunctionDef, place: Place) -> Iterator[Edit]:
        if node.name in ("__repr__", "__str__"):
            return
        compiled = any(COMPILED.search(self._text(d)) for d in node.decorator_list)
        variables = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
        variables |= {a.arg for a in ast.walk(node) if isinstance(a, ast.arg)}
        inner = Place(
            _join(place.function, node.name), (node.body[0].lineno, node.end_lineno),
            (node.name,) if compiled else (), compiled, frozenset(variables),
            setting_up=node.name in ("__init__", "__post_init__", "__new__"),
        )
        for default in (*node.args.defaults, *node.args.kw_defaults):
            if default is not None:
                yield from self._expression(default, inner)
        yield from self._statements(node.body, inner)

    def _on_expr(self, node: ast.Expr, place: Place) -> Iterator[Edit]:
        call = node.value
        if isinstance(call, ast.Constant):
            return
        if isinstance(call, ast.Call):
            if _LOGGING.fullmatch(_called(call)):
                return
            if "super()" not in self._text(call.func):
                yield self._whole(place, "statement", node, "pass")
        yield from self._children(node, place)

    def _on_assign(self, node: ast.Assign, place: Place) -> Iterator[Edit]:
        names = {t.id for t in node.targets if isinstance(t, ast.Name)}
        if names & {"__all__", "__slots__"}:
            return
        state = any(isinstance(t, ast.Attribute | ast.Subscript) for t in node.targets)
        if state and not place.setting_up and place.function and not place.names:
            yield self._whole(place, "statement", node, "pass")
        for target in node.targets:
            yield from self._expression(target, place)
        yield from self._expression(node.value, place)

    def _on_annassign(self, node: ast.AnnAssign, place: Place) -> Iterator[Edit]:
        if node.value is not None:
            yield from self._expression(node.value, place)

    def _on_augassign(self, node: ast.AugAssign, place: Place) -> Iterator[Edit]:
        if type(node.op) in _ARITHMETIC:
            was, now, operator = _ARITHMETIC[type(node.op)]
            yield from self._between(place, operator, node.target, node.value, f"{was}=", f"{now}=")
        yield self._whole(place, "statement", node, "pass")
        yield from self._children(node, place)

    def _on_if(self, node: ast.If, place: Place) -> Iterator[Edit]:
        test = self._text(node.test)
        if "TYPE_CHECKING" in test or "__name__" in test:
            return
        yield from self._negated(node.test, place)
        yield from self._expression(node.test, place)
        yield from self._statements(node.body, place)
        yield from self._statements(node.orelse, place)

    def _on_while(self, node: ast.While, place: Place) -> Iterator[Edit]:
        yield from self._expression(node.test, place)
        yield from self._statements(node.body + node.orelse, _inside(place, "while"))

    def _on_for(self, node: ast.For, place: Place) -> Iterator[Edit]:
        yield from self._expression(node.iter, place)
        yield from self._statements(node.body + node.orelse, _inside(place, "for"))

    def _on_continue(self, node: ast.Continue, place: Place) -> Iterator[Edit]:
        if place.loop == "for":
            yield self._whole(place, "statement", node, "pass")

    _on_break = _on_continue

    def _on_return(self, node: ast.Return, place: Place) -> Iterator[Edit]:
        if node.value is None:
            yield self._whole(place, "statement", node, "pass")
        yield from self._children(node, place)

    def _on_raise(self, node: ast.Raise, place: Place) -> Iterator[Edit]:
        yield self._whole(place, "refusal", node, "pass")

    def _on_try(self, node: ast.Try, place: Place) -> Iterator[Edit]:
        yield from self._statements(node.body, place)
        for handler in node.handlers:
            inner = _at_lines(place, handler.lineno, handler.end_lineno)
            if not (len(handler.body) == 1
                    and isinstance(handler.body[0], ast.Pass | ast.Raise | ast.Continue)):
                yield (inner, "exception", self._start(handler.body[0]),
                       self._end(handler.body[-1]), "pass")
            if isinstance(handler.type, ast.Tuple):
                kept = ", ".join(self._text(e) for e in handler.type.elts[:-1])
                yield self._whole(inner, "exception", handler.type, f"({kept},)")
            yield from self._statements(handler.body, place)
        if node.finalbody:
            first, last = node.finalbody[0], node.finalbody[-1]
            inner = _at_lines(place, first.lineno, last.end_lineno)
            yield inner, "exception", self._start(first), self._end(last), "pass"
        yield from self._statements(node.orelse + node.finalbody, place)

    # -- expressions -----------------------------------------------------------------------

    def _children(self, node: ast.AST, place: Place) -> Iterator[Edit]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.stmt):
                yield from self._statement(child, place)
            elif isinstance(child, ast.expr):
                yield from self._expression(child, place)
            elif isinstance(child, ast.keyword) and child.arg in _GUARDS:
                continue
            elif not isinstance(child, ast.expr_context | ast.operator | ast.pattern):
                yield from self._children(child, place)

    def _expression(self, node: ast.expr, place: Place) -> Iterator[Edit]:
        if isinstance(node, ast.JoinedStr):
            return
        handler: Callable[..., Iterator[Edit]] | None = getattr(
            self, f"_of_{type(node).__name__.lower()}", None
        )
        if handler is not None:
            yield from handler(node, place)
        if isinstance(node, ast.Call) and _LOGGING.fullmatch(_called(node)):
            return
        if isinstance(node, ast.Subscript):
            yield from self._expression(node.value, place)
            yield from self._expression(node.slice, _inside(place, place.loop, index=True))
            return
        if isinstance(node, ast.Call):
            place = _inside(place, place.loop)
        yield from self._children(node, place)

    def _negated(self, test: ast.expr, place: Place) -> Iterator[Edit]:
        flips = (ast.Eq, ast.NotEq, ast.Is, ast.IsNot, ast.In, ast.NotIn)
        simple = isinstance(test, ast.Compare) and len(test.ops) == 1
        if simple and isinstance(test.ops[0], flips) or isinstance(test, ast.UnaryOp):
            return  # there is a fault of its own for these
        yield self._whole(place, "condition", test, f"not ({self._text(test)})")

    def _of_ifexp(self, node: ast.IfExp, place: Place) -> Iterator[Edit]:
        yield from self._negated(node.test, place)

    def _of_binop(self, node: ast.BinOp, place: Place) -> Iterator[Edit]:
        if any(_is_text(side) for side in (node.left, node.right)):
            return
        if isinstance(node.op, ast.MatMult):
            left, right = self._text(node.left), self._text(node.right)
            yield self._whole(place, "transpose", node, f"(({right}) @ ({left}))")
        elif type(node.op) in _ARITHMETIC:
            was, now, operator = _ARITHMETIC[type(node.op)]
            yield from self._between(place, operator, node.left, node.right, was, now)

    def _of_unaryop(self, node: ast.UnaryOp, place: Place) -> Iterator[Edit]:
        if isinstance(node.op, ast.USub):
            operator = "index" if place.index else "sign"
            yield self._whole(place, operator, node, f"({self._text(node.operand)})")
        elif isinstance(node.op, ast.Not):
            yield self._whole(place, "condition", node, f"bool({self._text(node.operand)})")

    def _of_compare(self, node: ast.Compare, place: Place) -> Iterator[Edit]:
        sides = [node.left, *node.comparators]
        for left, right, op in zip(sides, sides[1:], node.ops, strict=False):
            was, now, operator = _COMPARISONS[type(op)]
            yield from self._between(place, operator, left, right, was, now)

    def _of_boolop(self, node: ast.BoolOp, place: Place) -> Iterator[Edit]:
        was, now = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield from self._between(place, "logic", left, right, was, now)

    def _of_constant(self, node: ast.Constant, place: Place) -> Iterator[Edit]:
        value = node.value
        if node in self._lengths:
            return
        if isinstance(value, bool):
            yield self._whole(place, "condition", node, str(not value))
        elif isinstance(value, int):
            yield self._whole(place, "index" if place.index else "constant", node, str(value + 1))
        elif isinstance(value, float) and abs(value) < 1e300:
            factor = 1.25 if abs(value) > _TINY else 1e6  # of a tolerance nobody sees a quarter
            yield self._whole(place, "constant", node, repr(value * factor if value else 1.0))

    def _of_subscript(self, node: ast.Subscript, place: Place) -> Iterator[Edit]:
        if isinstance(node.slice, ast.Tuple) and len(node.slice.elts) == 2:
            first, second = (self._text(e) for e in node.slice.elts)
            if first != second:
                yield self._whole(place, "index", node.slice, f"{second}, {first}")

    def _of_call(self, node: ast.Call, place: Place) -> Iterator[Edit]:
        name, args = _called(node), node.args
        if not any(isinstance(a, ast.Starred) for a in args) and name not in _NOT_SWAPPED:
            for k in sorted({0, len(args) - 2}):
                if 0 <= k < len(args) - 1:
                    first, second = self._text(args[k]), self._text(args[k + 1])
                    if first != second and not (_is_text(args[k]) and _is_text(args[k + 1])):
                        span = self._start(args[k]), self._end(args[k + 1])
                        yield place, "arguments", *span, f"{second}, {first}"
        everything = sorted((*args, *(k.value for k in node.keywords)), key=self._start)
        for keyword in node.keywords:
            if keyword.arg in (None, *_GUARDS) or (
                keyword.arg == "dtype" and self._text(keyword.value) == "float"
                or keyword.arg == "name" and name == "Thread"
            ):
                continue
            before = [a for a in everything if self._end(a) <= self._start(keyword)]
            after = [a for a in node.keywords if self._start(a) > self._start(keyword)]
            if before:
                start = self._end(before[-1])
                gap = self.source[start : self._start(keyword)]
                start += len(gap) - len(gap.lstrip(b" \n)"))
                yield place, "arguments", start, self._end(keyword), ""
            else:
                end = self._start(after[0]) if after else self._end(keyword)
                yield place, "arguments", self._start(keyword), end, ""
        if name in ("copy", "deepcopy"):
            if isinstance(node.func, ast.Attribute) and not args and not node.keywords:
                yield self._whole(place, "copy", node, self._text(node.func.value))
            elif len(args) == 1:
                yield self._whole(place, "copy", node, f"({self._text(args[0])})")
        if name in _DROPPED_CALLS and len(args) == 1:
            yield self._whole(place, "call", node, f"({self._text(args[0])})")

    def _of_attribute(self, node: ast.Attribute, place: Place) -> Iterator[Edit]:
        if not isinstance(node.ctx, ast.Load):
            return
        if node.attr == "T":
            yield self._whole(place, "transpose", node, self._text(node.value))
        for other in also_attribute(node.attr, self._attributes):
            end = self._end(node)
            yield place, "name", end - len(node.attr.encode()), end, other

    def _of_name(self, node: ast.Name, place: Place) -> Iterator[Edit]:
        if not isinstance(node.ctx, ast.Load):
            return
        for other in also_variable(node.id, place.variables):
            yield self._whole(place, "name", node, other)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
    )


def _called(node: ast.Call) -> str:
    function = node.func
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _join(outer: str, name: str) -> str:
    return f"{outer}.{name}" if outer else name


def _inside(place: Place, loop: str, index: bool = False) -> Place:
    return replace(place, loop=loop, index=index)


def _at_lines(place: Place, first: int, last: int) -> Place:
    return replace(place, lines=(first, last), index=False)
