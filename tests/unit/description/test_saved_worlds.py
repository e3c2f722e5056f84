"""Worlds saved by Gazebo: included models, `<state>`, frames, and unsupported elements."""

import os
import struct
import zlib

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_sim_bridge.description import parse_sdf, world_file
from aras_sim_bridge.description.packages import find_model
from aras_sim_bridge.description.sdf_includes import find_folder
from aras_sim_bridge.description.shape_meshes import make_meshes
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.simulation import Simulation, SimulationConfig

CONFIG = "<model><name>{0}</name><sdf version='1.4'>old.sdf</sdf>" \
         "<sdf version='1.6'>model.sdf</sdf></model>"
SOLID = ("<link name='body'><pose>0 0 0.1 0 0 0</pose>{0}<collision name='c'><geometry><box><size>"
         "0.2 0.3 0.4</size></box></geometry></collision></link>")
TRIANGLE = """v 0 0 0
v 0.1 0 0
v 0 0.2 0
v 0 0 0.3
f 1 3 2
f 1 2 4
f 2 3 4
f 3 1 4
"""
@pytest.fixture
def folders(tmp_path, monkeypatch):
    """GAZEBO_MODEL_PATH with a folder that models are put into; ~ is another one."""
    models, home = tmp_path / "models", tmp_path / "home"
    monkeypatch.setenv("GAZEBO_MODEL_PATH", f"/nowhere:{models}")
    monkeypatch.setenv("HOME", str(home))

    def add(name, inside, root=models, config=CONFIG):
        folder = root / name
        (folder / "meshes").mkdir(parents=True)
        if config:
            (folder / "model.config").write_text(config.format(name))
        (folder / "model.sdf").write_text(f"<sdf version='1.6'>{inside}</sdf>")
        (folder / "meshes" / "part.obj").write_text(TRIANGLE)
        return folder

    add.home = home / ".gazebo" / "models"
    return add


def include(name, inside=""):
    return f"<include><uri>model://{name}</uri>{inside}</include>"


@pytest.mark.parametrize("uri", ["model://crate/meshes/part.obj", "meshes/part.obj"])
def test_models_and_their_meshes_come_from_the_model_folders(folders, read, uri):
    mesh = f"<visual name='v'><geometry><mesh><uri>{uri}</uri></mesh></geometry></visual>"
    for name, root in (("crate", {}), ("barrel", {"root": folders.home})):
        folders(name, f"<model name='{name}'><pose>0 0 5 0 0 0</pose>{SOLID.format(mesh)}</model>"
                .replace("model://crate", f"model://{name}"), **root)
    found = read(include("crate") + include(
        "barrel", "<name>second</name><pose>1 2 3 0 0 0.5</pose><static>true</static>"))
    assert found.warnings == ()
    crate, second = found.models
    assert (crate.name, crate.static, crate.initial_pose[0]) == ("crate", False, (0, 0, 5))
    assert (second.name, second.static, second.initial_pose[0]) == ("second", True, (1, 2, 3))
    for model in found.models:
        (visual,) = model.links["body"].visuals
        assert np.ptp(make_meshes(visual.geometry)[0].positions, axis=0) == pytest.approx(
            (0.1, 0.2, 0.3))


@pytest.mark.parametrize(("uri", "reason"), [
    ("model://gone", "the folder 'gone' is not in GAZEBO_MODEL_PATH, ~/.gazebo/models, or "),
    ("model://bare", "bare/model.config cannot be read"),
    ("model://empty", "model.sdf has no <model> and no <light>"),
    ("model://nameless", "model.config names no <sdf> file"),
    ("model://../models/egg", "the folder '../models/egg' is not in"),
    ("https://fuel.example/egg", "the scheme https:// is not supported"), ("", "it has no <uri>"),
    ("eggs", "there is no folder")])
def test_an_include_that_cannot_be_served_is_one_warning_and_the_rest_goes_on(
        folders, read, uri, reason):
    folders("bare", "", config=None)
    folders("empty", "")
    folders("nameless", "", config="<model/>")
    folders("egg", "<model name='egg'>" + SOLID.format("") + "</model>")
    found = read(f"<include><uri>{uri}</uri></include>" + include("egg"))
    assert [model.name for model in found.models] == ["egg"]
    (warning,) = found.warnings
    assert f"<include> of '{uri}' is ignored: " in warning and reason in warning


