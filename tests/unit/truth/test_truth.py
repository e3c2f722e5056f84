"""The fast checks of `tests/truth`, and that its command reports failed checks."""

import json

import pytest

from truth_checks import cli, result
from truth_checks.check import CHECKS, Check, Row

QUICK = [check for check in CHECKS.values() if check.quick]


@pytest.mark.parametrize("check", QUICK, ids=[check.name for check in QUICK])
def test_it_is_as_independent_software_says(check):
    rows = list(check.rows())
    assert rows
    for row in rows:
        assert row.passed, f"{row.what}: {row.measured:.3g} {row.unit}, at most {row.bound}"


def heat(*rows):
    """One check with these rows."""
    return {"heat": Check("heat", "a book", False, lambda: rows)}


@pytest.mark.parametrize(("measured", "status"), [(0.1, 0), (0.3, 1), (float("nan"), 1)])
def test_a_number_beyond_its_bound_or_none_at_all_is_a_failure(capsys, measured, status):
    rows = Row("melting point", "0 °C", measured, 0.2, "°C"), Row("boiling", "100 °C", 0.0, 0.2)
    assert cli.main([], heat(*rows)) == status
    *lines, last = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("FAIL heat" if status else "ok   heat")
    assert json.loads(last) == {"rows": 2, "failed": ["heat: melting point"] * status}
    assert cli.main(["cold"], heat()) == 2 and "heat" in capsys.readouterr().err


def test_the_table_is_written_and_rows_of_checks_that_were_not_made_stay(tmp_path):
    table, checks = tmp_path / "truth.md", heat(Row("melting point", "0 °C", 0.3, 0.2, "°C"))
    cli.main(["--write"], checks, table)
    told = table.read_text().split("| check |")[0]
    assert "- 0 of 1 comparisons, in 1 checks, are within their bounds; beyond: heat: " in told
    assert "- The references, with the number of comparisons: a book (1)." in told
    assert "closest to their bounds: heat (melting point): 0.3 °C, bound 0.2 °C." in told
    row = "| heat | a book | melting point | 0 °C | 0.3 °C | 0.2 °C | **no** |"
    assert row in table.read_text()
    cold = Check("cold", "a book", True, lambda: [Row("boiling point", "78 °C", 0.0, 0.1, "°C")])
    for arguments in (["cold", "--write"], ["--quick", "--write"]):
        cli.main(arguments, {"cold": cold, **checks}, table)
        lines = table.read_text().splitlines()
        kept = [line for line in lines if line.startswith(("| cold |", "| heat |"))]
        assert [line.split(" | ")[2] for line in kept] == ["boiling point", "melting point"]


def test_the_page_begins_with_what_its_tables_say():
    page = cli.TABLE.read_text(encoding="utf-8")
    assert result.with_result(page) == page, "write it again: tests/truth --write"
    lines = result.result(page)
    assert 8 <= len(lines) <= 12 and lines[-1].startswith("The servo loop reports ")
    assert page.index(lines[0]) < 200
    worse = page.replace("1.7e-07 | 0.0001 |  |", "1.7e-03 | 0.0001 | **no** |", 1)
    first = result.result(worse)[0]
    assert "beyond: a free base: base, Pinocchio" in first and first != lines[0]
