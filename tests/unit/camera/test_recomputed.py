"""Pictures against rays cast at each triangle, 64 in a pixel: what is drawn, cut to near and far,
mixed through glass, lit, shaded and in shadow is worked out here by other code.

The pictures are small and show little, but all of it is tilted, and the camera's centre is aside.
"""

from __future__ import annotations

import numpy as np
import pytest
from scenes import link_pose, looking
from scipy.stats import qmc

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import Geometry, Light
from aras_sim_bridge.rendering import Sun, create_renderer

PLACES = qmc.Sobol(4, seed=3).random(64)  # in a pixel, and on a light's disc
SUN_RADIUS, LAMP_RADIUS = 0.03, 0.04  # docs/camera.md
EYE, AT = [0.5, -0.7, 0.6], [0.05, 0.0, 0.08]


class Caster:
    """All triangles of a renderer's scene, in the world."""

    def __init__(self, renderer) -> None:
        renderer.scene.refresh()
        poses = renderer.scene.poses()
        corners, normals, colours, parts = [], [], [], []
        for n, part in enumerate(renderer.scene.parts):
            T, mesh = poses[part.row], part.mesh
            own = mesh.positions[mesh.triangles].astype(float)
            corners.append(own @ T[:3, :3].T + T[:3, 3])
            normals.append(mesh.normals[mesh.triangles].astype(float) @ T[:3, :3].T)
            colours.append(np.tile(part.rgba, (len(own), 1)))
            parts.append(np.full(len(own), n))
        self.corners, self.normals, self.colours, self.part = map(
            np.concatenate, (corners, normals, colours, parts))
        a = self.corners[:, 0]
        self.e1, self.e2 = self.corners[:, 1] - a, self.corners[:, 2] - a
        self.normal = np.cross(self.e1, self.e2)

    def meet(self, start, way):
        """How rays from start (3,) or (N, 3) along way (N, 3) meet each triangle (N, T): distance
        in lengths of way, inf where they do not; shares of its second and third corner; whether
        from the front. By Cramer's rule."""
        a = self.corners[:, 0]
        det = -(way @ self.normal.T)
        moment = np.cross(start, way)
        with np.errstate(all="ignore"):
            far = (start @ self.normal.T - (a * self.normal).sum(axis=1)) / det
            u = (moment @ self.e2.T - way @ np.cross(self.e2, a).T) / det
            v = (way @ np.cross(self.e1, a).T - moment @ self.e1.T) / det
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (far > 0.0)
        return np.where(hit, far, np.inf), u, v, det > 0.0

    def shadowed(self, start, way, own):
        """(N,) whether anything is between start (N, 3) and start + way; not of the part own (N,),
        for each is convex, and not glass."""
        far = self.meet(start, way)[0]
        casts = (self.colours[:, 3] >= 1.0) & (self.part != own[:, None])
        return ((far < 1.0) & casts).any(axis=1)


def sunlit(light: Sun, normals, share, n) -> np.ndarray:
    """(N, 1) light between the corners of triangles n (N,)."""
    to = -np.array(light.direction) / np.linalg.norm(light.direction)
    at = light.ambient + light.diffuse * np.maximum(normals[n] @ to, 0.0)
    return (at * share).sum(axis=1)[:, None]


def lamplit(light: Sun, caster: Caster, points, share, n, disc) -> np.ndarray:
    """(N, 3) light at points by lamps that cast shadows. disc (2,): 0..1, a place on each."""
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
        cosine = (normal * unit).sum(axis=1)
        if light.shadows == "soft":
            across = np.cross(unit, (0.1, 0.2, 0.97))
            across /= np.linalg.norm(across, axis=1)[:, None]
            r, angle = radius * np.sqrt(disc[0]), 2.0 * np.pi * disc[1]
            to = to + r * (np.cos(angle) * across + np.sin(angle) * np.cross(unit, across))
        lit = (cosine > 0.0) & (left > 0.0)
        if light.shadows != "none":
            lit &= ~caster.shadowed(points, reach * to, caster.part[n])
        total += (lit * left * cosine)[:, None] * lamp.diffuse[:3]
    return total


def expected(sensor: CameraSensor, view, light: Sun) -> np.ndarray:
    """(places, height, width, 3) grey levels of each place in each pixel."""
    caster, model = Caster(sensor.renderer), sensor.config.model
    v, u = (x.reshape(-1) for x in np.mgrid[:view.height, :view.width].astype(float))
    T = view.world_T_optical
    background = 255.0 * np.array(light.background[:3])
    out = []
    for du, dv, *disc in PLACES:
        rays = model.unproject(np.stack([u + du - 0.5, v + dv - 0.5], axis=1))
        far, second, third, front = caster.meet(T[:3, 3], rays @ T[:3, :3].T)
        ahead = far * rays[:, 2:]
        far = np.where(front & (ahead >= view.near) & (ahead <= view.far), far, np.inf)
        colour = np.tile(background, (len(rays), 1))
        # From far to near; opaque things hide, glass mixes.
        order = np.argsort(-far, axis=1)
        opaque = np.where(caster.colours[:, 3] >= 1.0, far, np.inf).min(axis=1)
        for k in range(len(caster.part)):
            n = order[:, k]
            at = far[np.arange(len(n)), n]
            there = np.flatnonzero(np.isfinite(at) & (at <= opaque))
            if not len(there):
                continue
            n = n[there]
            b, c = second[there, n], third[there, n]
            share = np.stack([1.0 - b - c, b, c], axis=1)
            if light.lights:
                points = T[:3, 3] + (at[there, None] * rays[there]) @ T[:3, :3].T
                lit = lamplit(light, caster, points, share, n, disc)
            else:
                lit = sunlit(light, caster.normals, share, n)
            shown = np.minimum(255.0 * light.scale * caster.colours[n, :3] * lit, 255.0)
            alpha = caster.colours[n, 3:]
            colour[there] += alpha * (shown - colour[there])
        out.append(colour)
    return np.array(out).reshape(len(PLACES), view.height, view.width, 3)


