"""Framebuffers and the context they live in."""

from __future__ import annotations

import ctypes
import os

import moderngl
import numpy as np

from ..errors import RenderingError


class Target:
    """A framebuffer with depth, and the plain one it is resolved to where it is multisampled.

    dtype: 'f1' for bytes, 'f4'.
    """

    def __init__(self, ctx: moderngl.Context, width: int, height: int, samples: int = 1,
                 components: int = 4, dtype: str = "f1") -> None:
        size = (width, height)
        many = samples if samples > 1 else 0
        try:
            plain = ctx.renderbuffer(size, components, dtype=dtype)
            depth = ctx.depth_renderbuffer(size, samples=many)
            if many:
                self.draw = ctx.framebuffer([ctx.renderbuffer(size, 4, samples=many)], depth)
                self.plain = ctx.framebuffer([plain])
            else:
                self.draw = self.plain = ctx.framebuffer([plain], depth)
        except moderngl.Error as error:
            raise RenderingError(
                f"the graphics driver refuses a picture of {width} x {height} pixels with "
                f"{samples} samples ({error}); make it smaller"
            ) from error
        self._dtype = dtype
        self._components = components
        self._pixels = np.empty((height, width, components), np.uint8 if dtype == "f1" else "f4")

    def read(self, ctx: moderngl.Context) -> np.ndarray:
        """Pixels (height, width, components), in a buffer that the next read overwrites."""
        if self.plain is not self.draw:
            ctx.copy_framebuffer(self.plain, self.draw)
        self.plain.read_into(self._pixels, components=self._components, dtype=self._dtype)
        return self._pixels

    def release(self) -> None:
        """Give the memory back."""
        for framebuffer in {self.draw, self.plain}:
            attachments = [*framebuffer.color_attachments, framebuffer.depth_attachment]
            framebuffer.release()
            for attachment in attachments:
                if attachment is not None:
                    attachment.release()


def create_context() -> moderngl.Context:
    """A context without a window.

    Raises RenderingError that says what is missing.
    """
    # Mesa's software rasteriser starts a thread for each core. On two cores, which physics and
    # nodes want as well, handing work over costs more than it gains: without threads a picture
    # took 15 % less processor time and half the time in the worst case.
    if (os.cpu_count() or 1) <= 2:
        os.environ.setdefault("LP_NUM_THREADS", "0")
    _keep_memory()
    try:
        return moderngl.create_context(standalone=True, backend="egl", require=330)
    except Exception as error:  # glcontext raises bare Exception for every cause
        raise RenderingError(
            f"EGL gives no OpenGL 3.3 context ({error}); install libegl1 and libgl1-mesa-dri"
        ) from error


# Of malloc.h.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT = 64 << 20
# Up to glibc's own limit for blocks that come from the heap.
FROM_HEAP = 32 << 20


def _keep_memory() -> None:
    """Let the C library keep what a picture frees, up to KEPT bytes, for the next picture.

    Mesa frees its lists of triangles after each picture, numpy its larger arrays. By default the
    memory goes back to the kernel and comes again page by page, cleared: a seventh of the time of
    a scene of 40 000 triangles. Other C libraries than glibc have no such setting.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_TRIM_THRESHOLD, KEPT)
        mallopt(M_MMAP_THRESHOLD, FROM_HEAP)
