"""Pick and place: the arm finds a loose box in its camera image, grips it, and places it elsewhere.
"""

import sys

import cv2
import numpy as np
from output import EXAMPLES, folder

from aras_sim_bridge import load_world, populate

sys.path.append(str(EXAMPLES))
import pick_and_place as example  # noqa: E402  docs/examples/pick_and_place.py

CAMERA_WORLD = """<sdf version='1.6'><world name='default'><model name='camera'><static>1</static>
  <pose>1.15 -0.55 0.6 0 0.35 2.45</pose><link name='l'><sensor name='s' type='camera'>
  <update_rate>30</update_rate><camera><horizontal_fov>0.75</horizontal_fov>
  <image><width>480</width><height>480</height></image></camera>
  <plugin name='p' filename='libgazebo_ros_camera.so'><cameraName>outside</cameraName></plugin>
  </sensor></link></model></world></sdf>"""
out, images = folder(), []
(out / "camera.world").write_text(CAMERA_WORLD)


class RecordedHand(example.Hand):
    """Hand of the example that also takes an image from outside after each finger motion."""

    def grip(self, position, effort):
        """Move the fingers as Hand.grip does, then take an image."""
        has_contact, frames = super().grip(position, effort), []
        if not images:
            populate(self.simulation.spawn, load_world(out / "camera.world"))
        camera = self.simulation.camera("/outside")
        camera.on_frame, camera.enabled = frames.append, True
        while not frames:
            self.simulation.step()
        camera.enabled = False
        images.append(frames[0].image[..., ::-1])
        return has_contact


example.Hand = RecordedHand
error, turned = example.pick_and_place(example.with_gripper(out), seed=0)
cv2.imwrite(str(out / "picture.png"), np.hstack(images))
print(f"the box is {1e3 * error:.1f} mm from its goal; {out / 'picture.png'}")
assert error < 5e-4 and turned < 0.005
