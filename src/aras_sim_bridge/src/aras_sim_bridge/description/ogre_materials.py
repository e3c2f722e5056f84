"""OGRE's material scripts: the colour and the picture that a `<script>` of an SDF visual names.

Of a script the first pass counts: its diffuse and ambient colours and its first texture.
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

Locate = Callable[[str, str], str]  # a URI and who names it -> a path, of what may not be there

_LARGEST_FILE = 1_000_000  # bytes of a script
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_GAZEBO_MEDIA = "file://media/"


@dataclass(frozen=True)
class Appearance:
    """colour: None where the script gives none. texture: path of a picture, '' for none."""

    colour: Rgba | None = None
    texture: str = ""


def read_appearance(
    visual: Element, where: str, locate: Locate, warnings: list[str]
) -> Appearance | None:
    """What a visual's script makes it look like; None without a script, or one of Gazebo's own.

    What cannot be read is a sentence in `warnings`.
    """
    script = visual.find("material/script")
    name = find_text(script, "name")
    uris = [] if script is None else [(uri.text or "").strip() for uri in script.findall("uri")]
    places = []
    for uri in uris:
        if not uri.startswith(_GAZEBO_MEDIA):
            try:
                places.append(Path(locate(uri, where)))
            except DescriptionError as error:
                warnings.append(f"{error}; its material is left out")
    scripts: dict[str, tuple[str, Appearance]] = {}
    for place in places:
        for file in sorted(place.glob("*.material")) if place.is_dir() else [place]:
            scripts |= _read_scripts(file, warnings)
    if name not in scripts:
        return None
    found = _resolve_inheritance(name, scripts)
    if not found.texture:
        return found
    inside = [place if place.is_dir() else place.parent for place in places]
    folders = [folder for place in inside for folder in (place, place.parent / "textures")]
    picture = next((f / found.texture for f in folders if (f / found.texture).is_file()), None)
    try:
        if picture is None:
            raise DescriptionError("there is no such file beside its script")
        if read_image_size(picture) is None:
            raise DescriptionError("it is no picture that can be read")
    except DescriptionError as error:
        warnings.append(f"{where}: texture '{shorten(found.texture)}' of material "
                        f"'{shorten(name)}' is left out: {error}")
        return replace(found, texture="")
    return replace(found, texture=str(picture))


def _resolve_inheritance(name: str, scripts: dict[str, tuple[str, Appearance]]) -> Appearance:
    """A material with what it takes over from those that it stands on."""
    colour, texture, seen = None, "", set()
    while name in scripts and name not in seen:
        seen.add(name)
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
    """Name -> the material that it stands on ('' for none), and its own look."""
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
    """Three numbers or four; None for others, such as vertexcolour."""
    try:
        values = [min(max(float(word), 0.0), 1.0) for word in texts[:4]]
    except ValueError:
        return None
    return tuple([*values, 1.0][:4]) if len(values) >= 3 else None