def test_a_cyclic_include_is_one_warning(folders, read):
    for name, other in (("hen", "egg"), ("egg", "hen")):
        folders(name, f"<model name='{name}'>{SOLID.format('')}{include(other)}"
                f"<joint name='j' type='fixed'><parent>body</parent><child>{other}::body</child>"
                "</joint></model>".replace("<joint", "<joint" if name == "hen" else "<battery")
                .replace("</joint", "</joint" if name == "hen" else "</battery"))
    found = read(include("hen"))
    assert list(found.models[0].links) == ["body", "egg::body"]
    assert ("<include> of 'model://hen' is ignored: it includes itself: hen → egg → hen; remove "
            "one of these includes") in found.warnings


def test_the_state_s_insertions_deletions_scale_and_lights_count(folders, read):
    folders("crate", "<model name='crate'>" + SOLID.format("") + "</model>")
    found = read(
        include("crate") + include("crate", "<name>gone</name>")
        + "<light name='lamp' type='point'><pose>0 0 1 0 0 0</pose></light>"
        "<state world_name='default'><insertions>" + include("crate", "<name>late</name>")
        + "</insertions><deletions><name>gone</name></deletions>"
        "<model name='crate'><pose>1 2 3 0 0 0.5</pose><scale>2 3 0.5</scale></model>"
        "<model name='late'><pose>4 5 6 0 0 0</pose></model>"
        "<light name='lamp'><pose>7 8 9 0 0 0</pose></light></state>")
    crate, late = found.models
    assert (crate.initial_pose[0], late.initial_pose[0]) == ((1, 2, 3), (4, 5, 6))
    assert crate.links["body"].collisions[0].geometry.size == pytest.approx((0.4, 0.9, 0.2))
    assert late.links["body"].collisions[0].geometry.size == (0.2, 0.3, 0.4)
    assert found.lights[0].origin_xyz == (7, 8, 9)
    assert found.warnings == ()


def test_what_a_state_says_in_vain_is_named(folders, read):
    folders("crate", "<model name='crate'>" + SOLID.format("") + "</model>")
    found = read(
        include("crate") + "<state><model name='crate'><scale>0 1 1</scale><link name='body'>"
        "<velocity>0 0 2 0 0 0</velocity></link><link name='lid'/></model>"
        "<model name='b'/><model name='a'/><light name='l'/></state>")
    assert [warning for warning in found.warnings if "<state>" in warning] == [
        "<state> has poses for models that do not exist (a, b); these poses are ignored",
        "<state> has poses for lights that do not exist (l); these poses are ignored",
        "<state> has poses for links of model 'crate' that do not exist (lid); these poses are "
        "ignored",
        "<state>: scale (0.0, 1.0, 1.0) of model 'crate' is ignored, because it is not positive",
        "<state> has velocities for crate, which are ignored; all models start at rest"]


def population(inside, name="p", pose="1 2 3 0 0 1.5707963267948966"):
    return (f"<population name='{name}'><model name='m'><pose>9 9 9 1 1 1</pose>"
            f"{SOLID.format('')}</model><pose>{pose}</pose>{inside}</population>")


def places(found):
    return np.array([model.initial_pose[0] for model in found.models])


@pytest.mark.parametrize("region", ["<box><size>2 1 0.8</size></box>",
                                    "<cylinder><radius>0.7</radius><length>0.8</length></cylinder>"])
def test_a_population_by_chance_fills_its_region_the_same_way_each_time(read, region):
    inside = (f"<model_count>200</model_count>{region}<distribution><type>random</type>"
              "</distribution>")
    one, again, other = (places(read(population(inside, name, "1 2 3 0 0 0")))
                         for name in ("p", "p", "q"))
    assert np.array_equal(one, again) and not np.array_equal(one, other)
    off = one - (1, 2, 3)
    if "box" in region:
        assert (abs(off) <= (1.0, 0.5, 0.4)).all() and (np.ptp(off, axis=0) > (1.8, 0.9, 0.7)).all()
    else:
        out = np.hypot(off[:, 0], off[:, 1])
        assert 0.6 < out.max() <= 0.7 and 0.3 < out.mean() < 0.4
        assert 0.0 <= off[:, 2].min() < 0.05 and 0.75 < off[:, 2].max() <= 0.8


