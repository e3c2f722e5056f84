"""Code blocks of all pages of the documentation site.

What a test has to know of a block that a reader need not stands in a comment before it:
`<!-- test: given arm, joints -->` names what the code takes for granted (see test_blocks.GIVEN),
`<!-- test: run with repeats=1 -->` has the command carried out, with more words than are printed.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[3]
PAGES = sorted(
    path
    for pattern in ("README.md", "docs/*.md", "src/*/README.md", "src/*/docs/*.md", "tests/*.md")
    for path in ROOT.glob(pattern)
)
MARK = re.compile(r"<!-- test: (.*?) -->")
FILE = re.compile(r"^(?:#|//|<!--) ([\w./-]+\.(?:py|yaml|urdf|launch))(?: -->)?\n")


@dataclass(frozen=True)
class Block:
    """A code block. mark: the comment before it. fenced: False if the block is indented."""

    page: Path
    line: int
    language: str
    text: str
    mark: str = ""
    fenced: bool = True

    @property
    def place(self) -> str:
        """Position of the block in the form FILE:LINE that editors open."""
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    @property
    def file(self) -> str:
        """Path in the first line of the block; empty if there is none."""
        found = FILE.match(self.text)
        return found[1] if found else ""

    def commands(self) -> Iterator[list[str]]:
        """Words of each command of a shell block, without those that start it in the background."""
        pending = ""
        for line in self.text.replace("\\\n", " ").splitlines():
            pending += f"{line}\n"
            try:
                words = shlex.split(pending, comments=True)
            except ValueError:  # a quotation goes on
                continue
            pending = ""
            while words:
                cut = next((i for i, word in enumerate(words) if word in ("&&", "&", ";")), None)
                command, words = words[:cut], [] if cut is None else words[cut + 1 :]
                while command and re.match(r"^[A-Z_]+=", command[0]):
                    command = command[1:]
                if command:
                    yield command
        assert not pending, f"{self.place}: a quotation does not end"


def blocks(page: Path) -> list[Block]:
    """Return all code blocks of a page, in order."""
    made, mark = [], ""
    for token in MarkdownIt("commonmark").parse(page.read_text(encoding="utf-8")):
        if token.type == "html_block":
            found = MARK.search(token.content)
            mark = found[1] if found else ""
        elif token.type in ("fence", "code_block"):
            line = token.map[0] + 1
            made.append(
                Block(page, line, token.info.strip(), token.content, mark, token.type == "fence")
            )
            mark = ""
        elif token.nesting == 1:
            mark = ""
    return made
