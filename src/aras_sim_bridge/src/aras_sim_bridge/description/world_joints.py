"""Conversion of a world's fixed `<joint>`s, which fix models to the world or to static models."""

import copy
from collections.abc import Iterable
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.safe_xml import find_text, parse_bool, shorten

WORLD = "world"


def bolt_models(elements: Iterable[Element], warnings: list[str]) -> list[Element]:
    """Return the elements of a world without the joints between its models.

    If such a joint fixes a model to the world or to a static model, the model is replaced by a copy
    with a fixed joint to the world. `warnings` gets a sentence for each unsupported joint.
    """
    elements = list(elements)
    models = {one.get("name"): one for one in elements if one.tag == "model"}
    for joint in elements:
        if joint.tag == "joint":
            try:
                _bolt(joint, models)
            except DescriptionError as error:
                name = shorten(joint.get("name") or "")
                warnings.append(f"SDF: <joint> '{name}' of the world is ignored: {error}")
    return [models[one.get("name")] if one.tag == "model" else one
            for one in elements if one.tag != "joint"]


def _bolt(joint: Element, models: dict[str | None, Element]) -> None:
    if joint.get("type") != "fixed":
        raise DescriptionError("only a fixed joint can connect two models; set type to fixed")
    ends = [_find_link(find_text(joint, tag) or "", models) for tag in ("child", "parent")]
    loose = [(name, link) for name, link in ends if not _is_fixed(models.get(name), link)]
    if len(loose) == 2:
        raise DescriptionError("neither of its models is fixed in the world; join their links "
                               "inside one model")
    for name, link in loose:
        joints = models[name].findall("joint")
        if joint.get("name") in (None, "", *(one.get("name") for one in joints)):
            raise DescriptionError("its name is missing or is that of another joint of the model; "
                                   "give a new name")
        if any(find_text(one, "child") == link for one in joints):
            raise DescriptionError(f"link '{shorten(link)}' is the child of another joint; use the "
                                   f"root link of '{shorten(name)}'")
        # copied, so that the caller's element is not changed
        models[name] = copy.copy(models[name])
        bolt = ElementTree.SubElement(models[name], "joint", joint.attrib)
        for tag, text in (("parent", WORLD), ("child", link)):
            ElementTree.SubElement(bolt, tag).text = text


def _find_link(text: str, models: dict[str | None, Element]) -> tuple[str, str]:
    """Return the names of a model and a link; `text` is 'model::link' or 'model'.

    If `text` names only a model, return the model's first link.
    """
    name, _, link = text.partition("::")
    if name == WORLD:
        return name, ""
    links = [one.get("name") for one in models[name].findall("link")] if name in models else []
    link = link or next(iter(links), "")
    if link not in links:
        raise DescriptionError(f"there is no link '{shorten(text)}'")
    return name, link


def _is_fixed(model: Element | None, link: str) -> bool:
    """Return whether a link never moves; None for the model means the world."""
    return model is None or parse_bool(find_text(model, "static"), "static", False) or any(
        find_text(one, "parent") == WORLD and find_text(one, "child") == link
        for one in model.findall("joint[@type='fixed']"))