@pytest.mark.parametrize(("inside", "reason"), [
    ("<model_count>0</model_count>", "model_count is 0, must be 1 to 1000"),
    ("<model_count>1001</model_count><box><size>2 1 1</size></box><distribution><type>random"
     "</type></distribution>", "1001, must be 1 to 1000"),
    ("<distribution><type>grid</type><rows>40</rows><cols>26</cols></distribution>", "cols is 26"),
    ("<box><size>1 1 0</size></box>", "must be positive"),
    ("<cylinder><radius>0</radius><length>1</length></cylinder>", "length must be positive"),
    ("<cylinder><radius>1</radius><length>0</length></cylinder>", "length must be positive"),
    ("<box><size>1 1 1</size></box><distribution><type>uniform</type></distribution>",
     "distribution 'uniform' is not supported in this region"),
    ("", "distribution 'random' is not supported in this region")])
def test_a_population_that_cannot_be_served_is_one_warning(read, inside, reason):
    found = read(population(inside) + "<model name='n'>" + SOLID.format("") + "</model>")
    assert [m.name for m in found.models] == ["n"]
    (warning,) = found.warnings
    assert reason in warning and "<population> 'p'" in warning and "ignored" in warning


SCRIPT = """// a comment { with braces
material Crate/Base { technique { pass {
    ambient 0.1 0.2 0.3
    diffuse 0.5 0.6 0.7 1
    texture_unit { texture side.png
      filtering trilinear } } }
  technique { pass { diffuse 1 0 0 } } }
material Crate/Side : Crate/Base
{ technique { pass { diffuse 0.9 0.8 0.7 0.5 } } }
material Crate/Plain { technique { pass { ambient 0.2 0.3 0.4 1 /* diffuse 1 1 1 */ } } }
material Crate/Lost { technique { pass { texture_unit { texture gone.png } } } }
"""


def crate(name, shape="<box><size>0.2 0.3 0.4</size></box>",
          uris="<uri>model://crate/materials/scripts</uri>"):
    return (f"<model name='crate'><link name='body'><visual name='v'><geometry>{shape}</geometry>"
            f"<material><script>{uris}<name>{name}</name></script></material></visual></link>"
            "</model>")


@pytest.fixture
def materials(folders):
    folder = folders("crate", "")
    for part in ("scripts", "textures"):
        (folder / "materials" / part).mkdir(parents=True)
    script = b"// of a cr\xe8merie\n" + SCRIPT.encode()  # not every editor writes UTF-8
    (folder / "materials/scripts/crate.material").write_bytes(script)
    picture = folder / "materials/textures/side.png"
    cv2.imwrite(str(picture), np.zeros((2, 3, 3), np.uint8))
    return picture


@pytest.mark.parametrize(("inside", "reason"), [
    (crate("Crate/Lost"), "texture 'gone.png' of material 'Crate/Lost' is ignored"),
    (crate("Crate/None"), "Gazebo has no material 'Crate/None'"),
    (crate("Crate/Base", uris="<uri>model://gone/x</uri>"), "'model://gone/x': package 'gone'"),
    (crate("Crate/Base", uris="<uri>model://crate/x.material</uri>"), "x.material cannot be read"),
    (crate("Crate/Base", "<sphere><radius>1</radius></sphere>"), "drawn on box, plane, mesh"),
    (crate("Crate/Side"), "'Crate/Side' is ignored: the file is not a readable image")])
def test_a_material_that_cannot_be_served_costs_nothing_but_itself(materials, read, inside, reason):
    if "Side" in inside:
        materials.write_text("no image")
    found = read(inside)
    assert [m.name for m in found.models] == ["crate"]
    assert reason in found.warnings[0]
    # Without a folder of the world, relative scripts are left out, and Gazebo's own are found.
    made = parse_sdf("<sdf>" + crate("Gazebo/Red", uris="<uri>looks</uri>") + "</sdf>")
    assert made.colours == {"body": (1.0, 0.0, 0.0, 1.0)} and len(made.warnings) == 1
    assert "link 'body': material 'looks' is a relative path" in made.warnings[0]


