"""Write the mesh of each robot link as binary STL to meshes/.

    python3 scripts/make_meshes.py [--out DIR]

The shapes are new and have the outer dimensions of the original links. The output is bit-identical
on every machine; a test compares it with the files in the repository. STL files contain no colours,
so PyBullet, rviz and the renderer of aras_sim_bridge use the colours of the URDF.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import arm_parts
import gantry_parts
import numpy as np
from mesh_primitives import on_grid

# For each link, the function of its name, which returns its parts in the frame of the link.
LINKS: dict[str, Callable[[], list[np.ndarray]]] = {
    make_parts.__name__: make_parts
    for make_parts in (
        gantry_parts.base_link, gantry_parts.slider, arm_parts.link0, arm_parts.link1,
        arm_parts.link2, arm_parts.link3, arm_parts.link5, arm_parts.link6,
    )
}  # fmt: skip

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def link_parts(link: str) -> list[np.ndarray]:
    """Return the parts of a link in the frame of the link, with all corners rounded to a grid.

    Each part is an array (n, 3, 3) of triangles, m.
    """
    return [on_grid(part) for part in LINKS[link]()]


def stl_bytes(parts: list[np.ndarray], title: str) -> bytes:
    """Return the parts as a binary STL, with a unit normal for each triangle."""
    triangles = np.concatenate(parts)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(len(triangles), _RECORD)
    # Normals are rounded, because the last bit of a square root can differ between machines, and
    # all machines must write the same file.
    records["normal"] = np.round(normals, 6) + 0.0
    records["corners"] = triangles
    header = title.encode("ascii").ljust(80, b" ")
    return header + np.uint32(len(triangles)).astype("<u4").tobytes() + records.tobytes()


def main() -> int:
    """Write all meshes; print one line for each file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: make_meshes.py --out /tmp/meshes")
    default = Path(__file__).resolve().parent.parent / "meshes"
    parser.add_argument("--out", type=Path, default=default, help="output folder")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    total = 0
    for link in LINKS:
        parts = link_parts(link)
        count = sum(len(part) for part in parts)
        total += count
        (folder / f"{link}.stl").write_bytes(stl_bytes(parts, f"ARAS visual servo robot: {link}"))
        print(f"{link}.stl: {count} triangles")
    print(f"total: {total} triangles")
    return 0


if __name__ == "__main__":
    sys.exit(main())