DIAMOND_OBJ = """v 0.09 0 0.02\nv -0.08 0.01 0\nv 0 0.1 0\nv 0.01 -0.07 0\nv 0 0 0.12\nv 0 0.01 -0.1
vn 1 0 0.2\nvn -1 0.1 0\nvn 0 1 0\nvn 0.1 -1 0\nvn 0 0 1\nvn 0 0.1 -1
f 1//1 3//3 5//5\nf 3//3 2//2 5//5\nf 2//2 4//4 5//5\nf 4//4 1//1 5//5
f 3//3 1//1 6//6\nf 2//2 3//3 6//6\nf 4//4 2//2 6//6\nf 1//1 4//4 6//6
"""


def turned(axis, angle) -> tuple[float, ...]:
    """A unit quaternion xyzw."""
    axis = np.array(axis) / np.linalg.norm(axis)
    return (*(np.sin(angle / 2) * axis), np.cos(angle / 2))


def things(bench, tmp_path) -> None:
    """On a tilted floor two boxes through each other, a smooth solid and a wire, before all of them
    a pane of glass."""
    (tmp_path / "diamond.obj").write_text(DIAMOND_OBJ)
    bench.box([0.5, 0.4, 0.02], [0, 0, -0.02], "Gazebo/White", turned((1, 0.3, 0.2), 0.1))
    bench.box([0.12, 0.05, 0.08], [-0.1, 0.05, 0.1], "Gazebo/Red", turned((0.2, 0.3, 1), 0.6))
    bench.box([0.05, 0.14, 0.04], [-0.07, 0.02, 0.12], "Gazebo/Blue", turned((0.5, 1, 0.1), 0.4))
    bench.body(Geometry("mesh", filename=str(tmp_path / "diamond.obj")), [0.18, -0.1, 0.16],
               "Gazebo/Yellow", turned((1, 0.5, 0.4), 0.5))
    bench.box([0.003, 0.25, 0.002], [0.1, 0.0, 0.3], "Gazebo/Green", turned((0.3, 0.2, 1), 0.9))
    bench.box([0.1, 0.003, 0.07], [0.12, -0.3, 0.3], "Gazebo/GreyTransparent",
              turned((0.2, 0.1, 1), 0.3))


LENSES = {
    "pinhole": dict(camera_matrix=(31.0, 36.0, 19.3, 12.8)),
    "bent": dict(camera_matrix=(29.0, 32.0, 20.4, 13.1),
                 distortion_coefficients=(-0.3, 0.1, 0.01, -0.008, 0.0)),
    "wide": dict(lens="equidistant", horizontal_fov=2.4),
}
SUN = Sun(direction=(-0.5, 0.4, -0.8))
LAMPS = (
    Light("a", "directional", direction=(-0.5, 0.3, -0.9), diffuse=(0.4, 0.2, 0.3, 1.0),
          cast_shadows=True),
    Light("b", "point", (0.5, -0.3, 0.7), diffuse=(0.3, 0.5, 0.4, 1.0), cast_shadows=True,
          attenuation_constant=0.7, attenuation_linear=0.4, attenuation_quadratic=0.3),
)
LIT = {
    "sun": SUN,
    "hard": Sun(lights=LAMPS, shadows="hard", tint=(1.0, 0.8, 0.6)),
    "soft": Sun(lights=LAMPS, shadows="soft", tint=(1.0, 0.8, 0.6)),
}

RMS = {"sun": 1.5, "hard": 5.0, "soft": 3.5}  # grey levels


@pytest.mark.parametrize(("lens", "lit", "near", "far"), [
    ("pinhole", "sun", 0.02, 50.0), ("bent", "sun", 0.02, 50.0), ("wide", "sun", 0.02, 50.0),
    ("pinhole", "sun", 0.75, 1.1), ("pinhole", "hard", 0.02, 50.0), ("bent", "soft", 0.02, 50.0),
])
def test_a_picture_is_what_rays_at_its_triangles_say(bench, tmp_path, lens, lit, near, far):
    things(bench, tmp_path)
    light = LIT[lit]
    settings = {"width": 40, "height": 26, "near": near, "far": far, **LENSES[lens]}
    sensor = CameraSensor(CameraConfig.from_mapping(settings),
                          create_renderer("exact", bench.world, light))
    view = sensor._view(link_pose(looking(EYE, AT, (0.2, 0.1, 1.0))))
    places = expected(sensor, view, light)
    off = sensor.renderer.render(view) - places.mean(axis=0)
    whole = (np.ptp(places, axis=0) < 6.0).all(axis=2)
    # A pixel's level is the mean of its rays, so edges differ by what 64 of them leave open; a
    # shadow's edge is in one sample of a pixel where it is hard, and in few where it is soft.
    assert np.sqrt((off**2).mean()) < RMS[lit]
    assert abs(off[whole]).max() < 10.0 and whole.mean() > 0.75
    assert np.abs(off[~whole].mean(axis=0)).max() < 1.0
