"""Reader of untrusted XML. It rejects document types and entities, and limits size and depth."""

import math
import re
from collections import Counter
from contextlib import suppress
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.poses import Pose, Vector3

# Largest number of characters of an XML text. The largest common robot descriptions have about a
# million.
LARGEST_TEXT = 16 * 1024 * 1024
LARGEST_DEPTH = 64
LARGEST_COUNT = 400_000
BOOLEANS = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}

_ATTRIBUTE = re.compile(r"""(\s[\w:.-]+\s*=\s*)("[^"]*"|'[^']*'|[^\s"'<>/]+)""")
_TAG = re.compile(rf"<[A-Za-z_][\w:.-]*(?:{_ATTRIBUTE.pattern})+\s*/?>")


def parse(
    xml: str | Element, what: str, largest: int = LARGEST_TEXT, doctype: bool = False
) -> Element:
    """Return the root element of an XML document.

    Args:
        xml: text of the document. An element is returned unchanged.
        what: kind of the document for messages, such as 'URDF' or 'SDF'.
        largest: largest number of characters.
        doctype: whether a document type is allowed, as in SVG files; entities are always rejected.

    Raises:
        DescriptionError: the document is not well formed, is too large or too deep, or declares a
            document type or an entity. Entities could expand without limit or read other files.
    """
    if isinstance(xml, Element):
        return xml
    if not isinstance(xml, str):
        raise DescriptionError(f"{what}: expected text, got {type(xml).__name__}")
    if len(xml) > largest:
        raise DescriptionError(
            f"{what}: it has {len(xml)} characters, more than the limit of {largest}; "
            "keep meshes in separate files"
        )
    if not xml.strip():
        raise DescriptionError(f"{what}: the description is empty")
    text = _remove_comments(xml).lstrip("\ufeff \t\r\n")
    # number of lines of the document before `text`, which contain only comments or blanks
    first_line = xml.count("\n") - text.count("\n")
    builder = TreeBuilder()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    depth = count = 0

    def find_line() -> int:
        return first_line + parser.CurrentLineNumber

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth += 1
        count += 1
        if depth > LARGEST_DEPTH or count > LARGEST_COUNT:
            raise DescriptionError(
                f"{what}: line {find_line()}: more than {LARGEST_DEPTH} elements are nested, or "
                f"the file has more than {LARGEST_COUNT} elements; simplify it"
            )
        if tag.startswith("xacro:"):
            raise DescriptionError(
                f"{what}: line {find_line()}: <{tag}> is not expanded; "
                "run xacro on the file first"
            )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: object) -> None:
        raise DescriptionError(
            f"{what}: line {find_line()}: document type and entity declarations are "
            "refused; remove <!DOCTYPE …>"
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    if not doctype:
        parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text.rstrip(), True)
    except expat.ExpatError as error:
        repaired = _repair_attributes(text)
        if repaired != text:
            with suppress(DescriptionError):
                lines = "\n" * first_line + repaired
                return parse(lines, what, len(lines), doctype)
        raise DescriptionError(
            f"{what}: line {first_line + error.lineno}, column {error.offset}: "
            f"{expat.errors.messages[error.code]}"
        ) from None
    except (UnicodeEncodeError, ValueError) as error:
        raise DescriptionError(f"{what} is not valid text: {error}") from None
    return builder.close()


def _repair_attributes(xml: str) -> str:
    """Return the text with quoted attribute values and without '<' in them.

    Gazebo's parser accepts values without quotes, and values that contain '<'.
    """
    def repair(attribute: re.Match[str]) -> str:
        value = attribute[2]
        if value[0] not in "\"'":
            value = f'"{value}"'
        return attribute[1] + value.replace("<", "&lt;")

    return _TAG.sub(lambda tag: _ATTRIBUTE.sub(repair, tag[0]), xml)


def _remove_comments(xml: str) -> str:
    """Return the text without comments. Their line ends remain, so that line numbers are correct.

    This allows comments that Gazebo's parser accepts although XML forbids them: those before the
    XML declaration, and those that contain "--".
    """
    parts, at = [], 0
    while (begin := xml.find("<!--", at)) >= 0 and (end := xml.find("-->", begin + 4)) >= 0:
        parts += [xml[at:begin], "\n" * xml.count("\n", begin, end)]
        at = end + 3
    return "".join((*parts, xml[at:]))


def check_names(names: list[str], what: str) -> None:
    """Check that names are unique. `what` is their kind, such as 'cameras'.

    Raises:
        DescriptionError: two names are equal.
    """
    for name, count in Counter(names).items():
        if count > 1:
            raise DescriptionError(f"two {what} are named '{shorten(name)}'; rename one")


