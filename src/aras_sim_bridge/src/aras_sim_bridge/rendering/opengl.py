"""Renderer on OpenGL 3.3 through EGL: no display needed, a GPU where there is one."""

from __future__ import annotations

import cv2
import numpy as np

from ..errors import RenderingError
from . import clusters as clustering
from . import shaders
from .scene import Scene
from .view import Light, MaterialTable, View

DEFAULT_SAMPLES = 4
# One glMultiDrawElementsIndirect record.
COMMAND = np.dtype([("count", "<u4"), ("instances", "<u4"), ("first", "<u4"),
                    ("base_vertex", "<i4"), ("base_instance", "<u4")])


class OpenGLRenderer:
    """Draws with moderngl. Meshes are uploaded once, poses and the list of visible clusters
    each frame, and one buffer is read back."""

    name = "opengl"

    def __init__(
        self, client: int, materials: MaterialTable, light: Light, samples: int | None = None
    ) -> None:
        self.reason = ""
        self.scene = Scene(client, materials)
        self.light = light
        self._ctx = _context()
        self.samples = DEFAULT_SAMPLES if samples is None else samples
        if self.samples > self._ctx.max_samples or self.samples < 1:
            self.close()
            raise RenderingError(
                f"{samples} samples a pixel are not offered; choose 1 to {self._ctx.max_samples}"
            )
        self._program = self._ctx.program(
            vertex_shader=shaders.MESH_VERTEX, fragment_shader=shaders.MESH_FRAGMENT
        )
        self._targets: dict[tuple[int, int], _Target] = {}
        self._geometry: _Geometry | None = None

    def snapshot(self) -> None:
        self.scene.snapshot()

    def forget(self) -> None:
        self.scene.forget()

    def close(self) -> None:
        if self._ctx is not None:
            self._ctx.release()
            self._ctx = None

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        if self._ctx is None:
            raise RenderingError("the renderer is closed")
        if self.scene.refresh() or self._geometry is None:
            self._upload()
        target = self._target(view.width, view.height)
        target.draw.use()
        target.draw.clear(*self.light.background)
        self._draw(view, self.scene.poses_at(blend))
        return target.read(self._ctx)

    def _upload(self) -> None:
        if self._geometry is not None:
            self._geometry.release()
        self._geometry = _Geometry(self._ctx, self._program, self.scene)

    def _target(self, width: int, height: int) -> _Target:
        key = (width, height)
        if key not in self._targets:
            self._targets[key] = _Target(self._ctx, width, height, self.samples)
        return self._targets[key]

    def _draw(self, view: View, world_T_link: np.ndarray) -> None:
        geometry = self._geometry
        if not len(world_T_link):
            return
        optical_T_world = np.linalg.inv(view.world_T_optical)
        optical_T_link = optical_T_world @ world_T_link
        chosen = geometry.visible(optical_T_link, view)
        count = geometry.set_commands(chosen)
        if not count:
            return
        geometry.instances.write(np.ascontiguousarray(optical_T_link[:, :3, :], dtype="f4"))
        w, h, K = view.width, view.height, view.K
        n, f = view.near, view.far
        program = self._program
        program["projection"] = (2 * K[0, 0] / w, (2 * K[0, 2] + 1) / w - 1,
                                 2 * K[1, 1] / h, (2 * K[1, 2] + 1) / h - 1)
        program["depth_range"] = ((f + n) / (f - n), 2 * f * n / (f - n))
        program["to_sun"] = tuple(optical_T_world[:3, :3] @ self.light.to_sun)
        program["light"] = (self.light.ambient, self.light.diffuse)
        ctx = self._ctx
        ctx.enable_only(ctx.DEPTH_TEST | ctx.CULL_FACE)
        ctx.front_face = "cw"  # the rows run downwards
        geometry.vao.render_indirect(geometry.commands, ctx.TRIANGLES, count)


