"""Summary at the top of docs/schemes.md, computed from the tables of that page."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

CANONICAL, DOMAIN, BASIN = "| scheme | condition | task |", "| scheme | condition | converged", 1
MAX_NAMES = 8  # maximum number of scheme names in a line


def add_summary(page: str) -> str:
    """Return the page with the summary inserted below its title."""
    title, _, rest = page.partition("\n\n")
    summary = "".join(f"- {line}\n" for line in summarize(page))
    return f"{title}\n\nThe following list summarises the tables of this page:\n\n{summary}\n{rest}"


def summarize(page: str) -> list[str]:
    """Return the lines of the summary, about ten."""
    tables = _find_tables(page)
    canonical = next((rows for head, rows in tables if head.startswith(CANONICAL)), [])
    domain = next((rows for head, rows in tables if head.startswith(DOMAIN)), [])
    basin = [rows for head, rows in tables if head.startswith(CANONICAL)][BASIN:]
    lines = []
    conditions = dict.fromkeys(row[1] for row in canonical)
    for condition in conditions:
        own = [row for row in canonical if row[1] == condition]
        lines.append(f"*Canonical tasks, {condition}*: {_describe_best(own, 'reach the goal')}")
    tasks = {task: _compute_share([row for row in canonical if row[2] == task])
             for task in dict.fromkeys(row[2] for row in canonical)}  # fmt: skip
    if tasks:
        hardest = min(tasks, key=tasks.get)
        lines.append("In the canonical tasks, all schemes together reach the goal in " + ", ".join(
            f"{100 * share:.0f} % ({task})" for task, share in tasks.items())
            + f" of the runs; the task '{hardest}' is the hardest.")  # fmt: skip
    for condition in dict.fromkeys(row[1] for row in domain):
        own = [row for row in domain if row[1] == condition]
        known = [f"{row[3]}" for row in own if row[3]]
        published = f" The published rate is {', '.join(known)}." if known else ""
        lines.append(f"*Rendered, {condition}*: {_describe_best(own, 'converge')}{published}")
    for rows in basin[:1]:
        for row in rows:
            starts = row[3].partition(" (")[0]
            lines.append(f"*Case of the original paper, {row[0]}*: the goal is reached from "
                         f"{starts} starts. The median error is {row[5]} mm and {row[6]} degrees, "
                         f"and the median settling time is {row[4]} s.")  # fmt: skip
    return lines


def _describe_best(rows: Sequence[Sequence[str]], verb: str) -> str:
    """Name the schemes with the most successes in these rows, and their number of starts."""
    column = 3 if len(rows[0]) > 8 else 2
    hits: dict[str, tuple[int, int]] = {}
    for row in rows:
        good, of = _parse_counts(row[column])
        before = hits.get(row[0], (0, 0))
        hits[row[0]] = (before[0] + good, before[1] + of)
    most = max(good / of for good, of in hits.values())
    names = [name for name, (good, of) in hits.items() if good / of == most]
    good, of = hits[names[0]]
    more = f"; and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    median_rate = median(100 * g / o for g, o in hits.values())
    return (f"{good} of {of} runs {verb} with each of these schemes: "
            f"{'; '.join(names[:MAX_NAMES])}{more}. The median success rate of all {len(hits)} "
            f"schemes is {median_rate:.0f} %.")  # fmt: skip


def _compute_share(rows: Sequence[Sequence[str]]) -> float:
    counts = [_parse_counts(row[3]) for row in rows]
    return sum(good for good, _ in counts) / sum(of for _, of in counts)


def _parse_counts(cell: str) -> tuple[int, int]:
    """Parse the two counts of a cell such as '25 of 25 (87-100 %)'."""
    good, _, rest = cell.partition(" of ")
    return int(good), int(rest.partition(" ")[0])


def _find_tables(page: str) -> list[tuple[str, list[list[str]]]]:
    """Return the heading line and the cells of every table of the page."""
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