@pytest.mark.parametrize(("text", "colour", "texture"), [
    ("material M { technique { pass { diffuse 0.1 0.2 0.3 0.4 0.5 } } }", (0.1, 0.2, 0.3, 0.4), ""),
    ("material M { technique { pass { diffuse -1 2 0.5 7 } } }", (0.0, 1.0, 0.5, 1.0), ""),
    ("material M { diffuse vertexcolour\n ambient 0.2 0.4 0.6 }", (0.2, 0.4, 0.6, 1.0), ""),
    ("material M { diffuse 0.5 0.6\n ambient }", None, ""),
    # The diffuse colour of the first pass that has one counts, wherever its ambient one stands.
    ("material M { pass { diffuse 0 0 1\n ambient 0 1 0 } pass { diffuse 1 0 0 } }",
     (0.0, 0.0, 1.0, 1.0), ""),
    ("material M { pass { ambient 0 1 0\n diffuse 0 0 1 } pass { ambient 1 0 0 } }",
     (0.0, 0.0, 1.0, 1.0), ""),
    ("material M { specular 1 0 0 1\n emissive 0 1 0 }", None, ""),
    ("material M { texture_unit { texture side.png } texture_unit { texture gone.png } }", None,
     "side.png"),
    ('material "M" : "Old" { }\nmaterial "Old" { texture "side.png"\n diffuse 1 1 0 }',
     (1.0, 1.0, 0.0, 1.0), "side.png"),
    ("material M : Old { diffuse 0 1 1 } material Old : Older { ambient 1 1 1 }"
     " material Older { texture side.png }", (0.0, 1.0, 1.0, 1.0), "side.png"),
    ("material M : N { ambient 1 0 1 } material N : M { texture side.png }",
     (1.0, 0.0, 1.0, 1.0), "side.png"),
    ("material M : Nowhere { ambient 1 0 1 }", (1.0, 0.0, 1.0, 1.0), ""),
    # What stands before all materials is none of theirs: shaders have words of the same names.
    ("fragment_program f { ambient 1 0 0\n texture gone.png } material\n"
     "material M { ambient 0 1 0 }", (0.0, 1.0, 0.0, 1.0), ""),
    ("material M{ambient 0 1 0}material N{ambient 1 0 0}", (0.0, 1.0, 0.0, 1.0), ""),
    ("material M { // diffuse 1 0 0\n /* ambient 1 0 0\n */ ambient 0 1 0 }",
     (0.0, 1.0, 0.0, 1.0), ""),
])
def test_what_counts_of_a_material_script(materials, read, text, colour, texture):
    """Numbers are kept to 0 to 1; where a script gives no colour, the link is white."""
    script = materials.parents[1] / "scripts/other.material"
    script.write_text(text)
    (model,) = read(crate("M")).models
    assert model.warnings == ()
    assert model.colours["body"] == (colour or (1.0, 1.0, 1.0, 1.0))
    (visual,) = model.links["body"].visuals
    assert visual.texture == (str(materials) if texture else "")


def test_a_script_is_read_again_when_it_has_changed_and_not_when_it_is_large(materials, read):
    script = materials.parents[1] / "scripts/other.material"
    for k, (text, length) in enumerate((("1 0 0", 0), ("0 1 0", 0), ("0 0 1", 1_000_000))):
        script.write_text(f"material M {{ ambient {text} }}".ljust(length))
        os.utime(script, ns=(k, k))
        for uri in ("model://crate/materials/scripts", "./models/crate/materials/scripts"):
            (model,) = read(crate("M", uris=f"<uri>{uri}</uri>")).models
            assert model.colours["body"] == (*map(float, text.split()), 1.0)
    script.write_text("material M { ambient 0 0 1 }".ljust(1_000_001))
    (model,) = read(crate("M")).models
    assert model.colours["body"] == (1.0, 1.0, 1.0, 1.0)
    assert f"{script} cannot be read: it has more than 1000000 bytes" in model.warnings[0]