class _Geometry:
    """All shapes on the graphics side, and which clusters of them a view can see."""

    def __init__(self, ctx, program, scene: Scene) -> None:
        self.clusters = c = clustering.build(scene.parts, [])
        rows = max(1, len(scene.poses()))
        self.instances = ctx.buffer(reserve=rows * 48, dynamic=True)
        self.commands = ctx.buffer(reserve=max(1, len(c.first)) * COMMAND.itemsize, dynamic=True)
        self._vertices = ctx.buffer(c.vertices.tobytes() or bytes(clustering.VERTEX.itemsize))
        self._indices = ctx.buffer(c.indices.tobytes() or bytes(12))
        self.vao = ctx.vertex_array(program, [
            (self._vertices, "3f4 3f4 4f1 8x", "position", "normal", "rgba"),
            (self.instances, "4f4 4f4 4f4/i", "row0", "row1", "row2"),
        ], self._indices)

    def visible(self, optical_T_link: np.ndarray, view: View) -> np.ndarray:
        """Indices of the clusters that may be seen, ascending."""
        c = self.clusters
        T = optical_T_link[c.row]
        centre = np.einsum("nij,nj->ni", T[:, :3, :3], c.centre) + T[:, :3, 3]
        K, w, h = view.K, view.width, view.height
        left, right = (K[0, 2] + 0.5) / K[0, 0], (w - 0.5 - K[0, 2]) / K[0, 0]
        top, bottom = (K[1, 2] + 0.5) / K[1, 1], (h - 0.5 - K[1, 2]) / K[1, 1]
        x, y, z = centre.T
        r = c.radius
        inside = (z + r > view.near) & (z - r < view.far)
        inside &= x + left * z > -r * np.hypot(1.0, left)
        inside &= right * z - x > -r * np.hypot(1.0, right)
        inside &= y + top * z > -r * np.hypot(1.0, top)
        inside &= bottom * z - y > -r * np.hypot(1.0, bottom)
        # A cluster shows its back everywhere when the eye is below all of its tangent planes.
        axis = np.einsum("nij,nj->ni", T[:, :3, :3], c.axis)
        away = (axis * centre).sum(axis=1) >= c.spread * np.linalg.norm(centre, axis=1) + r
        return np.flatnonzero(inside & ~away)

    def set_commands(self, chosen: np.ndarray) -> int:
        """Upload one draw record for each run of consecutive clusters of a link; their number."""
        if not len(chosen):
            return 0
        c = self.clusters
        row = c.row[chosen]
        start = np.ones(len(chosen), bool)
        start[1:] = (np.diff(chosen) != 1) | (np.diff(row) != 0)
        starts = np.flatnonzero(start)
        commands = np.zeros(len(starts), COMMAND)
        commands["count"] = np.add.reduceat(c.count[chosen], starts)
        commands["instances"] = 1
        commands["first"] = c.first[chosen[starts]]
        commands["base_instance"] = row[starts]
        self.commands.write(commands)
        return len(starts)

    def release(self) -> None:
        for thing in (self.vao, self.instances, self.commands, self._vertices, self._indices):
            thing.release()


class _Target:
    """A multisampled framebuffer and the plain one it is resolved to."""

    def __init__(self, ctx, width: int, height: int, samples: int) -> None:
        size = (width, height)
        many = samples if samples > 1 else 0
        self.draw = ctx.framebuffer([ctx.renderbuffer(size, 4, samples=many)],
                                    ctx.depth_renderbuffer(size, samples=many))
        self.plain = ctx.framebuffer([ctx.renderbuffer(size, 4)]) if many else self.draw
        self._rgba = np.empty((height, width, 4), np.uint8)

    def read(self, ctx) -> np.ndarray:
        if self.plain is not self.draw:
            ctx.copy_framebuffer(self.plain, self.draw)
        self.plain.read_into(self._rgba, components=4)
        return cv2.cvtColor(self._rgba, cv2.COLOR_RGBA2RGB)


def _context():
    """A moderngl context without a window.

    Raises RenderingError that says what is missing.
    """
    try:
        import moderngl
    except ImportError as error:
        raise RenderingError(
            "the Python package moderngl is missing; install the requirements"
        ) from error
    try:
        return moderngl.create_context(standalone=True, backend="egl", require=330)
    except Exception as error:  # glcontext raises bare Exception for every cause
        raise RenderingError(
            f"EGL gives no OpenGL 3.3 context ({error}); install libegl1 and libgl1-mesa-dri"
        ) from error
