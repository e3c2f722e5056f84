"""Reader of the materials in a COLLADA file: diffuse colours and texture files.

A wrong or unsupported material must not prevent the use of the file's triangles. Therefore
materials are read here, and not by pycollada, which drops the triangles together with their
material.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ..errors import DescriptionError
from ..safe_xml import find_text, parse_numbers, shorten
from ..urdf import Rgba
from .mesh import GREY, find_texture

_log = logging.getLogger(__name__)


class MeshMaterial(NamedTuple):
    """Diffuse colour and texture file of a material; each is None if the material has none."""

    rgba: Rgba | None = None
    texture: str | None = None


def read_materials(root: Element, folder: Path) -> dict[str, MeshMaterial]:
    """Return the materials that the scene of a file uses, by their ids.

    A material that cannot be read is drawn grey, and the reason is logged.

    Args:
        root: root element of the file.
        folder: folder to which the paths of texture files are relative.
    """
    effects = {effect.get("id"): effect for effect in root.iterfind("library_effects/effect")}
    images = {image.get("id"): image for image in root.iterfind("library_images/image")}
    used = {binding.get("target") for binding in root.iter("instance_material")}
    materials = {}
    for material in root.iterfind("library_materials/material"):
        name = material.get("id") or ""
        if f"#{name}" not in used:
            continue
        instance = material.find("instance_effect")
        url = "" if instance is None else instance.get("url") or ""
        effect = effects.get(url.removeprefix("#"))
        try:
            if effect is None:
                raise DescriptionError(f"there is no effect '{shorten(url)}'")
            materials[name] = _read_effect(effect, images, folder, f"material '{shorten(name)}'")
        except DescriptionError as error:
            _log.warning("material '%s' is drawn grey: %s", shorten(name), error.fault)
            materials[name] = MeshMaterial(GREY)
    return materials


def _read_effect(
    effect: Element, images: dict[str | None, Element], folder: Path, where: str
) -> MeshMaterial:
    diffuse = effect.find("profile_COMMON/technique/*/diffuse")
    if diffuse is None:
        return MeshMaterial()
    colour, texture = find_text(diffuse, "color"), diffuse.find("texture")
    if colour is not None:
        count = 3 if len(colour.split()) == 3 else 4  # the opacity is ignored
        return MeshMaterial((*parse_numbers(colour, count, "<diffuse>: color")[:3], 1.0))
    if texture is None:
        raise DescriptionError("<diffuse> has neither <color> nor <texture>")
    path = _find_image(texture.get("texture") or "", effect, images)
    file = find_texture(folder, path, where)
    return MeshMaterial(None if file else GREY, file)


def _find_image(reference: str, effect: Element, images: dict[str | None, Element]) -> str:
    """Return the path of the image of a texture.

    A texture refers to a sampler, the sampler to a surface, and the surface to an image. Files of
    some programs leave out the sampler or the surface; in COLLADA 1.5 there is no surface.
    """
    parameters = {one.get("sid"): one for one in effect.iter("newparam")}
    for links in ("sampler2D/source", "surface/init_from"):
        parameter = parameters.get(reference)
        if parameter is None:
            break
        instance = parameter.find("sampler2D/instance_image")
        if instance is not None:
            reference = (instance.get("url") or "").removeprefix("#")
            break
        reference = find_text(parameter, links) or ""
    image = images.get(reference)
    if image is None:
        raise DescriptionError(f"there is no image '{shorten(reference)}'")
    path = find_text(image, "init_from/ref") or find_text(image, "init_from")
    if not path:
        raise DescriptionError(f"image '{shorten(reference)}' has no file")
    return path
