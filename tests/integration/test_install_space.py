"""The install space starts its programs with the workspace's interpreter, not the system's."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAMS = {
    "aras_sim_bridge": "gazebo",
    "aras_visual_servo_bench": "demo",
    "aras_visual_servo_camera": "aras_visual_servo_camera_node",
    "aras_visual_servo_controller": "aras_visual_servo_controller_node",
    "aras_visual_servo_gazebo": "adapt_description",
}


def test_installed_programs_start_with_this_python(tmp_path):
    subprocess.run(
        ["cmake", "--install", ROOT / "build"],
        env={**os.environ, "DESTDIR": str(tmp_path)},
        check=True,
        capture_output=True,
        timeout=120,
    )
    libraries = next(tmp_path.rglob("install/lib"))
    programs = (
        path for path in libraries.glob("*/*") if path.is_file() and os.access(path, os.X_OK)
    )
    interpreters = {
        str(path.relative_to(libraries)): path.read_text().split("\n")[0] for path in programs
    }
    here = Path(sys.executable).parent.resolve()
    for program, line in interpreters.items():
        assert line.startswith("#!/") and Path(line[2:]).parent.resolve() == here, program
    assert {f"{package}/{program}" for package, program in PROGRAMS.items()} <= set(interpreters)
    assert list((libraries / "python3" / "dist-packages" / "aras_sim_bridge").glob("simulation.py"))
