"""SDF text -> models and lights.

Of SDF this takes boxes, cylinders, spheres, capsules, planes and meshes, with colours; links with
fixed, revolute, prismatic, universal and screw joints, in trees, closed chains, or without any;
cameras and other sensors; lights, includes, models in models, and a world's `<state>`. What is not
served is left out with a warning that names it: an element (see served.py), or a whole model of a
world.
"""

import copy
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import (
    model_folders,
    packages,
    plugins,
    population,
    supported_elements,
    world_joints,
)
from aras_sim_bridge.description.lights import read_light
from aras_sim_bridge.description.sdf_dialects import unify
from aras_sim_bridge.description.sdf_frames import Frames
from aras_sim_bridge.description.sdf_model import read_model
from aras_sim_bridge.description.sdf_poses import read_name, read_pose
from aras_sim_bridge.description.types import Light, LinkAttacher, RobotDescription
from aras_sim_bridge.description.world_state import WorldState
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.safe_xml import shorten


@dataclass(frozen=True)
class SdfContent:
    """models: in file order. lights: in file order. warnings: what was passed over, a sentence
    each. time_ns: simulated time of a world's `<state>`. link_attacher: whether its plug-in is in
    the world."""

    models: tuple[RobotDescription, ...] = ()
    lights: tuple[Light, ...] = ()
    warnings: tuple[str, ...] = ()
    time_ns: int = 0
    link_attacher: bool = False


def parse_sdf(xml: str | Element, base_directory: str | None = None) -> RobotDescription:
    """The one model of an SDF text, or of what safe_xml.parse made of it.

    The model's own pose is in `initial_pose`; its root link's pose is worked into that link.

    Args:
        xml: the document.
        base_directory: what relative mesh paths are relative to; None refuses them.

    Raises:
        DescriptionError: naming the element, what is wrong with it and how to fix it.
    """
    content = read_sdf(xml, base_directory=base_directory)
    if len(content.models) != 1 or content.lights:
        left_out = "".join(f"; {warning}" for warning in content.warnings)
        raise DescriptionError(f"SDF: {len(content.models)} models and {len(content.lights)} "
                               f"lights; give one model at a time{left_out}")
    model = content.models[0]
    return replace(model, warnings=(*content.warnings, *model.warnings))


def read_sdf(
    xml: str | Element,
    resolve_package: packages.ResolvePackage = packages.find_package,
    base_directory: str | None = None,
) -> SdfContent:
    """All models and lights of an SDF text, a `<world>` around them or not.

    What a world includes comes from Gazebo's model folders (see model_folders.py), and where its
    `<state>` has models and lights is where they stand.

    Raises:
        DescriptionError: as `parse_sdf`; a model or light of a `<world>` that cannot be read is
            left out instead, with a sentence in `warnings`.
    """
    root = copy.deepcopy(safe_xml.parse(xml, "SDF"))  # it is rewritten below
    if root.tag not in ("sdf", "gazebo"):
        raise DescriptionError(f"SDF: the root element is <{shorten(root.tag)}>, not <sdf>")
    worlds = root.findall("world")
    if len(worlds) > 1:
        raise DescriptionError(f"SDF: {len(worlds)} worlds; one is simulated")
    scope = worlds[0] if worlds else root
    def resolve(uri: str, where: str) -> str:
        return packages.resolve_uri(uri, where, resolve_package, base_directory)

    def locate(uri: str, where: str) -> str:
        return packages.locate(uri, where, resolve_package, base_directory, "material")

    models, lights = [], []
    warnings: list[str] = []
    unify(root, warnings)
    link_attacher = bool(plugins.read(scope, "world", (LinkAttacher,), warnings))
    state = WorldState(scope.find("state"))
    inserted = Element("insertions")
    inserted.extend(state.insertions)
    elements = [*model_folders.expand(scope, warnings, base_directory),
                *model_folders.expand(inserted, warnings, base_directory)]
    elements = [one for element in elements for one in (
        population.place_copies(element, warnings) if element.tag == "population" else (element,))]
    elements = world_joints.bolt_models(elements, warnings)
    around = Element(scope.tag)
    around.extend(elements)
    warnings += supported_elements.describe_ignored_elements(around, "world", "SDF")
    frames = Frames(around)
    warnings += frames.list_errors()
    taken: set[tuple[str, str | None]] = set()
    for element in elements:
        if element.get("name") in state.deleted or element.tag not in ("model", "light"):
            continue
        try:
            if (element.tag, element.get("name")) in taken:
                name = shorten(element.get("name") or "")
                raise DescriptionError(f"two {element.tag}s are named '{name}'; rename one")
            if element.tag == "model":
                models.append(read_model(element, resolve, locate, frames))
            else:
                where = f"light '{read_name(element, 'SDF')}'"
                warnings += supported_elements.describe_ignored_elements(element, "light", where)
                lights.append(read_light(element, read_pose(element, where, frames)))
            taken.add((element.tag, element.get("name")))
        except DescriptionError as error:
            if not worlds:
                raise
            name = shorten(element.get("name") or "")
            warnings.append(f"{element.tag} '{name}' is left out: {error}")
    models, lights = state.place(models, lights, warnings)
    if not models and not lights and not worlds:
        raise DescriptionError("SDF: there is no <model> and no <light> in it")
    return SdfContent(tuple(models), tuple(lights), tuple(warnings), state.time_ns,
                      link_attacher)

