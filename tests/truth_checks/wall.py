"""Textured wall, and its exact pixel values as means of many samples."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scenes import Bench

from aras_sim_bridge.description import Geometry
from aras_sim_bridge.rendering import View

SIDE = 2.0  # m
TEXELS = 512  # a side


def blocks(size: int, low: int = 85, high: int = 171, seed: int = 4) -> np.ndarray:
    """Return an image (TEXELS, TEXELS), uint8, of squares of `size` texels, dark or bright."""
    many = TEXELS // size
    chosen = np.random.default_rng(seed).integers(0, 2, (many, many))
    return np.kron(np.where(chosen, high, low), np.ones((size, size))).astype(np.uint8)


def wall(bench: Bench, folder: Path, pixels: np.ndarray) -> None:
    """A square in the plane z = 0, x and y within SIDE / 2, seen from z > 0, with a picture whose
    first row is at +y."""
    cv2.imwrite(str(folder / "wall.png"), pixels)
    (folder / "wall.mtl").write_text("newmtl wall\nKd 1 1 1\nmap_Kd wall.png\n")
    half = SIDE / 2
    (folder / "wall.obj").write_text(
        "mtllib wall.mtl\nusemtl wall\n"
        f"v {-half} {-half} 0\nv {half} {-half} 0\nv {half} {half} 0\nv {-half} {half} 0\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n")
    bench.body(Geometry("mesh", filename=str(folder / "wall.obj")), (0.0, 0.0, 0.0), None)


def shown(pixels: np.ndarray, view: View, at: np.ndarray, places: int = 24) -> np.ndarray:
    """(N,) grey levels of the pixels `at` (N, 2) u, v: the mean of places**2 places in each, nan
    where one of them is beyond the wall."""
    T, K = view.world_T_optical, view.K
    step = (np.arange(places) + 0.5) / places - 0.5
    down, right = (d.reshape(-1) for d in np.meshgrid(step, step, indexing="ij"))
    out = np.empty(len(at))
    for n, (u, v) in enumerate(at):
        rays = np.stack([(u + right - K[0, 2]) / K[0, 0], (v + down - K[1, 2]) / K[1, 1],
                         np.ones_like(right)])
        rays = T[:3, :3] @ rays
        far = -T[2, 3] / rays[2]
        spots = T[:2, 3, None] + far * rays[:2]
        if (far < 0.0).any() or (np.abs(spots) > SIDE / 2 - 2 * SIDE / TEXELS).any():
            out[n] = np.nan
            continue
        x = (spots[0] / SIDE + 0.5) * TEXELS - 0.5
        y = (0.5 - spots[1] / SIDE) * TEXELS - 0.5
        out[n] = cv2.remap(pixels.astype(np.float32), x[None].astype(np.float32),
                           y[None].astype(np.float32), cv2.INTER_LINEAR).mean()
    return out


def aslant(angle: float, roll: float, turn: float, distance: float = 1.0) -> np.ndarray:
    """(4, 4) world_T_optical of an eye that sees the wall's middle from `angle` beside its normal,
    towards the direction `roll` in the wall, turned by `turn` about its axis, rad."""
    towards = np.array([np.cos(roll), np.sin(roll), 0.0])
    eye = distance * (np.sin(angle) * towards + [0.0, 0.0, np.cos(angle)])
    z = -eye / distance
    y = np.cross(z, [-np.sin(roll), np.cos(roll), 0.0])
    x = np.cross(y, z)
    T = np.eye(4)
    T[:3, 0], T[:3, 1] = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    T[:3, 2], T[:3, 3] = z, eye
    return T


def errors(pixels: np.ndarray, view: View, picture: np.ndarray, many: int = 200) -> np.ndarray:
    """Return the differences between pixels of an image and their exact values, grey levels."""
    T = view.world_T_optical
    spots = np.random.default_rng(1).uniform(-0.45 * SIDE, 0.45 * SIDE, (many, 2))
    seen = (np.column_stack([spots, np.zeros(many)]) - T[:3, 3]) @ T[:3, :3] @ view.K.T
    at = np.rint(seen[seen[:, 2] > 0.0, :2] / seen[seen[:, 2] > 0.0, 2:]).astype(int)
    at = at[(at >= 0).all(axis=1) & (at < (view.width, view.height)).all(axis=1)]
    off = picture[at[:, 1], at[:, 0], 0] - shown(pixels, view, at)
    return off[np.isfinite(off)]
