"""Light and shadows of boxes, compared with ray casting."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
from scenes import Bench, looking
from scipy.stats import qmc

from aras_sim_bridge.description import Light
from aras_sim_bridge.rendering import Lighting, View, create_renderer

from .check import Row, check

_K = np.array([[210.0, 0.0, 80.3], [0.0, 205.0, 61.2], [0.0, 0.0, 1.0]])
_VIEW = View(160, 120, looking([0.25, -0.8, 0.7], [0.0, 0.0, 0.05]), _K)
_SUN_RADIUS, _LAMP_RADIUS = 0.03, 0.04  # docs/camera.md
_BOXES = [((-0.1, -0.05, 0.12), (0.08, 0.05, 0.12), 0.6),
          ((0.15, 0.1, 0.05), (0.05, 0.12, 0.05), -0.3),
          ((0.1, -0.15, 0.2), (0.15, 0.004, 0.004), 0.2)]
_LIGHTS = {
    "a sun": Light("a", "directional", direction=(-0.5, 0.3, -0.9), diffuse=(0.6, 0.5, 0.4, 1.0)),
    "a lamp": Light("b", "point", (0.4, -0.2, 0.6), diffuse=(0.3, 0.4, 0.6, 1.0),
                    attenuation_constant=0.6, attenuation_linear=0.5, attenuation_quadratic=0.3),
    "a spot": Light("c", "spot", (-0.3, -0.4, 0.7), (0.1, -0.2, 0.3), direction=(0.3, 0.4, -0.7),
                    diffuse=(0.6, 0.6, 0.5, 1.0), attenuation_constant=1.0, spot_inner=0.5,
                    attenuation_linear=0.1, spot_outer=0.9, spot_falloff=1.5),
}


def _shone(light: Light, p: np.ndarray, soft: bool, place: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray]:
    """Return the unshadowed light (N, 3) at horizontal points (N, 3), and rays (N, 3) to the light.
    """
    R = np.eye(3)
    if light.kind == "spot":
        roll, pitch, yaw = light.origin_rpy
        c, s = np.cos, np.sin
        R = (np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
             @ np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
             @ np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]]))
    along = R @ light.direction / np.linalg.norm(light.direction)
    if light.kind == "directional":
        to, left, radius = np.tile(-along, (len(p), 1)), np.ones(len(p)), _SUN_RADIUS
    else:
        to, radius = light.origin_xyz - p, _LAMP_RADIUS
        d = np.linalg.norm(to, axis=1)
        left = 1.0 / np.maximum(light.attenuation_constant + light.attenuation_linear * d
                                + light.attenuation_quadratic * d**2, 1.0)
        if light.kind == "spot":
            inner, outer = np.cos(light.spot_inner / 2), np.cos(light.spot_outer / 2)
            share = ((-to / d[:, None]) @ along - outer) / (inner - outer)
            left = left * np.clip(share, 0.0, 1.0) ** light.spot_falloff
    unit = to / np.linalg.norm(to, axis=1)[:, None]
    given = (left * np.maximum(unit[:, 2], 0.0))[:, None] * light.diffuse[:3]
    if soft:
        # A disc perpendicular to the ray.
        a = np.cross(unit, (0.0, 0.0, 1.0))
        a /= np.linalg.norm(a, axis=1)[:, None]
        r, angle = radius * np.sqrt(place[0]), 2.0 * np.pi * place[1]
        to = to + r * np.cos(angle) * a + r * np.sin(angle) * np.cross(unit, a)
    return given, to * (100.0 if light.kind == "directional" else 1.0)


def _boxed(p: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Return (N,) bool: True if a box is between a point and the end of its ray."""
    met = np.zeros(len(p), bool)
    for centre, half, turn in _BOXES:
        R = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        o, d = (p - centre) @ R.T, to @ R.T
        with np.errstate(all="ignore"):
            one, two = (-np.array(half) - o) / d, (np.array(half) - o) / d
        enter = np.minimum(one, two).max(axis=1)
        leave = np.maximum(one, two).min(axis=1)
        met |= (enter < leave) & (leave > 0.0) & (enter < 1.0)
    return met


def _expected(light: Light, soft: bool, places: int) -> tuple[np.ndarray, np.ndarray]:
    """Return grey levels (120, 160, 3) of the floor, NaN on boxes, and a mask of shadow edges."""
    sun = Lighting(lights=(light,))
    T, total, sharp = _VIEW.world_T_optical, 0.0, 0.0
    v, u = np.mgrid[:120, :160].astype(float)
    hidden = np.zeros(120 * 160, bool)
    for x, y, *place in qmc.Sobol(4, seed=3).random(places):
        du, dv = x - 0.5, y - 0.5
        rays = np.stack([(u + du - _K[0, 2]) / _K[0, 0], (v + dv - _K[1, 2]) / _K[1, 1],
                         np.ones_like(u)], axis=-1).reshape(-1, 3) @ T[:3, :3].T
        p = T[:3, 3] - T[2, 3] / rays[:, 2:] * rays
        hidden |= _boxed(np.tile(T[:3, 3], (len(p), 1)), p - T[:3, 3])
        given, to = _shone(light, p, soft, np.array(place))
        free = ~_boxed(p + [0.0, 0.0, 1e-9], to)
        total = total + sun.ambient_levels / sun.scale + given * free[:, None]
        sharp = sharp + free
    edge = (sharp > 0) & (sharp < places)
    expected = 255.0 * sun.scale * total / places
    expected[hidden] = np.nan
    return expected.reshape(120, 160, 3), edge.reshape(120, 160)


def compared(places: int) -> Iterator[tuple[str, float, float]]:
    """Yield name and rms errors, in grey levels, for each light with hard and with soft shadows."""
    with closing(Bench()) as bench:
        bench.box([2.0, 2.0, 0.05], [0, 0, -0.05])
        for centre, half, turn in _BOXES:
            bench.box(half, centre, "Gazebo/Red", (0, 0, np.sin(turn / 2), np.cos(turn / 2)))
        for name, light in _LIGHTS.items():
            light = replace(light, cast_shadows=True)
            for shadows in ("hard", "soft"):
                expected, edge = _expected(light, shadows == "soft", places)
                lit = Lighting(lights=(light,), shadows=shadows)
                off = create_renderer("exact", bench.world, lit).render(_VIEW) - expected
                known = np.isfinite(off).all(axis=2)
                if (known & edge).sum() < 100:
                    raise RuntimeError(f"{name}: {(known & edge).sum()} pixels of shadows' edges")
                at_edges, elsewhere = (
                    float(np.sqrt((off[known & part]**2).mean())) for part in (edge, ~edge))
                yield f"{name}, {shadows} shadows", at_edges, elsewhere


@check("ray casting")
def light_and_shadows() -> Iterator[Row]:
    """Compare a floor with three boxes in the light of a sun, a lamp and a spot (512 rays)."""
    for name, at_edges, elsewhere in compared(512):
        yield Row(f"{name}, at shadow edges", "equal", at_edges, 2.0, "grey levels RMS")
        yield Row(f"{name}, other pixels", "equal", elsewhere, 0.5, "grey levels RMS")
