"""Indexed triangle meshes, and their construction from separate triangles."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from ..errors import DescriptionError
from ..image_files import read_image_size
from ..urdf import Rgba

# Largest number of triangles in a mesh file. With 300 000 triangles, reading an STL file takes 3 s,
# and simulated time stops for another 3 s while Bullet and the renderer load the mesh.
MOST_TRIANGLES = 300_000
MOST_MESHES = 10_000  # largest number of meshes in a mesh file
GREY: Rgba = (0.7, 0.7, 0.7, 1.0)  # colour of surfaces whose material or texture is missing
# Adjacent faces whose normals differ by less than this angle are shaded as one smooth surface.
CREASE_ANGLE = np.radians(35.0)
# A vertex with more faces than this, such as the tip of a cone, is not smoothed. The time for
# smoothing increases with the square of the number of faces.
_MOST_CORNERS = 128
_LARGEST_COORDINATE = 1e9  # largest number in a mesh file, in any unit
# A triangle is dropped if its doubled area is smaller than this, in the squared length unit of the
# mesh file.
_LEAST_AREA = 1e-18
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Mesh:
    """Triangles with a colour or a texture. Lengths are in m, or in the unit of the mesh file.

    Attributes:
        positions: (V, 3) float32, positions of the vertices.
        normals: (V, 3) float32, unit normals at the vertices.
        triangles: (T, 3) int32, vertices of each triangle, counter-clockwise from outside.
        uv: (V, 2) float32, texture coordinates of the vertices, with v upwards; None without
            texture.
        texture: image file of the texture; None without texture.
        rgba: colour of the material; None if the material has none.
        piece: number of the collision body to which the mesh belongs. All meshes of a file with the
            same number form one body. In an OBJ file, each group has its own number.
        name: name of the mesh in its file: the node in a COLLADA or glTF file, the group or object
            in an OBJ file.
    """

    positions: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray | None = None
    texture: str | None = None
    rgba: Rgba | None = None
    piece: int = 0
    name: str = ""

    @property
    def nbytes(self) -> int:
        """Memory of the arrays in bytes."""
        arrays = (self.positions, self.normals, self.triangles, self.uv)
        return sum(array.nbytes for array in arrays if array is not None)

    def transform(self, a_T_b: np.ndarray, scale: np.ndarray | float = 1.0) -> Mesh:
        """Return a copy in frame a of this mesh in frame b.

        Args:
            a_T_b: (4, 4) pose of frame b in frame a.
            scale: factor, or factors along x, y, z, by which the mesh is scaled first, in frame b.
        """
        scale = np.broadcast_to(np.asarray(scale, dtype=float), (3,))
        positions = (self.positions * scale) @ a_T_b[:3, :3].T + a_T_b[:3, 3]
        normals = normalise((self.normals / scale) @ a_T_b[:3, :3].T)
        triangles = self.triangles[:, ::-1] if np.prod(scale) < 0 else self.triangles
        return replace(self, positions=positions.astype(np.float32),
                       normals=normals.astype(np.float32), triangles=triangles)

    def apply_texture(self, texture: str, box_mapping: bool) -> Mesh:
        """Return a copy of the mesh with a texture.

        If `box_mapping`, each side of a box shows the whole image, upright on vertical sides.
        Otherwise, the texture coordinates of the mesh are used; a mesh without texture coordinates
        is returned unchanged.
        """
        if not box_mapping:
            return self if self.uv is None else replace(self, texture=texture)
        low = self.positions.min(axis=0)
        share = (self.positions - low) / np.maximum(self.positions.max(axis=0) - low, 1e-12)
        axis = np.abs(self.normals).argmax(axis=1)
        sign = np.take_along_axis(self.normals, axis[:, None], axis=1)[:, 0] > 0.0
        across = np.where(axis == 0, share[:, 1], share[:, 0])
        # flip `across` on those sides of the box where the image would be mirrored
        across = np.where(sign == (axis == 1), 1.0 - across, across)
        up = np.where(axis == 2, share[:, 1], share[:, 2])
        return replace(self, uv=np.stack([across, up], axis=1).astype(np.float32), texture=texture)

    def apply_affine(self, a_T_b: np.ndarray) -> Mesh:
        """Return a copy that is transformed from b to a by any affine transform a_T_b (4, 4)."""
        turn = a_T_b[:3, :3]
        check_reach(a_T_b, "transform")
        check_reach(self.positions @ turn.T + a_T_b[:3, 3], "position")
        flat = abs(np.linalg.det(turn)) < 1e-30  # a singular transform makes normals undefined
        normals = self.normals if flat else normalise(self.normals @ np.linalg.inv(turn))
        mirrored = np.linalg.det(turn) < 0.0
        return replace(
            self, positions=(self.positions @ turn.T + a_T_b[:3, 3]).astype(np.float32),
            normals=normals.astype(np.float32),
            triangles=self.triangles[:, ::-1] if mirrored else self.triangles)

    def contains(self, point: np.ndarray) -> bool:
        """Return whether a point (3,) is inside this mesh, which must be closed.

        A ray from a point inside crosses the surface an odd number of times.
        """
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        if (point < low).any() or (point > high).any():
            return False
        # direction of a ray from the point; typical objects have no edge parallel to it
        direction = np.array([0.5773, 0.5411, 0.6119])
        a, b, c = self.positions[self.triangles].astype(float).transpose(1, 0, 2)
        e1, e2, to = b - a, c - a, point - a
        p = np.cross(direction, e2)
        det = (e1 * p).sum(axis=1)
        det = np.where(np.abs(det) > 1e-18, det, np.inf)
        u = (to * p).sum(axis=1) / det
        q = np.cross(to, e1)
        v = q @ direction / det
        t = (e2 * q).sum(axis=1) / det
        hits = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        return bool(np.count_nonzero(hits) % 2)


def normalise(v: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) scaled to length 1; zero vectors remain zero."""
    norm = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, norm, out=np.zeros_like(v, dtype=float), where=norm > 1e-20)


