"""Summary at the top of docs/schemes.md, computed from the tables of the page."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

CANONICAL, DOMAIN, BASIN = "| scheme | condition | task |", "| scheme | condition | converged", 1
SHOWN = 8  # largest number of names in a line


def with_result(page: str) -> str:
    """Return the page with the summary below its title."""
    title, _, rest = page.partition("\n\n")
    return f"{title}\n\n" + "".join(f"- {line}\n" for line in result(page)) + f"\n{rest}"


def result(page: str) -> list[str]:
    """Return the lines of the summary, about ten."""
    tables = _tables(page)
    canonical = next((rows for head, rows in tables if head.startswith(CANONICAL)), [])
    domain = next((rows for head, rows in tables if head.startswith(DOMAIN)), [])
    basin = [rows for head, rows in tables if head.startswith(CANONICAL)][BASIN:]
    lines = []
    conditions = dict.fromkeys(row[1] for row in canonical)
    for condition in conditions:
        own = [row for row in canonical if row[1] == condition]
        lines.append(f"*Canonical tasks, {condition}*: {_best(own, 'reach the goal')}")
    tasks = {task: _success_rate([row for row in canonical if row[2] == task])
             for task in dict.fromkeys(row[2] for row in canonical)}  # fmt: skip
    if tasks:
        hardest = min(tasks, key=tasks.get)
        lines.append("Success of all these runs by task: " + ", ".join(
            f"{100 * share:.0f} % ({task})" for task, share in tasks.items())
            + f"; the hardest is {hardest}.")  # fmt: skip
    for condition in dict.fromkeys(row[1] for row in domain):
        own = [row for row in domain if row[1] == condition]
        known = [f"{row[3]}" for row in own if row[3]]
        published = f" Published elsewhere: {', '.join(known)}." if known else ""
        lines.append(f"*Rendered, {condition}*: {_best(own, 'converge')}{published}")
    for rows in basin[:1]:
        for row in rows:
            starts = row[3].partition(" (")[0]
            lines.append(f"*Experiment of the original paper, {row[0]}*: {starts} starts reach the "
                         f"goal (median error {row[5]} mm and {row[6]} degrees, median settling "
                         f"time {row[4]} s).")  # fmt: skip
    return lines


def _best(rows: Sequence[Sequence[str]], verb: str) -> str:
    """Return a sentence with the best schemes of these rows and their success."""
    column = 3 if len(rows[0]) > 8 else 2
    hits: dict[str, tuple[int, int]] = {}
    for row in rows:
        good, of = _read_counts(row[column])
        before = hits.get(row[0], (0, 0))
        hits[row[0]] = (before[0] + good, before[1] + of)
    most = max(good / of for good, of in hits.values())
    names = [name for name, (good, of) in hits.items() if good / of == most]
    good, of = hits[names[0]]
    more = f"; and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    middle = median(100 * g / o for g, o in hits.values())
    best = "; ".join(names[:SHOWN])
    return (f"{good} of {of} runs {verb} with each of these schemes: {best}{more}. The "
            f"median of {len(hits)} schemes is {middle:.0f} %.")  # fmt: skip


def _success_rate(rows: Sequence[Sequence[str]]) -> float:
    counts = [_read_counts(row[3]) for row in rows]
    return sum(good for good, _ in counts) / sum(of for _, of in counts)


def _read_counts(cell: str) -> tuple[int, int]:
    """Read a cell such as '25 of 25 (87-100 %)'; return successes and number of runs."""
    good, _, rest = cell.partition(" of ")
    return int(good), int(rest.partition(" ")[0])


def _tables(page: str) -> list[tuple[str, list[list[str]]]]:
    """Return the header line and the cells of each table."""
    found: list[tuple[str, list[list[str]]]] = []
    inside = False
    for line in page.splitlines():
        if not line.startswith("|"):
            inside = False
        elif not inside:
            found.append((line, []))
            inside = True
        elif not line.startswith("|---"):
            found[-1][1].append([cell.strip() for cell in line.strip("|").split("|")])
    return found
