"""Search for ROS packages and Gazebo model folders, and for the mesh files that URIs name.

The path of a mesh file is always inside the package that its URI names.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache

from aras_sim_bridge.errors import DescriptionError, UnsupportedPartError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.safe_xml import shorten

ResolvePackage = Callable[[str], str]
MODEL_PATH = "GAZEBO_MODEL_PATH"
OWN_MODELS = "~/.gazebo/models"

_PACKAGE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.\-]*\Z")
_SKIPPED_DIRECTORIES = {"CMakeFiles", "__pycache__", "node_modules"}
_LARGEST_DEPTH = 6
# Directories of the packages that were found, by package name and search paths.
_cache: dict[tuple[str, str, str], str] = {}


def find_package(name: str) -> str:
    """Return the directory of the ROS package `name`.

    The search order is that of the ROS tools: `ROS_PACKAGE_PATH` (searched recursively, like
    rospack does), then the share directories of `CMAKE_PREFIX_PATH`, then `/usr/share`, where
    Debian packages are installed.

    Raises:
        DescriptionError: the name is malformed, or the package is not found.
    """
    if not _PACKAGE_NAME.match(name):
        raise DescriptionError(
            f"'{name[:80]}' is not a package name: use letters, digits, _, - and . only"
        )
    paths = tuple(os.environ.get(key, "") for key in ("ROS_PACKAGE_PATH", "CMAKE_PREFIX_PATH"))
    found = _cache.get((name, *paths))
    if found is None or not os.path.isdir(found):
        # Only a package that was found is cached, because a missing package may be built before the
        # next call.
        found = _search(name, *paths)
    if found is None:
        raise UnsupportedPartError(
            f"package '{name}' is not in ROS_PACKAGE_PATH: source the workspace that contains it "
            "(. devel/setup.bash) or install it, then try again"
        )
    _cache[name, *paths] = found
    return found


def _search(name: str, package_path: str, prefix_path: str) -> str | None:
    for root in filter(None, package_path.split(os.pathsep)):
        for directory in _list_packages(root):
            if _read_package_name(directory) == name:
                return directory
    for prefix in (*filter(None, prefix_path.split(os.pathsep)), "/usr"):
        candidate = os.path.join(prefix, "share", name)
        if os.path.isfile(os.path.join(candidate, "package.xml")):
            return candidate
    return None


def find_model(name: str) -> str | None:
    """Return the folder of a Gazebo model, or None if it is not found.

    The search covers GAZEBO_MODEL_PATH, ~/.gazebo/models, and then the folders that packages export
    (`<export><gazebo_ros gazebo_model_path="${prefix}/.."/>` in package.xml).
    """
    if name in ("", ".", "..") or "/" in name or "\0" in name:
        return None
    named = (*os.environ.get(MODEL_PATH, "").split(os.pathsep), os.path.expanduser(OWN_MODELS))
    found = _find_folder(name, filter(None, named))
    return found or _find_folder(name, _find_model_paths(os.environ.get("ROS_PACKAGE_PATH", "")))


def _find_folder(name: str, roots: Iterable[str]) -> str | None:
    paths = (os.path.join(root, name) for root in roots)
    return next((path for path in paths if os.path.isdir(path)), None)


@lru_cache(maxsize=8)
def _find_model_paths(package_path: str) -> tuple[str, ...]:
    """Return the model folders that the packages of a ROS_PACKAGE_PATH export."""
    found: dict[str, None] = {}
    for root in filter(None, package_path.split(os.pathsep)):
        for directory in _list_packages(root):
            try:
                with open(os.path.join(directory, "package.xml"), encoding="utf-8") as file:
                    text = file.read(65536)
                exports = [] if "gazebo_model_path" not in text else (
                    safe_xml.parse(text, directory).findall("export/gazebo_ros"))
            except (OSError, UnicodeDecodeError, DescriptionError):
                continue
            for export in exports:
                paths = export.get("gazebo_model_path", "").replace("${prefix}", directory)
                found.update(dict.fromkeys(
                    os.path.normpath(path) for path in paths.split(os.pathsep) if path))
    return tuple(found)


def _list_packages(root: str) -> Iterator[str]:
    """Yield the directories of packages below `root`, breadth first."""
    level = [root]
    for _ in range(_LARGEST_DEPTH):
        deeper: list[str] = []
        for directory in level:
            try:
                entries = sorted(os.scandir(directory), key=lambda e: e.name)
            except OSError:
                continue
            names = {e.name for e in entries}
            if "package.xml" in names or "manifest.xml" in names:
                yield directory
                continue  # a package's directory is not searched for further packages
            if names & {"CATKIN_IGNORE", "rospack_nosubdirs"}:
                continue
            deeper += [
                e.path for e in entries
                if e.is_dir() and not e.name.startswith(".")
                and e.name not in _SKIPPED_DIRECTORIES
            ]
        level = deeper


def _read_package_name(directory: str) -> str:
    try:
        with open(os.path.join(directory, "package.xml"), encoding="utf-8") as file:
            match = re.search(r"<name>\s*([^<\s]+)\s*</name>", file.read(65536))
    except (OSError, UnicodeDecodeError):
        match = None
    return match.group(1) if match else os.path.basename(directory)


def resolve_uri(
    uri: str,
    where: str,
    resolve_package: ResolvePackage = find_package,
    base_directory: str | None = None,
) -> str:
    """Return the absolute path of an existing mesh file.

    The arguments have the same meaning as in `locate`.

    Raises:
        UnsupportedPartError: `locate` fails, or the path is missing or not a regular file.
    """
    path = locate(uri, where, resolve_package, base_directory)
    if not os.path.isfile(path):
        kind = "is no regular file" if os.path.exists(path) else "does not exist"
        raise UnsupportedPartError(f"{where}: mesh file {path} (from '{shorten(uri, 200)}') "
                                   f"{kind}; correct the path")
    return path


def locate(
    uri: str,
    where: str,
    resolve_package: ResolvePackage = find_package,
    base_directory: str | None = None,
    what: str = "mesh",
) -> str:
    """Return the absolute path that a URI names; the path may not exist.

    Args:
        uri: `package://pkg/path`, `model://name/path`, `file:///path`, an absolute path, or a path
            relative to `base_directory`. In `model://`, `name` is a Gazebo model folder or a
            package.
        where: element that names the URI, for messages ("link 'J1', visual 1").
        resolve_package: function that returns the directory of a package.
        base_directory: folder to which relative paths are relative; None rejects relative paths.
        what: kind of the file, for messages.

    Raises:
        UnsupportedPartError: the scheme or package is unknown, or the path leaves its package.
    """
    text = uri.strip()
    shown = text if len(text) <= 200 else text[:200] + "…"
    if not text or "\0" in text:
        raise UnsupportedPartError(
            f"{where}: the {what} file name is empty or contains a NUL character"
        )
    scheme, separator, rest = text.partition("://")
    if not separator:
        path = text
        if not os.path.isabs(path):
            if base_directory is None:
                raise UnsupportedPartError(
                    f"{where}: {what} '{shown}' is a relative path, but the description was not "
                    "read from a file; write package://<package>/<path> or an absolute path"
                )
            path = os.path.join(base_directory, path)
    elif scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        folder = find_model(package) if scheme == "model" else None
        try:
            root = os.path.normpath(folder or resolve_package(package))
        except DescriptionError as error:
            raise UnsupportedPartError(f"{where}: {what} '{shown}': {error}") from None
        path = os.path.normpath(os.path.join(root, inside.lstrip("/")))
        if os.path.commonpath([root, path]) != root:
            raise UnsupportedPartError(
                f"{where}: {what} '{shown}' is outside of package '{package}'; "
                "keep the file inside the package"
            )
    elif scheme == "file":
        path = "/" + rest.lstrip("/")
    else:
        raise UnsupportedPartError(
            f"{where}: {what} '{shown}' has the unknown scheme '{scheme}://'; "
            "use package://, file:// or an absolute path"
        )
    return os.path.normpath(path)
