"""Reader of the values that the children of an XML element contain."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from aras_visual_servo_base import safe_xml


class ElementReader:
    """Reads the children of an XML element.

    A method returns the default if the child is missing. The functions of the same names in
    safe_xml.py describe the errors.

    Attributes:
        element: the element; None if it is missing itself, so that all its children are missing.
        prefix: text before the tag of a child in error messages, such as "joint 'a': ".
    """

    def __init__(self, element: Element | None, prefix: str) -> None:
        self.element, self.prefix = element, prefix

    def get_child(self, tag: str) -> ElementReader:
        """Return the reader of a child element, whose tag is added to the prefix."""
        child = None if self.element is None else self.element.find(tag)
        return ElementReader(child, f"{self.prefix}{tag} ")

    def read_text(self, tag: str) -> str | None:
        """Return the stripped text of a child; None if the child is missing."""
        return safe_xml.find_text(self.element, tag)

    def read_number(self, tag: str, default: float | None = None) -> float:
        """Return a finite number."""
        return safe_xml.parse_number(self.read_text(tag), self.prefix + tag, default)

    def read_numbers(
        self, tag: str, count: int, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        """Return `count` finite numbers."""
        return safe_xml.parse_numbers(self.read_text(tag), count, self.prefix + tag, default)

    def read_integer(self, tag: str, default: int) -> int:
        """Return a whole number."""
        return safe_xml.parse_integer(self.read_text(tag), self.prefix + tag, default)

    def read_bool(self, tag: str, default: bool) -> bool:
        """Return a truth value."""
        return safe_xml.parse_bool(self.read_text(tag), self.prefix + tag, default)
