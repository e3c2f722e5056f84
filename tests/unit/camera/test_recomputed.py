"""Images, compared with rays cast at each triangle, up to 64 in a pixel, by other code."""

import cv2
import numpy as np
import pytest
from scenes import link_pose, looking
from scipy.ndimage import map_coordinates
from scipy.stats import qmc

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import Geometry, Light
from aras_sim_bridge.rendering import Lighting, View, create_renderer
from aras_sim_bridge.rendering.tiles import TILE

PLACES = qmc.Sobol(4, seed=3).random(256)  # in a pixel, and on a light's disc
SUN_RADIUS, LAMP_RADIUS = 0.03, 0.04  # docs/camera.md
EYE, AT = [0.5, -0.7, 0.6], [0.05, 0.0, 0.08]


def side_of(part, a, b, c) -> tuple:
    """A part's number and the way that a triangle of it faces, the same for both of a quad."""
    normal = np.cross(b - a, c - a)
    return (part, *np.rint(1e4 * normal / np.linalg.norm(normal) + 0.3).astype(int).tolist())


class Caster:
    """Ray caster for all triangles of a renderer's scene, in the world frame."""

    def __init__(self, renderer) -> None:
        renderer.scene.refresh()
        poses = renderer.scene.read_poses()
        corners, normals, colours, parts, uvs, self.side = [], [], [], [], [], []
        self.textures = {}
        for n, part in enumerate(renderer.scene.visuals):
            T, mesh = poses[part.row], part.mesh
            own = mesh.positions[mesh.triangles].astype(float)
            corners.append(own @ T[:3, :3].T + T[:3, 3])
            normals.append(mesh.normals[mesh.triangles].astype(float) @ T[:3, :3].T)
            colours.append(np.tile(part.rgba, (len(own), 1)))
            parts.append(np.full(len(own), n))
            self.side += [side_of(n, *triangle) for triangle in own]
            uvs.append(np.zeros((len(own), 3, 2)) if mesh.uv is None else mesh.uv[mesh.triangles])
            if mesh.texture:
                self.textures[n] = cv2.imread(mesh.texture)[..., ::-1] / 255.0
        self.corners, self.normals, self.colours, self.part, self.uv = map(
            np.concatenate, (corners, normals, colours, parts, uvs))
        self.label = renderer.scene.compute_labels()[
            [renderer.scene.visuals[n].row for n in self.part]]
        a = self.corners[:, 0]
        self.e1, self.e2 = self.corners[:, 1] - a, self.corners[:, 2] - a
        self.normal = np.cross(self.e1, self.e2)

    def meet(self, start, way, n):
        """Where rays from start (3,) or (N, 3) along way (N, 3) meet triangles n (T,), by Cramer's
        rule: distance in lengths of way or inf; shares of the second and third corner."""
        a, e1, e2, normal = self.corners[n, 0], self.e1[n], self.e2[n], self.normal[n]
        moment = np.cross(start, way)
        with np.errstate(all="ignore"):
            det = -1.0 / (way @ normal.T)
            far = (start @ normal.T - (a * normal).sum(axis=1)) * det
            u = (moment @ e2.T - way @ np.cross(e2, a).T) * det
            v = (way @ np.cross(e1, a).T - moment @ e1.T) * det
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (far > 0.0)
        return np.where(hit, far, np.inf), u, v

    def seen(self, view, rays):
        """`meet` for rays (N, 3) in the optical frame, and the front-facing triangles (T,)."""
        T = view.world_T_optical
        front = np.flatnonzero(((T[:3, 3] - self.corners[:, 0]) * self.normal).sum(axis=1) > 0.0)
        far, u, v = self.meet(T[:3, 3], rays @ T[:3, :3].T, front)
        ahead = far * rays[:, 2:]
        return np.where((ahead >= view.near) & (ahead <= view.far), far, np.inf), u, v, front

    def shadowed(self, start, way, own):
        """(N,) whether an opaque part other than own (N,), which is convex, is on the way."""
        casts = np.flatnonzero(self.colours[:, 3] >= 1.0)
        far = self.meet(start, way, casts)[0]
        return ((far < 1.0) & (self.part[casts] != own[:, None])).any(axis=1)

    def colour(self, n, share) -> np.ndarray:
        """(N, 3) on triangles n (N,), 0..1. A texture's first row is at v = 1; it repeats."""
        out = self.colours[n, :3].copy()
        uv = (self.uv[n] * share[..., None]).sum(axis=1)
        for part, texture in self.textures.items():
            own, size = self.part[n] == part, texture.shape[:2]
            at = [(1.0 - uv[own, 1]) * size[0] - 0.5, uv[own, 0] * size[1] - 0.5]
            for k in range(3):
                out[own, k] *= map_coordinates(texture[..., k], at, order=1, mode="grid-wrap")
        return out