def from_corners(corners: np.ndarray) -> Mesh:
    """Make a mesh of triangles (T, 3, 3).

    The normals at a vertex are averaged over faces whose normals differ by less than CREASE_ANGLE.
    Triangles without area are dropped.

    Raises:
        DescriptionError: a coordinate is too large, or no triangle has an area.
    """
    corners = np.asarray(corners, dtype=float).reshape(-1, 3, 3)
    check_reach(corners, "corner")
    cross = _compute_crosses(corners)
    keep = np.linalg.norm(cross, axis=1) > _LEAST_AREA
    corners, cross = corners[keep], cross[keep]
    flat = corners.reshape(-1, 3)
    size = np.ptp(flat, axis=0).max() or 1.0
    _, point = _find_unique_rows(np.round(flat / (size * 1e-6)).astype(np.int64))
    normals = _smooth(point, np.repeat(cross, 3, axis=0),
                      np.repeat(normalise(cross), 3, axis=0), np.cos(CREASE_ANGLE))
    key = np.concatenate([point[:, None], np.round(normals * 1e4).astype(np.int64)], axis=1)
    first, inverse = _find_unique_rows(key)
    return Mesh(flat[first].astype(np.float32), normals[first].astype(np.float32),
                inverse.reshape(-1, 3).astype(np.int32))


def from_indices(index: np.ndarray, v: np.ndarray, vt: np.ndarray, vn: np.ndarray,
                 rgba: Rgba | None, texture: str | None, piece: int = 0) -> Mesh:
    """Make a mesh from separate lists of positions, texture coordinates and normals.

    Missing normals are computed. A texture without texture coordinates is ignored.

    Args:
        index: (T, 3, 3) for each corner of each triangle, its indices in v, vt and vn; -1 for a
            missing index.
        v: (V, 3) positions.
        vt: (., 2) texture coordinates.
        vn: (., 3) normals.
        rgba, texture, piece: attributes of the mesh.

    Raises:
        DescriptionError: an index is out of range, a number is too large, no triangle has an area,
            or the texture is too large to be decoded.
    """
    named = ("position", "texture coordinate", "normal")
    for part, (what, values) in enumerate(zip(named, (v, vt, vn), strict=True)):
        numbers = index[..., part]
        wrong = (numbers >= len(values)) | (numbers < (0 if part == 0 else -1))
        if wrong.any():
            raise DescriptionError(
                f"a face refers to {what} {numbers[wrong][0]}, but there are {len(values)} {what}s"
            )
        check_reach(values[numbers[numbers >= 0]], what)
    mapped = bool(len(vt)) and (index[..., 1] >= 0).all()
    textured = texture is not None and mapped
    if textured:
        # if the texture is too large, raise the error now, and not when it is rendered
        read_image_size(texture)
    else:
        texture = None
    given = len(vn) and (index[..., 2] >= 0).all()
    if not given and not textured:
        return replace(from_corners(v[index[..., 0]]), rgba=rgba, piece=piece)
    faces = _compute_crosses(v[index[..., 0]])
    key, inverse = _find_unique_rows(index.reshape(-1, 3))
    key = index.reshape(-1, 3)[key]
    positions = v[key[:, 0]]
    triangles = inverse.reshape(-1, 3)
    if given:
        normals = vn[key[:, 2]]
    else:
        normals = np.zeros_like(positions)
        np.add.at(normals, triangles.reshape(-1), np.repeat(faces, 3, axis=0))
    uv = vt[key[:, 1], :2].astype(np.float32) if mapped else None
    return Mesh(positions.astype(np.float32), normalise(normals).astype(np.float32),
                triangles.astype(np.int32), uv, texture, rgba, piece)