@pytest.mark.parametrize("place", ["scripts/side2.png", "textures/side2.png", "side2.png"])
def test_a_texture_lies_beside_its_script_or_in_the_folder_next_to_it(materials, read, place):
    """Elsewhere, or of more than 64 million pixels, it is left out by name."""
    folder = materials.parents[1]
    (folder / "scripts/other.material").write_text("material M { texture side2.png }")
    (folder / place).write_bytes(materials.read_bytes())
    (model,) = read(crate("M")).models
    (visual,) = model.links["body"].visuals
    beside = place != "side2.png"
    assert visual.texture == (str(folder / place) if beside else "")
    assert len(model.warnings) == (not beside)
    header = b"IHDR" + struct.pack(">IIBBBBB", 8000, 8001, 8, 2, 0, 0, 0)
    (folder / "scripts/side2.png").write_bytes(
        b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header
        + struct.pack(">IIII", zlib.crc32(header), 0, 0x49444154, zlib.crc32(b"IDAT")))
    (model,) = read(crate("M")).models
    assert model.links["body"].visuals[0].texture == ""
    assert "link 'body': texture 'side2.png' of material 'M' is ignored: " in model.warnings[0]


def boxed(kind, count, size=(2.0, 1.0, 0.8)):
    return (f"<model_count>{count}</model_count><box><size>{' '.join(map(str, size))}</size></box>"
            f"<distribution><type>{kind}</type></distribution>")


POSE = (1.0, 2.0, 3.0, 0.3, -0.4, 0.7)
TURN = Rotation.from_euler("xyz", POSE[3:]).as_matrix()


@pytest.mark.parametrize("axis", range(3))
def test_a_line_of_copies_begins_at_its_region_s_side_and_ends_before_the_other(read, axis):
    size, count = np.array([2.0, 1.2, 0.8]), 5
    inside = np.tile(size / 2, (count, 1))
    inside[:, axis] = np.arange(count) / count * size[axis]
    expected = POSE[:3] - size / 2 + inside @ TURN.T
    found = read(population(boxed(f"linear-{'xyz'[axis]}", count, size),
                            pose=" ".join(map(str, POSE))))
    np.testing.assert_allclose(places(found), expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["grid", "random", "cylinder"])
def test_a_region_is_turned_by_its_pose_and_its_corner_is_not(read, kind):
    """A region that stands upright at the origin tells what is inside."""
    inside, corner = {
        "grid": ("<distribution><type>grid</type><rows>2</rows><cols>4</cols><step>0.3 0.7 0.2"
                 "</step></distribution>", (0.45, 0.35, 0)),
        "random": (boxed("random", 6), (1.0, 0.5, 0.4)),
        "cylinder": ("<model_count>6</model_count><cylinder><radius>0.7</radius><length>0.8"
                     "</length></cylinder>", (0, 0, 0))}[kind]
    upright = places(read(population(inside, pose="0 0 0 0 0 0"))) + corner
    if kind == "grid":
        j, i = np.meshgrid(np.arange(4), np.arange(2))
        np.testing.assert_allclose(upright, np.c_[0.3 * j.ravel(), 0.7 * i.ravel(), np.zeros(8)],
                                   atol=1e-12)
    found = read(population(inside, pose=" ".join(map(str, POSE))))
    np.testing.assert_allclose(places(found), POSE[:3] - np.array(corner) + upright @ TURN.T,
                               atol=1e-12)
    assert [m.name for m in found.models] == [f"m_clone_{i}" for i in range(len(upright))]
    assert all(m.initial_pose[1] == (0, 0, 0) for m in found.models) and not found.warnings
    np.testing.assert_allclose(places(read(population(inside, pose=""))), upright - corner,
                               atol=1e-12)


def matrix(values):
    made = np.eye(4)
    made[:3, :3] = Rotation.from_euler("xyz", values[3:]).as_matrix()
    made[:3, 3] = values[:3]
    return made


def numbers_of(matrix_):
    return " ".join(map(repr, (*matrix_[:3, 3].tolist(),
                               *Rotation.from_matrix(matrix_[:3, :3]).as_euler("xyz").tolist())))


