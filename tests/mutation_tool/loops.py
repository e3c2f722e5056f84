"""What numba keeps of a file in which one thing is changed: all but what the change touches.

numba throws away all compiled functions of a file that is another. Compiling them
again would take longer than the tests, and most of them are as before.
"""

from __future__ import annotations

import ast
import hashlib
import pickle
import re
import zlib
from pathlib import Path


def touched(text: str, names: tuple[str, ...]) -> set[str]:
    """These names of a source, and those at its top that use them, through as many steps as it
    takes."""
    parts = []
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            made = {node.name}
        else:
            made = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)
                    and isinstance(n.ctx, ast.Store)}
        used = set(re.findall(r"[A-Za-z_]\w*", ast.get_source_segment(text, node) or ""))
        parts.append((made, used))
    found, before = set(names), 0
    while len(found) > before:
        before = len(found)
        for made, used in parts:
            if used & found:
                found |= made
    return found


def keep(cache: Path, module: str, was: bytes, now: bytes, names: set[str]) -> None:
    """Let what numba keeps in `cache` of a module, but for functions of these names, count for its
    source as it is `now`.

    It knows a source by its SHA-256, and `aras_visual_servo_base.compiled` adds the CRC-32 of the
    sources of what a function calls. A function that stands in another line now is not found, and
    is compiled again.
    """
    before, after = (hashlib.sha256(source).digest() for source in (was, now))
    called = {(f"{module}.py", str(zlib.crc32(was))): (f"{module}.py", str(zlib.crc32(now)))}
    for index in cache.glob(f"*/{module}.*.nbi"):
        function = index.name.removeprefix(f"{module}.").rpartition("-")[0]
        if function.partition(".")[0] in names:
            continue
        with index.open("rb") as file:
            version, (stamp, kept) = pickle.load(file), pickle.load(file)
        source, *made_of = stamp if isinstance(stamp, tuple) else (stamp,)
        if source == before:
            now_of = (after, *(called.get(one, one) for one in made_of))
            stamp = now_of if isinstance(stamp, tuple) else after
            index.write_bytes(pickle.dumps(version) + pickle.dumps((stamp, kept)))
