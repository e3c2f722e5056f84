"""Conversion of light into grey levels."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scenes import BRIGHT, looking

from aras_sim_bridge.description import Geometry, Light, parse_urdf, world_file
from aras_sim_bridge.errors import DescriptionError, WorldError
from aras_sim_bridge.lighting import MOST_LIGHTS
from aras_sim_bridge.rendering import Lighting, View, create_renderer
from aras_sim_bridge.simulation import Simulation, SimulationConfig

K = np.array([[300.0, 0, 159.5], [0, 310.0, 119.5], [0, 0, 1.0]])
DOWN = (0.0, 0.0, -1.0)


def level(bench, light, colour="Gazebo/White") -> int:
    """Return the grey level of a plate that faces up."""
    bench.box([1.0, 1.0, 0.05], [0, 0, -0.05], colour)
    view = View(320, 240, looking([0.1, 0, 1.0], [0, 0, 0], (0, 1, 0)), K)
    picture = create_renderer("exact", bench.world, light).render(view)
    assert np.ptp(picture) == 0
    return int(picture[0, 0, 0])


def test_a_white_plate_square_to_the_sun_is_just_white(bench):
    assert level(bench, Lighting(DOWN)) == 255


@pytest.mark.parametrize(("ambient", "diffuse"), [(0.4, 0.8), (0.9, 0.8), (2.0, 0.0)])
def test_light_that_is_too_much_is_scaled_all_over(bench, ambient, diffuse):
    sun = Lighting((1.0, 0.0, -1.0), ambient, diffuse)
    lit = (ambient + diffuse * np.sqrt(0.5)) / (ambient + diffuse)
    assert level(bench, sun, "Gazebo/Grey") == pytest.approx(0.7 * 255 * lit, abs=0.51)


def test_dim_light_stays_dim(bench):
    assert level(bench, Lighting(DOWN, 0.1, 0.2)) == pytest.approx(255 * 0.3, abs=0.51)


def test_gazebo_cuts_what_is_brighter_than_white(bench):
    assert level(bench, BRIGHT) == 255
    assert level(
        bench, Lighting(DOWN, 0.4, 0.8, exposure="gazebo"), "Gazebo/Grey"
    ) == pytest.approx(255 * 0.7 * 1.2, abs=0.51)


ASLANT = Light("a", direction=(0.3, -0.2, -0.8), diffuse=(0.5, 0.5, 0.5, 1.0), cast_shadows=True)


def shown(bench, light, eye=(0.2, -1.2, 0.9), at=(0.0, 0.0, 0.1)) -> np.ndarray:
    """(240, 320, 3) float."""
    view = View(320, 240, looking(eye, at), K)
    return create_renderer("exact", bench.world, light).render(view).astype(float)


def things(bench) -> None:
    """A floor with a box and a ball before it, and a wire."""
    bench.box([2.0, 2.0, 0.05], [0, 0, -0.05])
    bench.box([0.1, 0.15, 0.1], [-0.2, 0, 0.1], "Gazebo/Red", (0, 0, 0.2, np.sqrt(0.96)))
    bench.body(Geometry("sphere", radius=0.15), (0.3, 0.1, 0.15), "Gazebo/Grey")
    bench.box([0.001, 0.001, 0.3], [0.05, -0.2, 0.3], "Gazebo/Black")


def test_one_light_among_lights_is_the_sun(bench):
    things(bench)
    sun = shown(bench, Lighting(ASLANT.direction, diffuse=0.5))
    one = shown(bench, Lighting(lights=(ASLANT,)))
    both = np.abs(one - sun)
    assert both.max() <= 6  # within a ball's facets normals are turned, not brightness
    assert (both > 1).mean() < 0.01
    half = Light("b", direction=ASLANT.direction, diffuse=(0.25, 0.25, 0.25, 1.0))
    assert np.abs(shown(bench, Lighting(lights=(half, half))) - one).max() <= 1


def test_a_light_that_casts_shadows_only_where_they_are_asked_for(bench):
    things(bench)
    bright = shown(bench, Lighting(lights=(ASLANT,)))
    shaded = shown(bench, Lighting(lights=(ASLANT,), shadows="hard"))
    darker = bright - shaded
    assert darker.min() >= -6  # at edges
    assert 0.02 < (darker > 40).all(axis=2).mean() < 0.2
    open_ = Light("c", direction=ASLANT.direction, diffuse=ASLANT.diffuse)
    assert (shown(bench, Lighting(lights=(open_,), shadows="hard")) == bright).all()


def test_shadows_do_not_hang_on_what_memory_held_before(bench):
    things(bench)
    pictures = []
    for left in (0.0, np.nan):
        litter = [np.full(size, left) for size in range(1, 60) for _ in range(40)]
        del litter
        pictures.append(shown(bench, Lighting(lights=(ASLANT,), shadows="hard")))
    assert (pictures[0] == pictures[1]).all()


def test_the_sky_is_bluer_above(bench):
    view = View(320, 240, looking([0, 0, 1.0], [1.0, 0, 1.5]), K)
    sky = create_renderer("exact", bench.world, Lighting(sky=True)).render(view).astype(int)
    assert (np.diff(sky[:, 160, 0]) >= 0).all()
    assert sky[0, 160, 0] < sky[-1, 160, 0] - 30
    assert (sky[..., 2] >= sky[..., 0]).all()


WORLD = """<sdf version="1.6"><world name="w"><scene><ambient>0.2 0.1 0.3 1</ambient>
<background>0.1 0.2 0.3</background>{}</scene><light name="l" type="spot"><pose>0 0 2 0 0 0</pose>
<direction>0 0 -1</direction><spot><inner_angle>0.2</inner_angle><outer_angle>0.5</outer_angle>
<falloff>2</falloff></spot><attenuation><range>7</range></attenuation></light></world></sdf>"""


def test_what_a_world_says_of_light(tmp_path):
    path = tmp_path / "w.world"
    path.write_text(WORLD.format("<sky/><shadows>1</shadows>"))
    world = world_file.load_world(str(path))
    (spot,) = world.lights
    assert (spot.spot_inner, spot.spot_outer, spot.spot_falloff, spot.attenuation_range) == (
        0.2, 0.5, 2.0, 7.0)
    assert world.scene.ambient == (0.2, 0.1, 0.3, 1.0)
    assert world.scene.background == (0.1, 0.2, 0.3, 1.0)
    assert (world.scene.sky, world.scene.shadows) == (True, "none")
    path.write_text(WORLD.format("<aras:shadows>soft</aras:shadows>"))
    assert world_file.load_world(str(path)).scene.shadows == "soft"
    path.write_text(WORLD.format("<aras:shadows>long</aras:shadows>"))
    with pytest.raises(DescriptionError, match="'long' is unknown; use none, hard, soft"):
        world_file.load_world(str(path))


TIMED = WORLD.replace("</attenuation>", "</attenuation><aras:shines>{times}</aras:shines>")


def test_a_light_of_a_world_comes_and_goes(tmp_path):
    path = tmp_path / "w.world"
    path.write_text(TIMED.format("", times="0 0.5  1.25 2"))
    (spot,) = world_file.load_world(str(path)).lights
    assert spot.lit_intervals == ((0.0, 0.5), (1.25, 2.0))
    for times, complaint in [("0 0.5 1", "needs 4 numbers"), ("1 0.5", "from 1 to 0.5 s"),
                             ("-1 0.5", "must start at 0 s or later"), ("1 x", "'x'")]:
        path.write_text(TIMED.format("", times=times))
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
    """By more light than is white, and the camera stays as it is: dark is darker by what is gone.
    """
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
    lit, shaded = (shown(bench, Lighting(lights=(side,), shadows=s)) for s in ("none", "hard"))
    assert (lit == shaded).all()


@pytest.mark.parametrize(("length", "dark"), [(2.9, False), (3.2, True)])
def test_what_is_not_convex_shades_itself_from_three_pixels_on(
    bench, tmp_path, length, dark
):  # fmt: skip
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
    picture = create_renderer("exact", bench.world, Lighting(lights=(sun,), shadows="hard")).render(
        view
    )
    lit = 255.0 * (0.4 + 0.6 * -way[2] / np.linalg.norm(way))
    for x, y in plates + way[:2]:
        u, v = K[0, 0] * x + K[0, 2], -K[1, 1] * y + K[1, 2]
        assert picture[round(v), round(u), 0] == pytest.approx(102.0 if dark else lit, abs=1.0)


def test_a_hard_shadow_is_in_a_pixel_by_as_much_as_covers_it(bench):
    """Of a turned plate, whose four borders lie in it as unlike as can be."""
    K = np.array([[70.0, 0, 8.3], [0, 60.0, 27.4], [0, 0, 1.0]])
    bench.box([1.0, 1.0, 0.05], [0, 0, -0.05])
    turn, half = 0.4, np.array([0.12, 0.09])
    bench.box([*half, 1e-5], [-0.3, 0.0, 0.3], "Gazebo/Black",
              (0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)))
    sun = Light("s", direction=(1.0, 0.5, -0.6), diffuse=(0.6,) * 4, cast_shadows=True)
    view = View(33, 34, looking([0, 0, 1.0], [0, 0, 0], (0, 1, 0)), K)  # the floor is 1 m away
    picture = create_renderer("exact", bench.world, Lighting(lights=(sun,), shadows="hard")).render(
        view
    )
    fine = (np.arange(16) + 0.5) / 16 - 0.5
    x = (np.add.outer(np.arange(33), fine).ravel() - K[0, 2]) / K[0, 0] - 0.2
    y = (K[1, 2] - np.add.outer(np.arange(34), fine).ravel()) / K[1, 1] - 0.25
    along, across = (np.add.outer(y * b, x * a) for a, b in (
        (np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))))
    dark = (np.abs(along) < half[0]) & (np.abs(across) < half[1])
    share = dark.reshape(34, 16, 33, 16).mean(axis=(1, 3))
    lit = picture.max() - 102.0
    assert ((share > 0.1) & (share < 0.9)).sum() > 30
    np.testing.assert_allclose((picture.max() - picture[..., 0]) / lit, share, atol=0.1)
