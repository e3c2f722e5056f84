"""Reader of OGRE material scripts, which give an SDF visual its colour and texture.

Only the first pass of a script is used: its diffuse and ambient colours and its first texture.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.types import Rgba
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.image_files import read_image_size
from aras_visual_servo_base.safe_xml import find_text, shorten

# Function that finds a file: (URI, name of the SDF element in messages) -> path of the file, which
# may not exist.
Locate = Callable[[str, str], str]

_LARGEST_FILE = 1_000_000  # size of the largest material script that is read, bytes
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_GAZEBO_MEDIA = "file://media/"


@dataclass(frozen=True)
class Appearance:
    """Colour and texture of a visual.

    Attributes:
        colour: colour of the script, or None if it sets no colour.
        texture: path of the image file; '' if there is no texture.
    """

    colour: Rgba | None = None
    texture: str = ""


def read_appearance(
    visual: Element, where: str, locate: Locate, warnings: list[str]
) -> Appearance | None:
    """Read the colour and texture that a visual's material script sets.

    Returns:
        The appearance, or None if the visual has no script or uses a built-in material of Gazebo.
        `warnings` gets a sentence for each part of the script that cannot be read.
    """
    script = visual.find("material/script")
    name = find_text(script, "name")
    uris = [] if script is None else [(uri.text or "").strip() for uri in script.findall("uri")]
    paths = []
    for uri in uris:
        if not uri.startswith(_GAZEBO_MEDIA):
            try:
                paths.append(Path(locate(uri, where)))
            except DescriptionError as error:
                warnings.append(f"{error}; its material is ignored")
    scripts: dict[str, tuple[str, Appearance]] = {}
    for path in paths:
        for file in sorted(path.glob("*.material")) if path.is_dir() else [path]:
            scripts |= _read_scripts(file, warnings)
    if name not in scripts:
        return None
    found = _resolve_inheritance(name, scripts)
    if not found.texture:
        return found
    inside = [path if path.is_dir() else path.parent for path in paths]
    folders = [folder for path in inside for folder in (path, path.parent / "textures")]
    image = next((f / found.texture for f in folders if (f / found.texture).is_file()), None)
    try:
        if image is None:
            raise DescriptionError("the file is not in the folder of the material script")
        if read_image_size(image) is None:
            raise DescriptionError("the file is not a readable image")
    except DescriptionError as error:
        warnings.append(f"{where}: texture '{shorten(found.texture)}' of material "
                        f"'{shorten(name)}' is ignored: {error}")
        return replace(found, texture="")
    return replace(found, texture=str(image))


def _resolve_inheritance(name: str, scripts: dict[str, tuple[str, Appearance]]) -> Appearance:
    """Return the colour and texture of a material.

    A value that the material does not set is that of its nearest parent material that sets it.
    """
    colour, texture, visited = None, "", set()
    while name in scripts and name not in visited:
        visited.add(name)
        name, own = scripts[name]
        colour, texture = colour or own.colour, texture or own.texture
    return Appearance(colour, texture)


def _read_scripts(file: Path, warnings: list[str]) -> dict[str, tuple[str, Appearance]]:
    try:
        state = file.stat()
        if state.st_size > _LARGEST_FILE:
            raise OSError(f"it has more than {_LARGEST_FILE} bytes")
        return _parse(str(file), state.st_mtime_ns)
    except OSError as error:
        warnings.append(f"material script {file} cannot be read: {error}")
        return {}


@lru_cache(maxsize=256)
def _parse(path: str, _changed_ns: int) -> dict[str, tuple[str, Appearance]]:
    """Return (parent material, appearance) of each material by name; the parent may be ''.

    `_changed_ns` is the time at which the file was last changed. It is not used here; as an
    argument of a cached function, it makes a changed file be read again.
    """
    text = _COMMENT.sub("", Path(path).read_text(encoding="utf-8", errors="replace"))
    found: dict[str, tuple[str, Appearance]] = {}
    name, ambient = "", None
    for line in re.sub(r"([{}])", r"\n\1\n", text).splitlines():
        key, *words = line.split() or [""]
        if key == "material" and words:
            name, _, parent = (part.strip() for part in " ".join(words).partition(":"))
            name, parent, ambient = name.strip('"'), parent.strip('"'), None
            found[name] = (parent, Appearance())
        elif name and key in ("ambient", "diffuse", "texture") and words:
            parent, own = found[name]
            if key == "texture":
                own = replace(own, texture=own.texture or words[0].strip('"'))
            elif (colour := _parse_colour(words)) is not None:
                if key == "diffuse" and own.colour in (None, ambient):
                    own = replace(own, colour=colour)
                elif key == "ambient" and own.colour is None:
                    own, ambient = replace(own, colour=colour), colour
            found[name] = (parent, own)
    return found


def _parse_colour(texts: list[str]) -> Rgba | None:
    """Return a colour given as three or four numbers; None for other texts, such as `vertexcolour`.
    """
    try:
        values = [min(max(float(word), 0.0), 1.0) for word in texts[:4]]
    except ValueError:
        return None
    return tuple([*values, 1.0][:4]) if len(values) >= 3 else None
