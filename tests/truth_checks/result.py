"""Summary at the top of docs/truth.md, computed from the tables of the page."""

from __future__ import annotations

import re
from collections import Counter

BEGIN, END = "<!-- result -->\n", "<!-- end of result -->\n"
SUMMARISED = (
    "mass matrix", "accelerations", "friction and damping", "PID steps", "contact friction",
    "projection", "depth and labels",
)  # fmt: skip
NEAREST = 3  # number of comparisons in the list of those closest to their bounds
OUTCOMES = "The servo loop reports a correct outcome in "  # start of the sentence on outcomes


def with_result(page: str) -> str:
    lines = "".join(f"- {line}\n" for line in result(page))
    if not lines:
        return page
    before, _, rest = page.partition(BEGIN)
    after = rest.partition(END)[2] if rest else ""
    if not rest:
        before, _, after = page.partition("\n\n")
        before += "\n\n"
        after = f"\n{after}"
    return f"{before}{BEGIN}{lines}{END}{after}"


def result(page: str) -> list[str]:
    """Return the lines of the summary, about ten."""
    rows = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in page.splitlines()
            if line.startswith("| ") and line.count("|") == 8]  # fmt: skip
    rows = [row for row in rows if row[0] != "check"]
    if not rows:
        return []
    failed = [f"{row[0]}: {row[2]}" for row in rows if row[6]]
    checks = len({row[0] for row in rows})
    counted = Counter(name for row in rows for name in set(re.split(r", (?!and )", row[1])))
    lines = [
        f"{len(rows) - len(failed)} of {len(rows)} comparisons, in {checks} checks, are within "
        f"their bounds{'; beyond: ' + '; '.join(failed) if failed else ''}.",
        "The references, with the number of comparisons: "
        + ", ".join(f"{name} ({n})" for name, n in counted.most_common(8)) + ".",
    ]
    for name in SUMMARISED:
        own = [row for row in rows if row[0] == name]
        if own:
            worst = max(own, key=_share)
            lines.append(f"*{name}*, compared with {worst[1]}: the largest deviation is {worst[4]} "
                         f"(in the case '{worst[2]}'); the bound is {worst[5]}.")  # fmt: skip
    near = sorted(rows, key=_share)[-NEAREST:][::-1]
    lines.append("The deviations that are closest to their bounds: " + "; ".join(
        f"{row[0]} ({row[2]}): {row[4]}, bound {row[5]}" for row in near) + ".")  # fmt: skip
    lines += [line for line in page.splitlines() if line.startswith(OUTCOMES)][:1]
    return lines


def _share(row: list[str]) -> float:
    measured, bound = (float(re.match(r"[-+.\deE]+", cell)[0]) for cell in row[4:6])
    return measured / bound if bound else 0.0
