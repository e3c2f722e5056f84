"""Packages with upstream's names are not built if upstream's package is installed."""

import subprocess
from pathlib import Path

import pytest

RULE = Path(__file__).parents[3] / "src" / "upstream_msgs" / "step_aside.cmake"
SCRIPT = f"""
set(CATKIN_DEVEL_PREFIX ${{CMAKE_CURRENT_SOURCE_DIR}}/devel)
set(CMAKE_INSTALL_PREFIX ${{CMAKE_CURRENT_SOURCE_DIR}}/install)
include({RULE})
step_aside(some_msgs)
message("aside: ${{some_msgs_STEPS_ASIDE}}")
"""


@pytest.fixture
def aside(tmp_path: Path):
    """Factory: whether our some_msgs steps aside with the one of a prefix installed; where it was
    built before is left in tmp_path/devel."""
    (tmp_path / "rule.cmake").write_text(SCRIPT)
    built = tmp_path / "devel" / "lib" / "python3" / "dist-packages" / "some_msgs"
    built.mkdir(parents=True)

    def run(prefix: str = "", package: str = "some_msgs", by_environment: bool = False) -> bool:
        if prefix:
            config = tmp_path / prefix / "share" / package / "cmake" / f"{package}Config.cmake"
            config.parent.mkdir(parents=True)
            config.touch()
        prefixes = [str(tmp_path / name) for name in ("nowhere", "devel", "install", prefix)]
        given = [] if by_environment else [f"-DCMAKE_PREFIX_PATH={';'.join(prefixes)}"]
        path = ":".join(prefixes) if by_environment else ""
        told = subprocess.run(
            ["cmake", *given, "-P", "rule.cmake"], cwd=tmp_path, check=True, text=True,
            env={"PATH": "/usr/bin:/bin", "CMAKE_PREFIX_PATH": path}, capture_output=True,
            timeout=120,
        ).stderr  # fmt: skip
        steps = "aside: TRUE" in told
        assert steps == (tmp_path / "CATKIN_IGNORE").exists() == (not built.exists())
        return steps

    return run


@pytest.mark.parametrize(("given", "steps"), [
    (("underlay",), True), (("underlay", "some_msgs", True), True), ((), False),
    (("devel",), False), (("install",), False), (("underlay", "other_msgs"), False),
])  # fmt: skip
def test_an_installed_package_wins_and_what_was_built_of_ours_goes(aside, given, steps):
    """What this workspace built itself is no reason, nor is another package."""
    assert aside(*given) == steps
