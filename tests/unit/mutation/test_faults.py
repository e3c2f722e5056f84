"""Which wrong edits the mutation tool makes, and that a seed always draws the same ones."""

from __future__ import annotations

import pytest

from mutation_tool.faults import OPERATORS, Fault, faults_of, is_fault, sample


def changes(source: str) -> set[tuple[str, str]]:
    """(operator, changed line) of all faults of a source."""
    text = source.encode()
    return {(f.operator, f.now) for f in faults_of(text, "toy.py") if is_fault(f, text)}


@pytest.mark.parametrize(
    ("line", "operator", "now"),
    [
        ("a = b + c", "sign", "a = b - c"),
        ("a -= c", "sign", "a += c"),
        ("a = -b", "sign", "a = (b)"),
        ("a = b * c", "scale", "a = b / c"),
        ("a = b ** c", "scale", "a = b * c"),
        ("a = 2.0", "constant", "a = 2.5"),
        ("a = 1e-9", "constant", "a = 0.001"),
        ("a = b[0]", "index", "a = b[1]"),
        ("a = b[-1]", "index", "a = b[(1)]"),
        ("a = b[i, j]", "index", "a = b[j, i]"),
        ("a = b[1:]", "index", "a = b[2:]"),
        ("a = b < c", "bound", "a = b <= c"),
        ("a = b >= c", "bound", "a = b > c"),
        ("a = b == c", "condition", "a = b != c"),
        ("a = b not in c", "condition", "a = b in c"),
        ("a = f(b=True)", "condition", "a = f(b=False)"),
        ("a = b and c", "logic", "a = b or c"),
        ("a = math.sin(b)", "name", "a = math.cos(b)"),
        ("a = K.fx + K.fy", "name", "a = K.fy + K.fy"),
        ("a = f(b, c)", "arguments", "a = f(c, b)"),
        ("a = f(b, gain=c)", "arguments", "a = f(b)"),
        ("a = f(b=c, d=e)", "arguments", "a = f(d=e)"),
        ("a = R.T", "transpose", "a = R"),
        ("a = R @ v", "transpose", "a = ((v) @ (R))"),
        ("a = b.copy()", "copy", "a = b"),
        ("a = abs(b)", "call", "a = (b)"),
        ("clear(a)", "statement", "pass"),
    ],
)
def test_operators(line: str, operator: str, now: str) -> None:
    assert (operator, now) in changes(line)


@pytest.mark.parametrize(
    ("body", "operator", "now"),
    [
        ("if a:\n        raise ValueError('no')", "refusal", "pass"),
        ("try:\n        f()\n    except ValueError:\n        return 1", "exception", "pass"),
        ("try:\n        f()\n    except (ValueError, KeyError):\n        pass", "exception",
         "except (ValueError,):"),
        ("if a > 1:\n        f()", "condition", "if not (a > 1):"),
        ("for a in b:\n        if a:\n            continue\n        f()", "statement", "pass"),
        ("self.total = 0", "statement", "pass"),
        ("x, y = a\n    return f(x)", "name", "return f(y)"),
    ],
)
def test_operators_inside_functions(body: str, operator: str, now: str) -> None:
    assert (operator, now) in changes(f"def f(self, a):\n    {body}\n")


@pytest.mark.parametrize(
    "line",
    ['"""Moves by 2 + 3."""', "a: Array[1 + 2]", "_log.warning('%s', 1 + 2)", "assert a < 1",
     "raised = f'{1 + 2} of 3'", "__all__ = ['a'] + [b]", "import a.b", "f(*a, strict=True)[b:]",
     "a = Thread(name=b, daemon=True)", "compare_digest(b, c)[:]"],
)
def test_what_no_test_could_notice_is_left_out(line: str) -> None:
    assert changes(line) == set()


def test_a_length_that_is_left_to_numpy_stays_so() -> None:
    assert changes("a = b.reshape(-1, 3)") == {
        ("arguments", "a = b.reshape(3, -1)"), ("sign", "a = b.reshape((1), 3)"),
        ("constant", "a = b.reshape(-1, 4)")}


def test_messages_of_refusals_stay() -> None:
    assert changes("def f(a):\n    raise Wrong('at ' + str(a + 1))\n") == {("refusal", "pass")}


def test_a_state_is_not_left_out_where_it_is_made() -> None:
    source = "class A:\n    def __init__(self, a):\n        self.a = a\n{}"
    assert changes(source.format("")) == set()
    reset = "    def reset(self, a):\n        self.a = a\n"
    assert changes(source.format(reset)) == {("statement", "pass")}


def test_an_edit_touches_one_place() -> None:
    source = b"# caf\xc3\xa9\na = '\xc3\xa9', b + c, b + c\n"
    edits = [f for f in faults_of(source, "toy.py") if f.operator == "sign"]
    assert [f.apply(source) for f in edits] == [
        b"# caf\xc3\xa9\na = '\xc3\xa9', b - c, b + c\n",
        b"# caf\xc3\xa9\na = '\xc3\xa9', b + c, b - c\n",
    ]
    assert all(f.line == 2 and f.was == "a = 'é', b + c, b + c" for f in edits)


def test_faults_carry_where_they_run() -> None:
    source = (b"LIMIT = 3.0\n\nclass A:\n    rate: float = 2.0\n\n    def f(self, a=1.0):\n"
              b"        if (a >\n                LIMIT):\n            return a + 1\n"
              b"        return 0\n\n@compiled('f8(f8)')\ndef g(a):\n    return a + a\n")
    by_line: dict[int, list[Fault]] = {}
    for fault in faults_of(source, "toy.py"):
        by_line.setdefault(fault.line, []).append(fault)
    assert by_line[1][0].names == ("LIMIT",)
    assert by_line[4][0].names == ("A", "rate")
    assert by_line[6][0].lines == (7, 10)  # a default is seen where the function runs
    assert {f.lines for f in by_line[7]} == {(7, 8)}
    assert by_line[9][0].function == "A.f" and not by_line[9][0].names
    assert by_line[14][0].names == ("g",) and by_line[14][0].compiled


SOURCE = b"def f(a, b):\n    c = a + b * 2.0\n    return c - a if a < b else f(b, a)\n"


def test_a_seed_draws_the_same_faults() -> None:
    sources = {"toy.py": SOURCE}
    assert sample(sources, 5, 1) == sample(sources, 5, 1)
    assert sample(sources, 4, 1) == sample(sources, 5, 1)[:4]
    assert sample(sources, 5, 1) != sample(sources, 5, 2)


def test_edits_elsewhere_leave_the_draw() -> None:
    moved = b"import math\n\n" + SOURCE
    drawn = [[f.key for f in sample({"toy.py": s}, 6, 3)] for s in (SOURCE, moved)]
    assert drawn[0] == drawn[1]


def test_only_narrows_the_draw() -> None:
    assert {f.line for f in sample({"toy.py": SOURCE}, 99, 1, only=r"toy.py f return")} == {3}
    assert sample({"toy.py": SOURCE}, 99, 1, only="nowhere") == []


def test_operators_are_all_listed() -> None:
    everything = SOURCE + b"\ndef g(self, a):\n    self.a = a[0]\n    raise Wrong\n"
    assert {f.operator for f in faults_of(everything, "toy.py")} <= set(OPERATORS)