SPIN = np.array([0.36, 0.48, 0.8])  # the axis of the joints below, in their frames
LINKS = {"a": (0, 0, 0, 0, 0, 0), "b": (0.3, -0.2, 0.5, 0.4, -0.3, 0.8),
         "c": (0.6, 0.1, 0.9, -0.5, 0.2, 1.1), "d": (0.2, 0.4, 1.4, 0.1, 0.6, -0.7)}
OWN = (0.05, -0.1, 0.2, 0.3, 0.5, -0.4)  # where the joint from c to d stands in d


def linked(kind, limits=""):
    """Of four links: b moves on a, c is fixed on b, and d moves on c, by a joint with a pose."""
    links = "".join(f"<link name='{name}'><pose>{' '.join(map(str, pose))}</pose></link>"
                    for name, pose in LINKS.items())
    joint = ("<joint name='{}' type='{}'>{}<parent>{}</parent><child>{}</child><axis><xyz>0.36 0.48"
             f" 0.8</xyz>{limits}</axis></joint>")
    at = f"<pose>{' '.join(map(str, OWN))}</pose>"
    return (f"<model name='m'><pose>5 5 5 0 0 0</pose>{links}{joint.format('ab', kind, '', *'ab')}"
            f"{joint.format('bc', 'fixed', '', *'bc')}{joint.format('cd', kind, at, *'cd')}"
            "</model>")


def standing(kind, first, second):
    """Where the links are with these joint values: a at BASE, as matrices."""
    def moved(value):
        made = np.eye(4)
        if kind == "prismatic":
            made[:3, 3] = value * SPIN
        else:
            made[:3, :3] = Rotation.from_rotvec(value * SPIN).as_matrix()
        return made

    rest = {name: matrix(pose) for name, pose in LINKS.items()}
    found = {"a": matrix((1, 2, 3, 0.3, -0.4, 0.7))}
    found["b"] = found["a"] @ rest["b"] @ moved(first)
    found["c"] = found["b"] @ np.linalg.inv(rest["b"]) @ rest["c"]
    own = matrix(OWN)
    found["d"] = (found["c"] @ np.linalg.inv(rest["c"]) @ rest["d"] @ own @ moved(second)
                  @ np.linalg.inv(own))
    return found


@pytest.mark.parametrize("known", ["b c d", "c d", "a b d"])
@pytest.mark.parametrize(("kind", "first", "second"), [
    ("revolute", 0.7, -2.9), ("revolute", -3.1, 1.6), ("prismatic", 0.4, -1.5)])
def test_joints_are_where_a_state_s_links_have_them(read, kind, first, second, known):
    """By SciPy's rotations. Joints stay between their stops."""
    place = standing(kind, first, second)
    links = "".join(f"<link name='{name}'><pose>{numbers_of(place[name])}</pose></link>"
                    for name in known.split())
    state = (f"<state><model name='m'><pose>{numbers_of(place['a'])}</pose>{links}</model></state>")
    limits = "<limit><lower>-0.5</lower><upper>0.3</upper></limit>"
    assert read(linked(kind, limits) + state).models[0].initial_joints == pytest.approx(
        {"ab": np.clip(first, -0.5, 0.3), "cd": np.clip(second, -0.5, 0.3)})
    found = read(linked(kind) + state)
    assert found.warnings == ()
    assert found.models[0].initial_joints == pytest.approx({"ab": first, "cd": second}, abs=1e-9)
    simulation = Simulation(SimulationConfig(ground_plane=False))
    world_file.populate(simulation.spawn, found)
    for name, expected in place.items():
        at = simulation.world.models["m"].link_pose(name).matrix()
        np.testing.assert_allclose(at, expected, atol=1e-6)
    simulation.close()


def test_a_state_of_nothing_leaves_all_where_it_is(read):
    """A light and a model keep their own poses, and joints none; time does not run backwards."""
    text = linked("revolute") + "<light name='l'><pose>1 2 3 0 0 0</pose></light>"
    for state in ("", "<state/>", "<state><model name='m'/><light name='l'/></state>",
                  "<state><sim_time>-1 5</sim_time></state>",
                  "<state><model name='m'><link name='a'/></model></state>"):
        found = read(text + state)
        assert found.models[0].initial_pose[0] == (5, 5, 5)
        assert found.models[0].initial_joints == {}
        assert found.lights[0].origin_xyz == (1, 2, 3)
        assert (found.time_ns, found.warnings) == (0, ())