def check_size(triangles: int, meshes: int = 1) -> None:
    """Check that a mesh file does not contain too many triangles, groups and materials.

    Raises:
        DescriptionError: there are too many.
    """
    for what, count, most in (("triangles", triangles, MOST_TRIANGLES),
                              ("groups and materials", meshes, MOST_MESHES)):
        if count > most:
            raise DescriptionError(f"the file has {count} {what}, more than the limit of {most}",
                                   "simplify it")


def find_texture(folder: Path, name: str, what: str) -> str | None:
    """Return the path of a material's texture. If it is missing, log this and return None.

    As in Gazebo, the file may also be in the folder materials/textures of the model. The model in
    model://MODEL/PATH is next to the model of the mesh file. A path from another computer, such as
    C:\\work\\a.png, is replaced by its last part.

    Args:
        folder: folder of the mesh file.
        name: path or URI of the texture in the mesh file.
        what: name of the material in the log message.
    """
    path = unquote(name.removeprefix("file://")).replace("\\", "/")
    last = path.rpartition("/")[2]
    textures = folder.parent / "materials" / "textures"
    if path.startswith("model:"):
        path = f"../../{path.removeprefix('model:').lstrip('/')}"
    for file in (folder / name, folder / path, textures / path, folder / last, textures / last):
        if file.is_file():
            return str(file)
    _log.warning("%s is drawn grey: there is no %s, and no %s", what, folder / name,
                 textures / last)
    return None


def check_reach(values: np.ndarray, what: str) -> None:
    """Check that numbers are finite, and small enough for single precision.

    Raises:
        DescriptionError: a number is not finite or too large.
    """
    reach = np.abs(values).max(initial=0.0)
    if not reach <= _LARGEST_COORDINATE:
        far = f"{reach:.3g}, above {_LARGEST_COORDINATE:g}" if np.isfinite(reach) else "not finite"
        raise DescriptionError(f"a {what} is {far}")


def _compute_crosses(corners: np.ndarray) -> np.ndarray:
    """Return the normal (T, 3) of each triangle (T, 3, 3), scaled to twice the triangle's area."""
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if not (np.linalg.norm(crosses, axis=1) > _LEAST_AREA).any():
        raise DescriptionError("the file has no triangle with an area")
    return crosses


def _find_unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the unique rows of an array of integers (N, columns).

    The result is that of np.unique(axis=0), but is computed faster, because each row is packed into
    one number.

    Returns:
        The index in `rows` of the first occurrence of each unique row; and for each of the N rows,
        the index of its unique row.
    """
    key = np.zeros(len(rows), np.int64)
    room = 1
    for column in rows.T:
        low = column.min()
        span = int(column.max() - low) + 1
        if room * span >= 2**62:
            _, key = np.unique(key, return_inverse=True)
            room = len(rows)
        key = key * span + (column - low)
        room *= span
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return first, inverse


def _smooth(point: np.ndarray, weighted: np.ndarray, unit: np.ndarray, cosine: float) -> np.ndarray:
    """Compute a smooth normal at each of n corners of triangles.

    Each corner belongs to one face. Its smooth normal is the mean of the normals, weighted by area,
    of those faces at the same vertex whose normals differ from its own face's normal by at most the
    crease angle.

    Args:
        point: (n,) number of the vertex of each corner.
        weighted: (n, 3) normal of the corner's face, scaled to twice the area of the face.
        unit: (n, 3) unit normal of the corner's face.
        cosine: cosine of the crease angle.

    Returns:
        (n, 3) unit normals.
    """
    order = np.argsort(point, kind="stable")
    counts = np.bincount(point)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    start, count = starts[point[order]], counts[point[order]]
    rank = np.arange(len(order)) - start
    total = np.zeros_like(weighted)
    crowded = count > _MOST_CORNERS
    total[order[crowded]] = weighted[order[crowded]]
    count = np.where(crowded, 0, count)
    # At each vertex, compare the face of every corner with the face of every other corner.
    for shift in range(int(count.max())):
        some = np.flatnonzero(count > shift)
        corner = order[some]
        other = order[start[some] + (rank[some] + shift) % count[some]]
        near = (unit[corner] * unit[other]).sum(axis=1) >= cosine
        total[corner] += np.where(near[:, None], weighted[other], 0.0)
    return normalise(total)