def backdrop(light: Lighting, up) -> np.ndarray:
    """(N, 3) of rays whose sines above the horizon are up (N,); 0..1."""
    if not light.sky:
        return np.tile(light.background[:3], (len(up), 1))
    zenith, horizon, haze = np.array([(0.22, 0.42, 0.78), (0.8, 0.88, 0.95), (0.52, 0.52, 0.5)])
    up = up[:, None]
    return np.where(up > 0.0, horizon + np.sqrt(np.abs(up)) * (zenith - horizon),
                    horizon + np.minimum(-6.0 * up, 1.0) * (haze - horizon))


def sunlit(light: Lighting, normals, share, n) -> np.ndarray:
    """(N, 1) light between the corners of triangles n (N,)."""
    to = -np.array(light.direction) / np.linalg.norm(light.direction)
    at = light.ambient + light.diffuse * np.maximum(normals[n] @ to, 0.0)
    return (at * share).sum(axis=1)[:, None]


def lamplit(light: Lighting, caster: Caster, points, share, n, disc) -> np.ndarray:
    """(N, 3) light at points by lamps. disc (2, N): 0..1, a place on each."""
    normal = (caster.normals[n] * share[..., None]).sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    total = np.tile(light.ambient * np.array(light.tint), (len(n), 1))
    for lamp in light.lights:
        if lamp.kind == "directional":
            to = np.tile(-np.array(lamp.direction) / np.linalg.norm(lamp.direction), (len(n), 1))
            left, reach, radius = np.ones(len(n)), 100.0, SUN_RADIUS
            unit = to
        else:
            to = lamp.origin_xyz - points
            far = np.linalg.norm(to, axis=1)
            unit = to / far[:, None]
            left = (far <= lamp.attenuation_range) / np.maximum(
                lamp.attenuation_constant + lamp.attenuation_linear * far
                + lamp.attenuation_quadratic * far**2, 1.0)
            reach, radius = 1.0, LAMP_RADIUS
        if lamp.kind == "spot":
            inner, outer = np.cos(lamp.spot_inner / 2), np.cos(lamp.spot_outer / 2)
            along = -unit @ lamp.direction / np.linalg.norm(lamp.direction)
            left *= np.clip((along - outer) / (inner - outer), 0.0, 1.0) ** lamp.spot_falloff
        cosine = (normal * unit).sum(axis=1)
        if light.shadows == "soft":
            across = np.cross(unit, (0.1, 0.2, 0.97))
            across /= np.linalg.norm(across, axis=1)[:, None]
            r, angle = radius * np.sqrt(disc[0, :, None]), 2.0 * np.pi * disc[1, :, None]
            to = to + r * (np.cos(angle) * across + np.sin(angle) * np.cross(unit, across))
        lit = (cosine > 0.0) & (left > 0.0)
        if light.shadows != "none" and lamp.cast_shadows:
            lit &= ~caster.shadowed(points, reach * to, caster.part[n])
        total += (lit * left * cosine)[:, None] * lamp.diffuse[:3]
    return total


