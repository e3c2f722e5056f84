"""The lines with which docs/schemes.md begins, worked out from the tables that stand below them."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

CANONICAL, DOMAIN, BASIN = "| scheme | condition | task |", "| scheme | condition | converged", 1
SHOWN = 8  # names that a line holds


def with_result(page: str) -> str:
    """The page with these lines below its title."""
    title, _, rest = page.partition("\n\n")
    return f"{title}\n\n" + "".join(f"- {line}\n" for line in result(page)) + f"\n{rest}"


def result(page: str) -> list[str]:
    """About ten sentences."""
    tables = _tables(page)
    canonical = next((rows for head, rows in tables if head.startswith(CANONICAL)), [])
    domain = next((rows for head, rows in tables if head.startswith(DOMAIN)), [])
    basin = [rows for head, rows in tables if head.startswith(CANONICAL)][BASIN:]
    lines = []
    conditions = dict.fromkeys(row[1] for row in canonical)
    for condition in conditions:
        own = [row for row in canonical if row[1] == condition]
        lines.append(f"*Canonical tasks, {condition}*: {_best(own, 'reach the goal')}")
    tasks = {task: _share([row for row in canonical if row[2] == task])
             for task in dict.fromkeys(row[2] for row in canonical)}  # fmt: skip
    if tasks:
        hardest = min(tasks, key=tasks.get)
        lines.append("Of all these runs the goal is reached in " + ", ".join(
            f"{100 * share:.0f} % ({task})" for task, share in tasks.items())
            + f": {hardest} is the hardest.")  # fmt: skip
    for condition in dict.fromkeys(row[1] for row in domain):
        own = [row for row in domain if row[1] == condition]
        known = [f"{row[3]}" for row in own if row[3]]
        published = f" Published elsewhere: {', '.join(known)}." if known else ""
        lines.append(f"*Rendered, {condition}*: {_best(own, 'converge')}{published}")
    for rows in basin[:1]:
        for row in rows:
            starts = row[3].partition(" (")[0]
            lines.append(f"*The paper's own case, {row[0]}*: {starts} starts reach the goal, "
                         f"{row[5]} mm and {row[6]} degrees off (medians), {row[4]} s until they "
                         "settle.")  # fmt: skip
    return lines


def _best(rows: Sequence[Sequence[str]], verb: str) -> str:
    """Which schemes do best over these rows, and from how many starts."""
    column = 3 if len(rows[0]) > 8 else 2
    hits: dict[str, tuple[int, int]] = {}
    for row in rows:
        good, of = _counted(row[column])
        before = hits.get(row[0], (0, 0))
        hits[row[0]] = (before[0] + good, before[1] + of)
    most = max(good / of for good, of in hits.values())
    names = [name for name, (good, of) in hits.items() if good / of == most]
    good, of = hits[names[0]]
    more = f"; and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    middle = median(100 * g / o for g, o in hits.values())
    return (f"{good} of {of} runs {verb} with each of: {'; '.join(names[:SHOWN])}{more}. The "
            f"median of {len(hits)} schemes is {middle:.0f} %.")  # fmt: skip


def _share(rows: Sequence[Sequence[str]]) -> float:
    counts = [_counted(row[3]) for row in rows]
    return sum(good for good, _ in counts) / sum(of for _, of in counts)


def _counted(cell: str) -> tuple[int, int]:
    """'25 of 25 (87-100 %)'."""
    good, _, rest = cell.partition(" of ")
    return int(good), int(rest.partition(" ")[0])


def _tables(page: str) -> list[tuple[str, list[list[str]]]]:
    """Heads of all tables, and their cells."""
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
