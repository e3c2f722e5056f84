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


@pytest.fixture
def only(monkeypatch):
    """Puts checks of the test's own in the place of all others."""
    def put(*rows):
        monkeypatch.setattr(cli, "CHECKS", {"heat": Check("heat", "a book", False, lambda: rows)})
    return put


def test_a_number_within_its_bound_is_a_success(only, capsys):
    only(Row("melting point", "0 °C", 0.1, 0.2, "°C"))
    assert cli.main([]) == 0
    out = capsys.readouterr().out
    assert "ok   heat" in out
    assert json.loads(out.splitlines()[-1]) == {"rows": 1, "failed": []}


@pytest.mark.parametrize("measured", [0.3, float("nan")])
def test_a_number_beyond_its_bound_or_none_at_all_is_a_failure(only, capsys, measured):
    only(Row("melting point", "0 °C", measured, 0.2, "°C"), Row("boiling", "100 °C", 0.0, 0.2))
    assert cli.main([]) == 1
    out = capsys.readouterr().out
    assert json.loads(out.splitlines()[-1]) == {"rows": 2, "failed": ["heat: melting point"]}


def test_an_unknown_check_is_named_with_those_there_are(only, capsys):
    only()
    assert cli.main(["cold"]) == 2
    assert "heat" in capsys.readouterr().err


def test_the_table_is_written_for_the_documentation(only, tmp_path, monkeypatch):
    only(Row("melting point", "0 °C", 0.3, 0.2, "°C"))
    monkeypatch.setattr(cli, "TABLE", tmp_path / "truth.md")
    cli.main(["--write"])
    told = (tmp_path / "truth.md").read_text().split("| check |")[0]
    assert "- 0 of 1 comparisons, in 1 checks, are within their bounds; beyond: heat: " in told
    assert "- The references, with the number of comparisons: a book (1)." in told
    assert "closest to their bounds: heat (melting point): 0.3 °C, bound 0.2 °C." in told
    assert "| heat | a book | melting point | 0 °C | 0.3 °C | 0.2 °C | **no** |" in \
        (tmp_path / "truth.md").read_text()


def test_rows_of_checks_that_were_not_made_stay(only, tmp_path, monkeypatch):
    only(Row("melting point", "0 °C", 0.3, 0.2, "°C"))
    monkeypatch.setattr(cli, "TABLE", tmp_path / "truth.md")
    cli.main(["--write"])
    cold = Check("cold", "a book", True, lambda: [Row("boiling point", "78 °C", 0.0, 0.1, "°C")])
    monkeypatch.setattr(cli, "CHECKS", {"cold": cold, **cli.CHECKS})
    for arguments in (["cold", "--write"], ["--quick", "--write"]):
        cli.main(arguments)
        lines = (tmp_path / "truth.md").read_text().splitlines()
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