def shorten(text: str, length: int = 60) -> str:
    """Return a text on one line, shortened to at most `length` characters, for a message."""
    text = " ".join(text.split())
    return text if len(text) <= length else text[: length - 1] + "…"


def parse_number(text: str | None, where: str, default: float | None = None) -> float:
    """Parse a finite number.

    Args:
        text: text of an attribute or element; None if this is missing.
        where: name of the value, for messages.
        default: value that is returned if the text is missing; None if the value is required.

    Raises:
        DescriptionError: a required value is missing, or the text is not a finite number.
    """
    if text is None:
        if default is None:
            raise DescriptionError(f"{where} is missing")
        return default
    try:
        value = float(text)
    except ValueError:
        raise DescriptionError(f"{where}: '{shorten(text)}' is not a number") from None
    if not math.isfinite(value):
        raise DescriptionError(f"{where}: {shorten(text)} is not finite")
    return value


def parse_numbers(
    text: str | None, count: int, where: str, default: tuple[float, ...] | None = None
) -> tuple[float, ...]:
    """Parse `count` finite numbers that are separated by blanks.

    The other arguments and the errors are those of `parse_number`.
    """
    if text is None:
        if default is None:
            raise DescriptionError(f"{where} is missing")
        return default
    parts = text.split()
    if len(parts) != count:
        raise DescriptionError(f"{where}: needs {count} numbers, got '{shorten(text)}'")
    return tuple(parse_number(part, where) for part in parts)


def parse_pose(text: str | None, where: str) -> Pose:
    """Parse a pose of SDF: position (m) and fixed-axis roll, pitch, yaw (rad).

    If the text is missing or empty, the pose is the identity. The errors are those of
    `parse_number`.
    """
    if not text:
        return Pose()
    x, y, z, roll, pitch, yaw = parse_numbers(text, 6, where)
    return Pose.from_rpy((x, y, z), (roll, pitch, yaw))


def parse_direction(text: str | None, where: str, default: Vector3) -> Vector3:
    """Parse three numbers and scale them to length 1; return `default` if the text is missing.

    Raises:
        DescriptionError: a number is invalid, or the vector is zero.
    """
    if text is None:
        return default
    vector = parse_numbers(text, 3, where)
    length = math.sqrt(sum(v * v for v in vector))
    if length < 1e-9:
        raise DescriptionError(f"{where} is the zero vector; give a direction")
    return tuple(v / length for v in vector)


def parse_integer(text: str | None, where: str, default: int | None = None) -> int:
    """Parse a whole number. The arguments and the errors are those of `parse_number`."""
    value = parse_number(text, where, default)
    if value != int(value):
        raise DescriptionError(f"{where}: {value} is not a whole number")
    return int(value)


def parse_bool(text: str | None, where: str, default: bool) -> bool:
    """Return True for 'true', '1', 'yes' and False for 'false', '0', 'no'.

    If the text is missing, return `default`.

    Raises:
        DescriptionError: the text is none of these words.
    """
    if text is None:
        return default
    value = BOOLEANS.get(text.strip().lower())
    if value is None:
        raise DescriptionError(f"{where}: '{shorten(text)}' is neither true nor false")
    return value


def find_text(element: Element | None, tag: str) -> str | None:
    """Return the stripped text of the child `tag`; None if there is no such child."""
    text = None if element is None else element.findtext(tag)
    return None if text is None else text.strip()


class ElementReader:
    """Reads the children of an XML element.

    A method returns the default if the child is missing. It raises what parse_number,
    parse_numbers, parse_integer and parse_bool raise.

    Attributes:
        element: the element; None if it is missing itself, so that all its children are missing.
        prefix: text before the tag of a child in error messages, such as "joint 'a': ".
    """

    def __init__(self, element: Element | None, prefix: str) -> None:
        self.element, self.prefix = element, prefix

    def get_child(self, tag: str) -> "ElementReader":
        """Return the reader of a child element, whose tag is added to the prefix."""
        child = None if self.element is None else self.element.find(tag)
        return ElementReader(child, f"{self.prefix}{tag} ")

    def read_text(self, tag: str) -> str | None:
        """Return the stripped text of a child; None if the child is missing."""
        return find_text(self.element, tag)

    def read_number(self, tag: str, default: float | None = None) -> float:
        """Return a finite number."""
        return parse_number(self.read_text(tag), self.prefix + tag, default)

    def read_numbers(
        self, tag: str, count: int, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        """Return `count` finite numbers."""
        return parse_numbers(self.read_text(tag), count, self.prefix + tag, default)

    def read_integer(self, tag: str, default: int) -> int:
        """Return a whole number."""
        return parse_integer(self.read_text(tag), self.prefix + tag, default)

    def read_bool(self, tag: str, default: bool) -> bool:
        """Return a truth value."""
        return parse_bool(self.read_text(tag), self.prefix + tag, default)
