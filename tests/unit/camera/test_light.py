"""Conversion of light into grey levels."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scenes import BRIGHT, looking

from aras_sim_bridge.description import Geometry, Light, parse_urdf, world_file
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.lighting import MOST_LIGHTS
from aras_sim_bridge.rendering import Lighting, View, create_renderer
from aras_sim_bridge.simulation import Simulation, SimulationConfig

K = np.array([[300.0, 0, 159.5], [0, 310.0, 119.5], [0, 0, 1.0]])
DOWN = (0.0, 0.0, -1.0)
OVER = (0.4 + 0.8 * np.sqrt(0.5)) / 1.2


@pytest.mark.parametrize(("light", "colour", "expected"), [
    (Lighting(DOWN), "White", 255), (Lighting(DOWN, 0.1, 0.2), "White", 255 * 0.3),
    (Lighting((1.0, 0.0, -1.0), 0.4, 0.8), "Grey", 0.7 * 255 * OVER),  # scaled all over
    (BRIGHT, "White", 255), (Lighting(DOWN, 0.4, 0.8, exposure="gazebo"), "Grey", 255 * 0.7 * 1.2),
])
def test_the_level_of_a_plate_that_faces_up(bench, light, colour, expected):
    bench.box([1.0, 1.0, 0.05], [0, 0, -0.05], f"Gazebo/{colour}")
    view = View(320, 240, looking([0.1, 0, 1.0], [0, 0, 0], (0, 1, 0)), K)
    picture = create_renderer("exact", bench.world, light).render(view)
    assert np.ptp(picture) == 0 and picture[0, 0, 0] == pytest.approx(expected, abs=0.51)


def test_a_light_of_a_world_comes_and_goes(tmp_path):
    path, text = tmp_path / "w.world", ("<sdf version='1.6'><world name='w'><light name='l'>"
                                        "<aras:shines>{}</aras:shines></light></world></sdf>")
    path.write_text(text.format("0 0.5  1.25 2"))
    (lamp,) = world_file.load_world(str(path)).lights
    assert lamp.lit_intervals == ((0.0, 0.5), (1.25, 2.0))
    for times, complaint in [("0 0.5 1", "needs 4 numbers"), ("1 0.5", "from 1 to 0.5 s"),
                             ("-1 0.5", "must start at 0 s or later"), ("1 x", "'x'")]:
        path.write_text(text.format(times))
        found = world_file.load_world(str(path))
        (told,) = found.warnings
        assert not found.lights
        assert re.match(f"light 'l' is ignored: light 'l': aras:shines.*{complaint}", told)
    with pytest.raises(WorldError, match="'l': the lit interval is from 2 to 1 s"):
        Simulation(SimulationConfig(lights=(Light("l", lit_intervals=((2.0, 1.0),)),)))


EYE = {"parent": "world", "width": 32, "height": 24, "update_rate": 50.0, "near": 0.02,
       "pose": [0.0, 0.0, 1.0, 0.0, np.pi / 2, 0.0]}


def levels(*lights) -> dict[int, int]:
    """Grey level of a white floor in each image, by its stamp, ms."""
    simulation = Simulation(SimulationConfig(lights=lights))
    eye, seen = simulation.add_camera("eye", EYE), {}
    eye.on_frame = lambda frame: seen.update(
        {frame.stamp_ns // 1_000_000: int(frame.image[12, 16, 0])})
    eye.enabled = True
    simulation.spawn(parse_urdf(
        '<robot name="f"><link name="world"/><link name="f"><visual><geometry>'
        '<box size="3 3 0.01"/></geometry></visual></link><joint name="j" type="fixed">'
        '<parent link="world"/><child link="f"/></joint></robot>'), "floor")
    while simulation.time_ns < 200_000_000:
        simulation.step(simulation.time_ns + 7_000_000)
    simulation.close()
    return seen


def test_pictures_are_lit_by_what_shines_at_their_time():
    """More light than white leaves the exposure: dark is darker by what is gone."""
    sun = Light("sun", direction=DOWN, diffuse=(0.7, 0.7, 0.7, 1.0))
    timed = replace(sun, lit_intervals=((0.0, 0.06), (0.14, 0.18)))
    whole, seen = levels(sun), levels(timed)
    assert set(whole.values()) == {255}  # (0.4 + 0.7) / 1.1
    dark = round(255 * 0.4 / 1.1)
    assert seen == {ms: 255 if ms <= 60 or 140 < ms <= 180 else dark for ms in whole}
    lamp = replace(timed, name="lamp", diffuse=(0.2, 0.1, 0.3, 1.0))
    both = levels(sun, lamp)
    assert both == {ms: round(255 * (1.3 if level == 255 else 1.1) / 1.4)
                    for ms, level in seen.items()}


def test_a_simulation_that_begins_anew_is_lit_as_at_its_beginning():
    light = Light("sun", direction=DOWN, diffuse=(0.6,) * 3 + (1.0,), lit_intervals=((0.0, 0.05),))
    simulation = Simulation(SimulationConfig(lights=(light,)))
    eye, seen = simulation.add_camera("eye", EYE), []
    eye.on_frame, eye.enabled = lambda frame: seen.append(int(frame.image.mean())), True
    for _ in range(2):
        while simulation.time_ns < 100_000_000:
            simulation.step()
        simulation.reset_simulation()
    simulation.close()
    assert seen[:5] == seen[5:] and seen[1] > seen[4] + 50


def test_lights_that_are_too_many_are_named(caplog):
    lights = tuple(Light(f"l{n}", diffuse=(0.01,) * 4) for n in range(MOST_LIGHTS + 2))
    simulation = Simulation(SimulationConfig(lights=lights))
    assert [record.args[0] for record in caplog.records] == [
        f"l{n}" for n in (MOST_LIGHTS, MOST_LIGHTS + 1)]
    simulation.close()


def test_a_ball_casts_no_shadow_on_itself(bench):
    """Facets that turn from the light are lit as far as their smooth normals are."""
    bench.body(Geometry("sphere", radius=0.3), (0.0, 0.0, 0.1))
    side = Light("s", direction=(1.0, 0.2, 0.0), diffuse=(0.5,) * 4, cast_shadows=True)
    view = View(320, 240, looking((0.2, -1.2, 0.9), (0.0, 0.0, 0.1)), K)
    lights = [Lighting(lights=(side,), shadows=shadows) for shadows in ("none", "hard")]
    lit, shaded = (create_renderer("exact", bench.world, light).render(view) for light in lights)
    assert (lit == shaded).all() and len(np.unique(lit)) > 20


@pytest.mark.parametrize(("length", "dark"), [(2.9, False), (3.2, True)])
def test_what_is_not_convex_shades_itself_from_three_pixels_on(bench, tmp_path, length, dark):
    """Plates above a floor, all of one mesh; light goes on for `length` pixels between them. The
    lens is so wide that rays within a tile are of unlike lengths."""
    K = np.array([[16.0, 0, 14.2], [0, 21.0, 8.7], [0, 0, 1.0]])
    way = length / K[0, 0] * np.array([-0.75, 0.45, -0.5]) / np.linalg.norm([0.75, 0.45, 0.5])
    plates = [(x, y) for x in (0.25, 0.62, 1.0) for y in (-0.6, -0.25)]
    squares = [(0.0, 0.0, 0.0, 4.0)] + [(*at, -way[2], 0.065) for at in plates]
    text = "".join(f"v {x + a * s} {y + b * s} {z}\n" for x, y, z, s in squares
                   for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    text += "vn 0 0 1\n" + "".join("f " + " ".join(f"{4 * n + k}//1" for k in range(1, 5)) + "\n"
                                   for n in range(len(squares)))
    (tmp_path / "plates.obj").write_text(text)
    bench.body(Geometry("mesh", filename=str(tmp_path / "plates.obj")))
    sun = Light("s", direction=tuple(way), diffuse=(0.6,) * 4, cast_shadows=True)
    view = View(33, 25, looking([0, 0, 1.0], [0, 0, 0], (0, 1, 0)), K)  # the floor is 1 m away
    light = Lighting(lights=(sun,), shadows="hard")
    picture = create_renderer("exact", bench.world, light).render(view)
    lit = 255.0 * (0.4 + 0.6 * -way[2] / np.linalg.norm(way))
    for x, y in plates + way[:2]:
        u, v = K[0, 0] * x + K[0, 2], -K[1, 1] * y + K[1, 2]
        assert picture[round(v), round(u), 0] == pytest.approx(102.0 if dark else lit, abs=1.0)