@pytest.mark.parametrize(("speed", "moves"), [
    ("0.01 0 0 0 0 -0.01", False), ("0 -0.011 0 0 0 0", True), ("0 0 0 0 0 0.011", True)])
@pytest.mark.parametrize("text", ["{}", "<model name='n'>{}</model>"])
def test_what_is_faster_than_1_cm_a_second_was_in_motion(read, text, speed, moves):
    text = text.format(f"<link name='a'><velocity>{speed}</velocity></link>")
    found = read(f"<model name='m'><model name='n'><link name='a'/></model><link name='a'/>"
                 f"<static>1</static></model><state><model name='m'>{text}</model></state>")
    assert ["has velocities for m, which" in one for one in found.warnings] == [True] * moves


@pytest.mark.parametrize(("shape", "name", "before", "after"), [
    ("<box><size>1 2 3</size></box>", "size", (1, 2, 3), (2, 6, 1.5)),
    ("<sphere><radius>1</radius></sphere>", "radius", 1, 2),
    ("<cylinder><radius>1</radius><length>3</length></cylinder>", "radius", 1, 2),
    ("<cylinder><radius>1</radius><length>3</length></cylinder>", "length", 3, 1.5),
    ("<mesh><uri>model://crate/meshes/part.obj</uri><scale>1 2 -3</scale></mesh>", "scale",
     (1, 2, -3), (2, 6, -1.5))])
def test_a_state_s_scale_makes_shapes_larger_in_their_places(folders, read, shape, name, before,
                                                             after):
    folders("crate", "")
    part = f"<{{0}} name='p'><pose>1 2 3 0 0 0</pose><geometry>{shape}</geometry></{{0}}>"
    text = ("<model name='m'><link name='a'><inertial><mass>7</mass></inertial>"
            f"{part.format('visual')}{part.format('collision')}</link></model>")
    for scale, expected in (("1 1 1", before), ("2 3 0.5", after), ("2 0 1", before),
                            ("2 -1 1", before)):
        found = read(f"{text}<state><model name='m'><scale>{scale}</scale></model></state>")
        link = found.models[0].links["a"]
        for (one,) in (link.visuals, link.collisions):
            assert getattr(one.geometry, name) == pytest.approx(expected)
            assert (one.name, one.origin_xyz) == ("p", (1, 2, 3))
        assert link.inertial.mass == 7
        assert ("because it is not positive" in "".join(found.warnings)) == (scale[2] in "0-")