def expected(caster: Caster, model, view, light: Lighting, pixels, many) -> tuple:
    """Grey levels (many, N, 3) at `many` places of pixels (height, width) bool, and the triangle
    there (many, N), -1: none, -2: several, through glass."""
    T, count = view.world_T_optical, int(pixels.sum())
    at = np.argwhere(pixels)[:, ::-1] + PLACES[:many, None, :2] - 0.5
    all_rays = model.unproject(at.reshape(-1, 2))
    discs = np.repeat(PLACES[:many, 2:], count, axis=0)
    out, shows = [], []
    for part in np.array_split(np.arange(len(discs)), max(len(discs) // 8000, 1)):
        rays, disc = all_rays[part], discs[part]
        far, second, third, front = caster.seen(view, rays)
        colour = 255.0 * backdrop(light, rays @ T[2, :3])
        shown = np.full(len(rays), -1)
        # The nearest opaque one, and what glass before it mixes, from far to near.
        clear = caster.colours[front, 3] < 1.0
        order = np.where(clear, np.inf, far).argmin(axis=1)[:, None]
        opaque = np.take_along_axis(np.where(clear, np.inf, far), order, axis=1)[:, 0]
        panes = np.flatnonzero(clear & np.isfinite(far).any(axis=0))
        if len(panes):
            before = panes[np.argsort(-far[:, panes], axis=1)]
            order = np.hstack([order, before])
        for k in order.T:
            at = far[np.arange(len(k)), k]
            there = np.flatnonzero(np.isfinite(at) & (at <= opaque))
            if not len(there):
                continue
            k, n = k[there], front[k[there]]
            b, c = second[there, k], third[there, k]
            share = np.stack([1.0 - b - c, b, c], axis=1)
            if light.lights:
                points = T[:3, 3] + (at[there, None] * rays[there]) @ T[:3, :3].T
                lit = lamplit(light, caster, points, share, n, disc[there].T)
            else:
                lit = sunlit(light, caster.normals, share, n)
            level = np.minimum(255.0 * light.scale * caster.colour(n, share) * lit, 255.0)
            alpha = caster.colours[n, 3:]
            colour[there] += alpha * (level - colour[there])
            shown[there] = np.where(alpha[:, 0] < 1.0, -2, n)
        out.append(colour)
        shows.append(shown)
    return (np.concatenate(out).reshape(many, count, 3), np.concatenate(shows).reshape(many, count))


def resolved(renderer, view):
    """Pixels (height, width) bool that are worked out from the areas of what covers them."""
    one = renderer.sample(view, 1.0, -0.5)
    bits, _ = renderer.resolve(one, view)
    tiles = one.canvas.tiles
    of = bits[:, None] >> np.arange(TILE * TILE, dtype=np.uint64) & np.uint64(1)
    of = of.reshape(tiles.rows, tiles.columns, TILE, TILE).swapaxes(1, 2)
    return of.reshape(tiles.rows * TILE, -1)[:view.height, :view.width] > 0


DIAMOND_OBJ = """mtllib {0}.mtl\nusemtl {0}
v 0.09 0 0.02\nv -0.08 0.01 0\nv 0 0.1 0\nv 0.01 -0.07 0\nv 0 0 0.12\nv 0 0.01 -0.1
vn 1 0 0.2\nvn -1 0.1 0\nvn 0 1 0\nvn 0.1 -1 0\nvn 0 0 1\nvn 0 0.1 -1
vt 0 0.3\nvt 0.8 0.1\nvt 1.3 0.7\nvt 0.2 1.2\nvt 0.4 -0.5\nvt -0.3 0.9
f 1/1/1 3/3/3 5/5/5\nf 3/3/3 2/2/2 5/5/5\nf 2/2/2 4/4/4 5/5/5\nf 4/4/4 1/1/1 5/5/5
f 3/3/3 1/1/1 6/6/6\nf 2/2/2 3/3/3 6/6/6\nf 4/4/4 2/2/2 6/6/6\nf 1/1/1 4/4/4 6/6/6
"""
CARD_OBJ = """mtllib {0}.mtl\nusemtl {0}
v -0.14 -0.1 0\nv 0.14 -0.1 0\nv 0.14 0.1 0\nv -0.14 0.1 0
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1
"""


def turned(axis, angle) -> tuple[float, ...]:
    """A unit quaternion xyzw."""
    axis = np.array(axis) / np.linalg.norm(axis)
    return (*(np.sin(angle / 2) * axis), np.cos(angle / 2))


def mesh(folder, name, text, size=None, seed=0) -> Geometry:
    """A mesh file; with a periodic texture of a size (rows, columns) where one is given."""
    (folder / f"{name}.obj").write_text(text.format(name))
    look = "newmtl {0}\nKd 0.95 0.8 0.9\n" + (f"map_Kd {name}.png\n" if size else "")
    (folder / f"{name}.mtl").write_text(look.format(name))
    if size:
        v, u = (2.0 * np.pi * (np.arange(n) + 0.5) / n for n in size)
        rng, waves = np.random.default_rng(seed), 0.0
        for i, j in ((0, 1), (1, 0), (1, 1), (2, -1)):
            phase = rng.uniform(0, 2 * np.pi, 3)
            waves = waves + np.cos(i * u[None, :, None] + j * v[:, None, None] + phase)
        cv2.imwrite(str(folder / f"{name}.png"), np.rint(130.0 + 30.0 * waves).astype(np.uint8))
    return Geometry("mesh", filename=str(folder / f"{name}.obj"))


def things(bench, tmp_path) -> None:
    """On a tilted floor two boxes through each other, a smooth solid, a wire, before them a pane of
    glass; and a rail that goes past the eye."""
    bench.box([0.5, 0.4, 0.02], [0, 0, -0.02], "Gazebo/White", turned((1, 0.3, 0.2), 0.1))
    bench.box([0.12, 0.05, 0.08], [-0.1, 0.05, 0.1], "Gazebo/Red", turned((0.2, 0.3, 1), 0.6))
    bench.box([0.05, 0.14, 0.04], [-0.07, 0.02, 0.12], "Gazebo/Blue", turned((0.5, 1, 0.1), 0.4))
    bench.body(mesh(tmp_path, "diamond", DIAMOND_OBJ), [0.18, -0.1, 0.16],
               "Gazebo/Yellow", turned((1, 0.5, 0.4), 0.5))
    bench.box([0.003, 0.25, 0.002], [0.1, 0.0, 0.3], "Gazebo/Green", turned((0.3, 0.2, 1), 0.9))
    bench.box([0.1, 0.003, 0.07], [0.12, -0.3, 0.3], "Gazebo/GreyTransparent",
              turned((0.2, 0.1, 1), 0.3))
    bench.box([0.01, 0.9, 0.02], [0.42, -0.6, 0.4], "Gazebo/Grey", turned((0.3, 0.1, 1), 0.45))


def painted(bench, tmp_path) -> None:
    """A smooth solid and a card before it with textures, crossed by a wire."""
    bench.box([0.5, 0.4, 0.02], [0, 0, -0.12], "Gazebo/White", turned((1, 0.3, 0.2), 0.1))
    bench.body(mesh(tmp_path, "stone", DIAMOND_OBJ, (400, 512), 1), [-0.04, 0.02, 0.13], None,
               turned((1, 0.5, 0.4), 0.5))
    bench.body(mesh(tmp_path, "card", CARD_OBJ, (256, 600), 2), [0.1, 0.05, 0.02], None,
               turned((0.2, 0.3, 1), 0.6))
    bench.box([0.003, 0.25, 0.002], [0.1, 0.0, 0.2], "Gazebo/Green", turned((0.3, 0.2, 1), 0.9))


def needles(bench, tmp_path) -> None:
    """Ribbons of triangles that are a hundredth of a pixel wide, before and behind planks."""
    bench.box([0.5, 0.4, 0.02], [0, 0, -0.12], "Gazebo/White", turned((1, 0.3, 0.2), 0.1))
    lines = ["mtllib {0}.mtl", "usemtl {0}", "vn 0 0 1"]
    lines += [f"v {x:.5f} {y} 0" for x in np.linspace(-0.015, 0.015, 81) for y in (-0.1, 0.1)]
    for k in range(1, 160, 2):
        lines += [f"f {k}//1 {k + 2}//1 {k + 3}//1", f"f {k}//1 {k + 3}//1 {k + 1}//1"]
    ribbon = mesh(tmp_path, "ribbon", "\n".join(lines))
    for n, colour in enumerate(("Red", "Black", "Blue", "Red")):
        x, y = -0.2 + 0.12 * n, 0.04 * (-1) ** n
        bench.body(ribbon, [x, y, 0.05], f"Gazebo/{colour}", turned((0.1, 0.2, 1), 0.5 * n))
        bench.box([0.06, 0.02, 0.002], [x + 0.01, y, 0.05 + 0.06 * (-1) ** (n // 2)],
                  "Gazebo/White", turned((0.2, 0.1, 1), 0.4 * n))


def crumbs(bench, tmp_path) -> None:
    """Triangles smaller than a pixel, some pixels apart, before a plank."""
    rng = np.random.default_rng(8)
    bench.box([0.5, 0.4, 0.02], [0, 0, 0.0], "Gazebo/White", turned((1, 0.3, 0.2), 0.1))
    lines = ["mtllib {0}.mtl", "usemtl {0}", "vn 0 0 1"]
    for n, (i, j) in enumerate(np.ndindex(12, 12)):
        turns = rng.uniform(0.0, 2.0 * np.pi) + rng.uniform(-0.5, 0.5, 3) + [0.0, 2.1, 4.2]
        lines += [f"v {0.04 * i - 0.22 + 0.005 * np.cos(turn):.4f} "
                  f"{0.04 * j - 0.22 + 0.005 * np.sin(turn):.4f} 0" for turn in turns]
        lines.append("f " + " ".join(f"{3 * n + k}//1" for k in (1, 2, 3)))
    bench.body(mesh(tmp_path, "crumbs", "\n".join(lines)), [0.05, 0.0, 0.1], "Gazebo/Black",
               turned((1, 0.3, 0.2), 0.1))


SCENES = {"things": things, "painted": painted, "needles": needles, "crumbs": crumbs}
LENSES = {
    "pinhole": dict(camera_matrix=(31.0, 36.0, 19.3, 12.8)),
    "long": dict(camera_matrix=(90.0, 80.0, 17.3, 14.8)),
    "bent": dict(camera_matrix=(29.0, 32.0, 20.4, 13.1),
                 distortion_coefficients=(-0.3, 0.1, 0.01, -0.008, 0.0)),
    "wide": dict(lens="equidistant", horizontal_fov=2.4),
    "around": dict(lens="equidistant", horizontal_fov=3.8),
}
SUN = Lighting(direction=(-0.5, 0.4, -0.8))
LAMPS = (
    Light("b", "point", (0.5, -0.3, 0.7), diffuse=(0.3, 0.5, 0.4, 1.0), cast_shadows=True,
          attenuation_constant=0.7, attenuation_linear=0.4, attenuation_quadratic=0.3),
    Light("a", "directional", direction=(-0.5, 0.3, -0.9), diffuse=(0.4, 0.2, 0.3, 1.0),
          cast_shadows=True),
    Light("c", "spot", (0.1, -0.4, 0.6), direction=(-0.1, 0.6, -0.8), diffuse=(0.2, 0.3, 0.6, 1.0),
          spot_inner=0.3, spot_outer=0.9, spot_falloff=1.5, attenuation_range=0.8),
)
LIT = {
    "sun": SUN,
    "bright": Lighting(direction=(-0.5, 0.4, -0.8), ambient=0.7, diffuse=0.9, exposure="gazebo"),
    "hard": Lighting(lights=LAMPS, shadows="hard", tint=(1.0, 0.8, 0.6)),
    "soft": Lighting(lights=LAMPS, shadows="soft", tint=(1.0, 0.8, 0.6)),
    "sky": Lighting(direction=(-0.5, 0.4, -0.8), sky=True),
    "none": Lighting(lights=LAMPS, tint=(1.0, 0.8, 0.6), exposure="gazebo"),
}

# Grey levels, RMS, of pixels without edges, where they are rounded besides (0.3), and with them.
PLAIN = {"hard": 1.0, "soft": 1.0, "none": 1.3, "sky": 1.1}
EDGES = {"hard": 7.0, "soft": 4.0, "bright": 4.2, "none": 3.2}
MOST = {"hard": 60.0, "soft": 36.0, "none": 20.0}  # of single pixels with edges


def rms(x) -> float:
    return np.sqrt(np.square(x).mean())


def scene(bench, tmp_path, what, lens, lit, near=0.02, far=50.0, size=(43, 27), fine=1):
    """A sensor of a scene through a lens, and its view; fine: times as many pixels."""
    SCENES[what](bench, tmp_path)
    settings = {"width": round(fine * size[0]), "height": round(fine * size[1]), "near": near,
                "far": far, **LENSES[lens]}
    if "camera_matrix" in settings:
        settings["camera_matrix"] = tuple(fine * x for x in settings["camera_matrix"])
    sensor = CameraSensor(CameraConfig.from_mapping(settings),
                          create_renderer("exact", bench.world, LIT[lit]))
    return sensor, sensor.make_view(link_pose(looking(EYE, AT, (0.2, 0.1, 1.0))))


@pytest.mark.parametrize(("what", "lens", "lit", "near", "far"), [
    ("things", "pinhole", "sun", 0.02, 50.0), ("things", "bent", "sun", 0.02, 50.0),
    ("things", "wide", "sky", 0.02, 50.0), ("things", "pinhole", "sun", 0.75, 1.1),
    ("things", "pinhole", "hard", 0.02, 50.0), ("things", "bent", "soft", 0.02, 50.0),
    ("painted", "long", "sun", 0.02, 50.0), ("painted", "bent", "bright", 0.02, 50.0),
    ("painted", "long", "none", 0.02, 50.0),
])
def test_a_picture_is_what_rays_at_its_triangles_say(bench, tmp_path, what, lens, lit, near, far):
    size = (34, 39) if lit == "hard" else (43, 27)  # higher than wide
    sensor, view = scene(bench, tmp_path, what, lens, lit, near, far, size)
    caster, edges = Caster(sensor.renderer), resolved(sensor.renderer, view)
    picture = sensor.renderer.render(view)
    # Edges differ by what 64 rays leave open; a shadow's edge is in one sample of a fragment where
    # it is hard, and in few where it is soft.
    one = caster, sensor.config.projection, view, LIT[lit]
    places, shows = expected(*one, edges, 64)
    off = picture[edges] - places.mean(axis=0)
    assert rms(off) < EDGES.get(lit, 2.8)
    assert np.abs(off.mean(axis=0)).max() < 1.0 and np.abs(off).max() < MOST.get(lit, 28.0)
    plain, _ = expected(*one, ~edges, 64 if LIT[lit].lights else 16)
    assert rms(picture[~edges] - plain.mean(axis=0)) < PLAIN.get(lit, 0.65)
    # Nothing is cut into pieces that are alike; what one sees through is in all of its tile.
    glass = np.zeros(edges.shape, np.uint8)
    glass[edges] = (shows == -2).any(axis=0)
    glass = cv2.dilate(glass, np.ones((15, 15)))[edges] > 0
    alike = (np.ptp(places, axis=0) < 6.0).all(axis=1)
    assert (alike & ~glass).sum() < 20 or near > 0.1
    assert 0.08 < edges.mean() < 0.4


@pytest.mark.parametrize(("what", "lens", "most"), [
    ("crumbs", "long", 2.0), ("needles", "pinhole", 3.3)])
def test_what_is_thinner_than_a_pixel_is_drawn_as_rays_show_it(bench, tmp_path, what, lens, most):
    """RMS in grey levels; a crumb that is not found, and a needle that shines through, are more."""
    sensor, view = scene(bench, tmp_path, what, lens, "sun")
    some = np.random.default_rng(0).random((view.height, view.width)) < 0.5
    places, _ = expected(Caster(sensor.renderer), sensor.config.projection, view, SUN, some, 64)
    assert rms(sensor.renderer.render(view)[some] - places.mean(axis=0)) < most


@pytest.mark.parametrize(("lens", "near", "far"), [
    ("pinhole", 0.02, 50.0), ("pinhole", 0.75, 1.1), ("bent", 0.02, 50.0), ("wide", 0.02, 50.0),
    ("around", 1e-4, 50.0)])
def test_depth_and_body_are_those_of_the_nearest_triangle(bench, tmp_path, lens, near, far):
    sensor, view = scene(bench, tmp_path, "things", lens, "sun", near, far, fine=5)
    depth, label = sensor.renderer.measure(view)
    caster = Caster(sensor.renderer)
    v, u = (x.reshape(-1) for x in np.mgrid[:view.height, :view.width].astype(float))
    rays = sensor.config.projection.unproject(np.stack([u, v], axis=1))
    away, _, _, front = caster.seen(view, rays)
    away[:, caster.colours[front, 3] < 1.0] = np.inf
    nearest, far = front[away.argmin(axis=1)], away.min(axis=1)
    body = np.where(np.isfinite(far), caster.label[nearest], -1).reshape(depth.shape)
    # Lenses that see beside and behind themselves measure along the ray.
    far = (far * (1.0 if lens == "around" else rays[:, 2])).reshape(depth.shape)
    same = body == label
    few = max(5e-4 * depth.size, 2)  # within a misfit of an edge
    assert (~same).sum() < few and len(np.unique(label)) > 5
    seen = same & (label >= 0)
    assert (np.abs(depth[seen] - far[seen]) > 1e-6).sum() < few
    assert np.isinf(depth[label < 0]).all()


@pytest.mark.parametrize(("angle", "most"), [(0.0, 1.6), (60.0, 2.0), (80.0, 2.0), (87.0, 4.0)])
def test_a_texture_seen_aslant_is_the_mean_of_what_a_pixel_covers(bench, tmp_path, angle, most):
    """Squares of 8 texels, seen from several sides; degrees from the normal, RMS in grey levels."""
    card = mesh(tmp_path, "wall", CARD_OBJ, (512, 512))
    dark = np.random.default_rng(4).integers(0, 2, (64, 64))
    squares = np.kron(np.where(dark, 85, 171), np.ones((8, 8))).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "wall.png"), squares)
    bench.body(card, colour=None)
    light, angle = Lighting(ambient=1.0, diffuse=0.0), np.radians(angle)
    renderer = create_renderer("exact", bench.world, light)
    camera = CameraConfig.from_mapping({"camera_matrix": (300.0, 310.0, 161.3, 117.2)})
    some = np.random.default_rng(1).random((240, 320)) < (0.02 if angle > 1.5 else 0.008)
    for roll, up in ((0.0, (0, 1, 0.3)), (3.1, (0.5, 1, 0)), (-1.6, (1, 0.2, 0)), (2.4, (1, 1, 0))):
        away = np.sin(angle) * np.array([np.cos(roll), np.sin(roll), 0.0]) + [0, 0, np.cos(angle)]
        view = View(320, 240, looking(0.35 * away, [0.0, 0.0, 0.0], up), camera.K, 0.02)
        places, shows = expected(Caster(renderer), camera.projection, view, light, some, 256)
        off = (renderer.render(view)[some] - places.mean(axis=0))[(shows >= 0).all(axis=0)]
        assert len(off) > 20 and rms(off) <= most and abs(off.mean()) < 0.5
