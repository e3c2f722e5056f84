"""Reader of SDF text: models and lights.

Supported are boxes, cylinders, spheres, capsules, planes and meshes, with colours; links with
fixed, revolute, prismatic, universal and screw joints in trees and closed chains; free links;
cameras and other sensors; lights, includes, nested models, and a world's `<state>`.

An unsupported element (see supported_elements.py) is ignored, and a warning names it. If a model in
a world cannot be simulated without this element, the whole model is ignored.
"""

import copy
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import (
    packages,
    plugins,
    population,
    sdf_includes,
    supported_elements,
    world_joints,
)
from aras_sim_bridge.description.lights import read_light
from aras_sim_bridge.description.sdf_dialects import unify
from aras_sim_bridge.description.sdf_frames import SdfFrames
from aras_sim_bridge.description.sdf_model import read_model
from aras_sim_bridge.description.sdf_poses import read_name, read_pose
from aras_sim_bridge.description.types import Light, LinkAttacherPlugin, RobotDescription
from aras_sim_bridge.description.world_state import WorldState
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.safe_xml import shorten


@dataclass(frozen=True)
class SdfContent:
    """Content of an SDF document.

    Attributes:
        models, lights: models and lights in the order of the file.
        warnings: one sentence for each part that was ignored.
        time_ns: simulated time of the world's `<state>`.
        link_attacher: whether the world has the plug-in gazebo_ros_link_attacher.
    """

    models: tuple[RobotDescription, ...] = ()
    lights: tuple[Light, ...] = ()
    warnings: tuple[str, ...] = ()
    time_ns: int = 0
    link_attacher: bool = False


def parse_sdf(xml: str | Element, base_directory: str | None = None) -> RobotDescription:
    """Read an SDF document that contains exactly one model.

    The model's pose is stored in `initial_pose`. The frame of the root link becomes the model's
    frame.

    Args:
        xml: the document, or the element that `safe_xml.parse` returned for it.
        base_directory: folder to which relative mesh paths are relative; None rejects them.

    Raises:
        DescriptionError: an element is invalid; the message names the element, the problem and how
            to fix it.
    """
    content = read_sdf(xml, base_directory=base_directory)
    if len(content.models) != 1 or content.lights:
        left_out = "".join(f"; {warning}" for warning in content.warnings)
        raise DescriptionError(
            f"SDF: the text has {len(content.models)} models and {len(content.lights)} lights; it "
            f"must contain exactly one model{left_out}"
        )
    model = content.models[0]
    return replace(model, warnings=(*content.warnings, *model.warnings))


def read_sdf(
    xml: str | Element,
    resolve_package: packages.ResolvePackage = packages.find_package,
    base_directory: str | None = None,
) -> SdfContent:
    """Read all models and lights of an SDF text, which may be inside a `<world>`.

    Included models are searched for in Gazebo's model folders (see sdf_includes.py). A world's
    `<state>` overrides the poses of its models and lights.

    Raises:
        DescriptionError: an element is invalid. In a `<world>`, an invalid model or light is
            ignored instead, and `warnings` gets a sentence.
    """
    # a copy, because the code below modifies the XML tree
    root = copy.deepcopy(safe_xml.parse(xml, "SDF"))
    if root.tag not in ("sdf", "gazebo"):
        raise DescriptionError(f"SDF: the root element is <{shorten(root.tag)}>, not <sdf>; give "
                               "an SDF document")
    worlds = root.findall("world")
    if len(worlds) > 1:
        raise DescriptionError(f"SDF: the text has {len(worlds)} worlds, must have one: remove the "
                               "others")
    scope = worlds[0] if worlds else root
    def resolve(uri: str, where: str) -> str:
        return packages.resolve_uri(uri, where, resolve_package, base_directory)

    def locate(uri: str, where: str) -> str:
        return packages.locate(uri, where, resolve_package, base_directory, "material")

    models, lights = [], []
    warnings: list[str] = []
    unify(root, warnings)
    link_attacher = bool(plugins.read(scope, "world", (LinkAttacherPlugin,), warnings))
    state = WorldState(scope.find("state"))
    inserted = Element("insertions")
    inserted.extend(state.insertions)
    elements = [*sdf_includes.expand(scope, warnings, base_directory),
                *sdf_includes.expand(inserted, warnings, base_directory)]
    elements = [one for element in elements for one in (
        population.place_copies(element, warnings) if element.tag == "population" else (element,))]
    elements = world_joints.bolt_models(elements, warnings)
    expanded = Element(scope.tag)
    expanded.extend(elements)
    warnings += supported_elements.describe_ignored_elements(expanded, "world", "SDF")
    frames = SdfFrames(expanded)
    warnings += frames.list_errors()
    used_names: set[tuple[str, str | None]] = set()
    for element in elements:
        if element.get("name") in state.deleted or element.tag not in ("model", "light"):
            continue
        try:
            if (element.tag, element.get("name")) in used_names:
                name = shorten(element.get("name") or "")
                raise DescriptionError(f"two {element.tag}s are named '{name}'; rename one")
            if element.tag == "model":
                models.append(read_model(element, resolve, locate, frames))
            else:
                where = f"light '{read_name(element, 'SDF')}'"
                warnings += supported_elements.describe_ignored_elements(element, "light", where)
                lights.append(read_light(element, read_pose(element, where, frames)))
            used_names.add((element.tag, element.get("name")))
        except DescriptionError as error:
            if not worlds:
                # the error may be due to an included model that was not found
                missing = [text for text in warnings if text.startswith("<include>")]
                raise DescriptionError("; ".join([str(error), *missing])) from None
            name = shorten(element.get("name") or "")
            warnings.append(f"{element.tag} '{name}' is ignored: {error}")
    models, lights = state.place(models, lights, warnings)
    if not models and not lights and not worlds:
        raise DescriptionError("SDF: the text contains no <model> and no <light>; add one")
    return SdfContent(tuple(models), tuple(lights), tuple(warnings), state.time_ns,
                      link_attacher)

