"""The list of edits that are no faults: no test could tell the edited program from the other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

from .faults import Fault

FILE = Path(__file__).with_name("equivalents.yaml")
_KEYS = {"file", "in", "was", "now", "why"}


class EquivalentsError(Exception):
    """The list is not as it should be."""


@dataclass(frozen=True)
class Equivalents:
    """Edits by what they change, not by where: they stay known when lines move.

    A file that has moved to another folder keeps its entries: names of files are compared.
    """

    reasons: dict[tuple[str, str, str, str], str]

    @classmethod
    def load(cls, file: Path = FILE) -> Equivalents:
        """From YAML: a list of {file, in, was, now, why}; raises EquivalentsError."""
        entries = yaml.safe_load(file.read_text()) if file.is_file() else None
        reasons = {}
        for number, entry in enumerate(entries or (), 1):
            if not isinstance(entry, dict) or set(entry) != _KEYS or not all(
                isinstance(value, str) for value in entry.values()
            ):
                raise EquivalentsError(
                    f"{file.name}, entry {number}: needs the texts {', '.join(sorted(_KEYS))}"
                )
            was, now = (" ".join(entry[key].split()) for key in ("was", "now"))
            edit = entry["file"], entry["in"], was, now
            if edit in reasons:
                raise EquivalentsError(f"{file.name}, entry {number}: it stands there twice")
            reasons[edit] = entry["why"]
        return cls(reasons)

    def reason(self, fault: Fault) -> str | None:
        """Why the edit is no fault; None where it is one."""
        return self.reasons.get(
            (fault.file.rpartition("/")[2], fault.function, fault.was, fault.now)
        )