def test_a_model_in_a_model_keeps_its_joints_and_plugins(folders, read):
    """Their names, and those of their links, have the inner model's before them."""
    wheel = ("<model name='wheel'><pose>0.1 0.2 0.3 0.4 0.5 0.6</pose><static>1</static>"
             "<link name='hub'><pose>1 0 0 0 0 0.3</pose></link><link name='rim'/>"
             "<joint name='turn' type='revolute'><parent>hub</parent><child> rim </child></joint>"
             "<plugin filename='libx.so'/></model>")
    folders("wheel", wheel)
    tied = ("<joint name='tie' type='fixed'><parent>world</parent><child>{}</child></joint>")
    text = (f"<model name='cart'>{tied.format('front::wheel::hub')}<model name='front'><pose>7 8 9"
            f" 0.1 -0.2 0.3</pose>{wheel}</model></model>")
    (cart,) = read(text).models
    assert list(cart.links) == ["world", "front::wheel::hub", "front::wheel::rim"]
    joint = cart.joints["front::wheel::turn"]
    assert (joint.parent, joint.child) == ("front::wheel::hub", "front::wheel::rim")
    assert cart.joints["tie"].parent == "world" and not cart.static
    outer, inner = matrix((7, 8, 9, 0.1, -0.2, 0.3)), matrix((0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    at = outer @ inner @ matrix((1, 0, 0, 0, 0, 0.3))
    np.testing.assert_allclose(cart.joints["tie"].pose.matrix(), at, atol=1e-9)
    np.testing.assert_allclose(joint.pose.matrix(), np.linalg.inv(at) @ outer @ inner, atol=1e-9)
    assert cart.warnings == ("SDF: plugin 'libx.so' is ignored, because it is not "
                             "known",)
    bolted = wheel.replace("</model>", tied.format("hub") + "</model>")
    (cart,) = read(f"<model name='cart'>{bolted}</model>").models
    tie = cart.joints["wheel::tie"]
    assert (tie.parent, tie.child) == ("world", "wheel::hub")


@pytest.mark.parametrize(("versions", "taken"), [
    ((1.4, 1.6, 1.5), 1), ((1.6, 1.4, 1.5), 0), ((None, 1.0), 1), ((None, None), 0)])
def test_the_newest_file_of_a_model_folder_is_read(folders, read, versions, taken):
    names = "".join("<sdf{}> {}.sdf </sdf>".format(f" version='{one}'" if one else "", k)
                    for k, one in enumerate(versions))
    folder = folders("crate", "", config=f"<model><name>crate</name>{names}</model>")
    for k in range(len(versions)):
        (folder / f"{k}.sdf").write_text(f"<sdf><model name='m{k}'><link name='a'/></model></sdf>")
    assert [model.name for model in read(include("crate")).models] == [f"m{taken}"]


def test_a_model_folder_may_hold_a_light_or_a_world(folders, read):
    folders("lamp", "<light name='lamp' type='spot'><pose>1 2 3 0 0 0</pose></light>")
    folders("room", "<world name='w'><plugin name='p'/><model name='room'><link name='a'/></model>"
            "<model name='other'><link name='a'/></model></world>")
    found = read(include("lamp", "<name>mine</name><pose>4 5 6 0 0 0</pose>") + include("room")
                 + include("ground_plane", "<pose>0 0 -1 0 0 0</pose>") + include("sun"))
    assert [(light.name, light.kind, light.origin_xyz) for light in found.lights] == [
        ("mine", "spot", (4, 5, 6)), ("sun", "directional", (0, 0, 10))]
    assert [(model.name, model.initial_pose[0]) for model in found.models] == [
        ("room", (0, 0, 0)), ("ground_plane", (0, 0, -1))]
    (plane,) = found.models[1].links["link"].collisions
    assert (plane.geometry.size, plane.geometry.normal) == ((100, 100, 0), (0, 0, 1))
    assert found.models[1].links["link"].mu == 100 and found.models[1].static


def test_packages_export_folders_of_models(folders, read, tmp_path, monkeypatch):
    """They come after the model paths; and a model may lie in a folder there."""
    arm = tmp_path / "src" / "arm"
    export = ("<package><name>arm</name><export><gazebo_ros gazebo_model_path='${prefix}/models:"
              "${prefix}/..'/></export></package>")
    for place, name in ((arm / "models" / "bench", "bench"), (arm / "models" / "sets/lamp", "lamp"),
                        (arm / "models" / "crate", "exported")):
        place.mkdir(parents=True)
        (place / "model.config").write_text("<model><sdf>m.sdf</sdf></model>")
        (place / "m.sdf").write_text(f"<sdf><model name='{name}'><link name='a'/></model></sdf>")
    for name, text in (("arm", export), ("broken", "<package>gazebo_model_path<"), ("none", "")):
        (tmp_path / "src" / name).mkdir(exist_ok=True)
        (tmp_path / "src" / name / "package.xml").write_text(text)
    folders("crate", "<model name='crate'><link name='a'/></model>")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "src"))
    found = read(include("bench") + include("sets/lamp") + include("crate"))
    assert [model.name for model in found.models] == ["bench", "lamp", "crate"]
    assert find_model("arm") == str(arm)
    for name in ("", ".", "..", "crate/meshes", "cra\0te", "gone"):
        assert find_model(name) is None
    for uri in ("model://sets/../../arm", "model://sets/none"):
        with pytest.raises(DescriptionError, match="the folder .* is not in GAZEBO_MODEL_PATH"):
            find_folder(uri, None)
