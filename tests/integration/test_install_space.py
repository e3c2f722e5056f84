"""Installed programs use the workspace's interpreter and have nothing to compile."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAMS = {
    "aras_sim_bridge": "gazebo",
    "aras_visual_servo_bench": "adapt_description",
    "aras_visual_servo_camera": "aras_visual_servo_camera_node",
    "aras_visual_servo_controller": "aras_visual_servo_controller_node"}
WEB = "aras_visual_servo_bench/web"
PAGES = (f"{WEB}/page", f"{WEB}/live/page", f"{WEB}/report/page", f"{WEB}/browse/page")


def test_installed_programs_start_at_once_with_this_python(tmp_path):
    subprocess.run(
        ["cmake", "--install", ROOT / "build"],
        env={**os.environ, "DESTDIR": str(tmp_path)},
        check=True,
        capture_output=True,
        timeout=400)
    libraries = next(tmp_path.rglob("install/lib"))
    programs = (path for path in libraries.glob("*/*") if path.is_file()
                and os.access(path, os.X_OK))
    interpreters = {str(path.relative_to(libraries)): path.read_text().split("\n")[0]
                    for path in programs}
    here = Path(sys.executable).parent.resolve()
    for program, line in interpreters.items():
        assert line.startswith("#!/") and Path(line[2:]).parent.resolve() == here, program
    assert {f"{package}/{program}" for package, program in PROGRAMS.items()} <= set(interpreters)
    library = libraries / "python3" / "dist-packages"
    assert list((library / "aras_sim_bridge").glob("simulation.py"))
    for page in PAGES:
        source = ROOT / "src" / "aras_visual_servo_bench" / "src" / page
        assert {f.name: f.read_bytes() for f in (library / page).iterdir()} == {
            f.name: f.read_bytes() for f in source.iterdir()}
    # compiled loops are there, those of the workspace as they were: no start compiles them
    for package in ("aras_sim_bridge", "aras_visual_servo_camera", "aras_visual_servo_controller"):
        compiled = {path.name: path.read_bytes() for path in (library / package).rglob("*.nbi")}
        sources = ROOT / "src" / package / "src" / package
        kept = {path.name: path.read_bytes() for path in sources.rglob("*.nbi")}
        assert compiled and all(kept.get(name) == index for name, index in compiled.items())
