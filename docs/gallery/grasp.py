"""Pick and place: a loose box is found by its picture, gripped, and set down elsewhere."""

import sys

import cv2
import numpy as np
from keeping import EXAMPLES, folder

from aras_sim_bridge import load_world, populate

sys.path.append(str(EXAMPLES))
import pick_and_place as example  # noqa: E402  docs/examples/pick_and_place.py

EYE = """<sdf version='1.6'><world name='default'><model name='eye'><static>1</static>
  <pose>1.15 -0.55 0.6 0 0.35 2.45</pose><link name='l'><sensor name='s' type='camera'>
  <update_rate>30</update_rate><camera><horizontal_fov>0.75</horizontal_fov>
  <image><width>480</width><height>480</height></image></camera>
  <plugin name='p' filename='libgazebo_ros_camera.so'><cameraName>eye</cameraName></plugin>
  </sensor></link></model></world></sdf>"""
out, pictures = folder(), []
(out / "eye.world").write_text(EYE)


class Watched(example.Hand):
    """The example's hand, with a picture from outside each time its fingers have moved."""

    def grip(self, position, effort):
        """See Hand.grip."""
        held, frames = super().grip(position, effort), []
        if not pictures:
            populate(self.simulation.spawn, load_world(out / "eye.world"))
        camera = self.simulation.camera("/eye")
        camera.on_frame, camera.enabled = frames.append, True
        while not frames:
            self.simulation.step()
        camera.enabled = False
        pictures.append(frames[0].image[..., ::-1])
        return held


example.Hand = Watched
off, turned = example.pick_and_place(example.with_gripper(out), seed=0)
cv2.imwrite(str(out / "picture.png"), np.hstack(pictures))
print(f"the box lies {1e3 * off:.1f} mm from its place; {out / 'picture.png'}")
assert off < 5e-4 and turned < 0.005
