"""Shapes on the graphics side, and the draw commands of what a set of faces can see."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import moderngl
import numpy as np

from . import clusters as clustering
from .compiled import compiled
from .faces import Faces
from .occluders import Backdrop
from .scene import Scene
from .visibility import Visibility

# One glMultiDrawElementsIndirect record: count, instances, first, base vertex, base instance.
COMMAND_WORDS = 5
# face_T_link rows, projection, placement, sun, label
INSTANCE_FLOATS = 12 + 4 + 4 + 3 + 1
TEXTURE_SIZE = 512


@dataclass(frozen=True)
class Shown:
    """What is drawn, and from where.

    triangle: (N,) triangles, each on the face (N,) given for it. Or both None, and everything in
        cluster (C,) is drawn on the only face.
    optical_T_link: (rows, 4, 4). sun: (rows, 3), unit vectors to the sun in link frames.
    background: (4,) rgba, 0..1, of what is not drawn.
    backdrop: the quad that fills the picture behind all that, or None. cut: whether something
        reaches through it and must be cut off there.
    """

    faces: Faces
    optical_T_link: np.ndarray  # noqa: N815 (a_T_b maps b to a)
    sun: np.ndarray
    background: np.ndarray
    triangle: np.ndarray | None = None
    face: np.ndarray | None = None
    cluster: np.ndarray | None = None
    backdrop: Backdrop | None = None
    cut: bool = False


class Geometry:
    """All shapes of a scene: vertices uploaded once, the triangles in view each time."""

    def __init__(self, ctx: moderngl.Context, scene: Scene) -> None:
        self._ctx = ctx
        files = sorted({p.mesh.texture for p in scene.parts if p.mesh.texture})
        self.clusters = c = clustering.build(scene.parts, files)
        transparent = np.array([p.rgba[3] < 1.0 for p in scene.parts], bool)
        self.visibility = Visibility(c, transparent)
        self.textures = _texture_array(ctx, files) if files else None
        self._transparent = transparent[c.part] if transparent.any() else None
        self._vertices = ctx.buffer(c.vertices.tobytes() or bytes(clustering.VERTEX.itemsize))
        self._all = ctx.buffer(c.indices.tobytes() or bytes(12))
        self._picked = ctx.buffer(reserve=max(12, c.indices.nbytes), dynamic=True)
        self._commands = ctx.buffer(reserve=64 * 4 * COMMAND_WORDS, dynamic=True)
        self._instances = ctx.buffer(reserve=64 * 4 * INSTANCE_FLOATS, dynamic=True)
        self._arrays: dict[tuple[moderngl.Program, bool], moderngl.VertexArray] = {}

    def draw(self, program: moderngl.Program, shown: Shown) -> None:
        """Draw with the program, into the framebuffer in use."""
        n, f = shown.faces.near, shown.faces.far
        program["depth_range"] = ((f + n) / (f - n), 2 * f * n / (f - n))
        if self.textures is not None:
            self.textures.use(0)
        self._ctx.front_face = "cw"  # the rows run downwards
        flags = self._ctx.DEPTH_TEST | self._ctx.CULL_FACE
        if self._transparent is None:
            self._draw(program, flags, shown, np.s_[:])
            return
        if shown.triangle is None:
            see_through = self._transparent[self.clusters.first[shown.cluster]]
        else:
            see_through = self._transparent[shown.triangle]
        for some, more in ((~see_through, 0), (see_through, self._ctx.BLEND)):
            self._draw(program, flags | more, shown, some)

    def _draw(self, program: moderngl.Program, flags: int, shown: Shown, some) -> None:
        """Draw some of what is shown, by a mask or slice of its triangles or clusters."""
        c = self.clusters
        if shown.triangle is None:
            cluster = shown.cluster[some]
            first, count, row = c.first[cluster], c.count[cluster], c.row[cluster]
            face = np.zeros(len(cluster), int)
        else:
            triangle, face = shown.triangle[some], shown.face[some]
            first, count = np.arange(len(triangle)), np.ones(len(triangle), int)
            row = c.tri_row[triangle]
            self._write(self._picked, c.indices[triangle])
        if not len(first):
            return
        faces = shown.faces
        commands, instances = _commands(
            first, count, row, face, shown.optical_T_link, faces.rotations,
            faces.projection, faces.placement, shown.sun,
        )
        self._write(self._commands, commands)
        self._write(self._instances, instances)
        self._ctx.enable_only(flags)
        self._array(program, shown.triangle is None).render_indirect(
            self._commands, self._ctx.TRIANGLES, len(commands)
        )

    def _write(self, buffer: moderngl.Buffer, data: np.ndarray) -> None:
        if data.nbytes > buffer.size:
            buffer.orphan(2 * data.nbytes)
        buffer.write(data)

    def _array(self, program: moderngl.Program, everything: bool) -> moderngl.VertexArray:
        if (program, everything) not in self._arrays:
            names = [("position", "3f4"), ("normal", "3f4"), ("rgba", "4f1"), ("uv", "3f4")]
            used = {m for m in program}
            layout = " ".join(f if n in used else _padding(f) for n, f in names)
            instance = [("row0", "4f4"), ("row1", "4f4"), ("row2", "4f4"),
                        ("projection", "4f4"), ("placement", "4f4"), ("sun", "3f4"),
                        ("label", "1f4")]
            instance_layout = " ".join(f if n in used else _padding(f) for n, f in instance)
            self._arrays[program, everything] = self._ctx.vertex_array(program, [
                (self._vertices, layout, *(n for n, _ in names if n in used)),
                (self._instances, instance_layout + "/i", *(n for n, _ in instance if n in used)),
            ], self._all if everything else self._picked)
        return self._arrays[program, everything]

    def release(self) -> None:
        for thing in (*self._arrays.values(), self._vertices, self._all, self._picked,
                      self._commands, self._instances, self.textures):
            if thing is not None:
                thing.release()


@compiled("i8[::1], i8[::1], i8[::1], i8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], "
          "f8[:,::1]")
def _commands(first, count, row, face, T, rotation, projection, placement, sun):
    """A draw command (M, 5) and an instance (M, INSTANCE_FLOATS) for each stretch of triangles that
    follow each other in the index buffer, on one link and one face.

    first, count, row, face: (N,) of pieces. rotation: (F, 3, 3), or one for all faces.
    """
    commands = np.empty((len(first), COMMAND_WORDS), np.uint32)
    instances = np.empty((len(first), INSTANCE_FLOATS), np.float32)
    made = 0
    end = np.int64(-1)
    for n in range(len(first)):
        r, f = row[n], face[n]
        if n and first[n] == end and r == row[n - 1] and f == face[n - 1]:
            commands[made - 1, 0] += 3 * count[n]
        else:
            commands[made] = 3 * count[n], 1, 3 * first[n], 0, made
            turn, one = rotation[f % len(rotation)], instances[made]
            for j in range(3):
                for k in range(4):
                    one[4 * j + k] = (turn[j, 0] * T[r, 0, k] + turn[j, 1] * T[r, 1, k]
                                      + turn[j, 2] * T[r, 2, k])
            one[12:16] = projection[f]
            one[16:20] = placement[f]
            one[20:23] = sun[r]
            one[23] = r + 1
            made += 1
        end = first[n] + count[n]
    return commands[:made], instances[:made]


def _padding(layout: str) -> str:
    return f"{int(layout[0]) * int(layout[2])}x"


def _texture_array(ctx: moderngl.Context, files: list[str]) -> moderngl.TextureArray:
    """All textures at one size, in layers; v runs upwards, as in OBJ files."""
    layers = []
    for file in files:
        bgr = cv2.imread(file, cv2.IMREAD_COLOR)
        if bgr is None:
            bgr = np.full((1, 1, 3), 255, np.uint8)
        rgb = cv2.resize(bgr, (TEXTURE_SIZE, TEXTURE_SIZE), interpolation=cv2.INTER_AREA)
        layers.append(cv2.cvtColor(rgb, cv2.COLOR_BGR2RGB)[::-1])
    data = np.ascontiguousarray(np.stack(layers))
    array = ctx.texture_array((TEXTURE_SIZE, TEXTURE_SIZE, len(files)), 3, data.tobytes())
    array.build_mipmaps()
    array.filter = (ctx.LINEAR_MIPMAP_LINEAR, ctx.LINEAR)
    return array
