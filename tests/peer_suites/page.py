"""Tables between markers in a page of the documentation."""

from pathlib import Path


def write(page: Path, mark: str, text: str) -> None:
    """Write a table between `<!-- mark -->` and `<!-- /mark -->`; ValueError without these marks.
    """
    begin, end = f"<!-- {mark} -->", f"<!-- /{mark} -->"
    head, found, rest = page.read_text().partition(begin)
    if not found or end not in rest:
        raise ValueError(f"{page} has no {begin} ... {end}")
    page.write_text(f"{head}{begin}\n{text}\n{end}{rest.partition(end)[2]}")
