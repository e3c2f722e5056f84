"""Write the model folders that the saved worlds in this folder include.

The meshes, textures and material scripts have the form of Gazebo's model database.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np

CONFIG = """<?xml version="1.0"?><model><name>{0}</name><version>1.0</version>
<sdf version="1.4">model-1_4.sdf</sdf><sdf version="1.6">model.sdf</sdf>
<description>Made for the tests of saved worlds.</description></model>
"""
MATERIAL = """material {1}/Surface
{{ technique {{ pass {{
  ambient 0.5 0.5 0.5 1
  diffuse 1 1 1 1
  texture_unit {{
    texture {0}.png
    filtering trilinear
  }}
}} }} }}
"""
SURFACE = """<material><script><uri>model://{0}/materials/scripts</uri>
<uri>model://{0}/materials/textures</uri><name>{1}/Surface</name></script></material>"""
# A wedge: 0.3 m long, 0.2 m wide, 0.1 m high at its back.
WEDGE = "\n".join([
    "v -0.15 -0.1 0", "v 0.15 -0.1 0", "v 0.15 0.1 0", "v -0.15 0.1 0", "v -0.15 -0.1 0.1",
    "v -0.15 0.1 0.1", "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "f 1/1 4/2 3/3", "f 1/1 3/3 2/4",
    "f 2/1 3/2 6/3", "f 2/1 6/3 5/4", "f 1/1 2/2 5/3", "f 4/1 6/2 3/3", "f 1/1 5/2 6/3",
    "f 1/1 6/3 4/4", ""])  # fmt: skip
SIZES = {"bench": (1.2, 0.8, 0.04), "poster": (0.4, 0.02, 0.3)}


@cache
def speckles(width: int, height: int, seed: int) -> np.ndarray:
    """(height, width, 3) uint8: dots of many sizes, which any stereo method can match."""
    random = np.random.default_rng(seed)
    picture = np.full((height, width, 3), 160, np.uint8)
    for _ in range(width * height // 40):
        at = int(random.integers(width)), int(random.integers(height))
        grey = random.integers(20, 256, 3).tolist()
        cv2.circle(picture, at, int(random.integers(1, 6)), grey, -1)
    return picture


def write(root: Path) -> Path:
    """Fill `root` with the folders bench, poster and wedge; returns it."""
    for seed, name in enumerate(("bench", "poster", "wedge")):
        folder = root / name
        for part in ("materials/scripts", "materials/textures", "meshes"):
            (folder / part).mkdir(parents=True)
        (folder / "model.config").write_text(CONFIG.format(name))
        owner = name.capitalize()
        script = folder / "materials" / "scripts" / f"{name}.material"
        script.write_text(MATERIAL.format(name, owner))
        picture = speckles(960, 640, seed)
        cv2.imwrite(str(folder / "materials" / "textures" / f"{name}.png"), picture)
        if name == "wedge":
            (folder / "meshes" / "wedge.obj").write_text(WEDGE)
            shape = "<mesh><uri>model://wedge/meshes/wedge.obj</uri></mesh>"
        else:
            shape = "<box><size>{} {} {}</size></box>".format(*SIZES[name])
        (folder / "model-1_4.sdf").write_text("<sdf version='1.4'><model name='old'/></sdf>")
        (folder / "model.sdf").write_text(
            f"<?xml version='1.0'?><sdf version='1.6'><model name='{name}'>"
            f"<static>{int(name != 'wedge')}</static><link name='link'>"
            "<inertial><mass>0.6</mass><inertia><ixx>0.003</ixx><iyy>0.005</iyy><izz>0.006</izz>"
            "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"
            f"<collision name='collision'><geometry>{shape}</geometry></collision>"
            f"<visual name='visual'><geometry>{shape}</geometry>{SURFACE.format(name, owner)}"
            "</visual></link></model></sdf>")
    return root
