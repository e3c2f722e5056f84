"""From Gazebo: the example simulates and renders a Gazebo world file with a camera plugin, without
Gazebo.
"""

import cv2
from output import folder

from aras_sim_bridge import Simulation, SimulationConfig, load_world, populate

BOX = """<model name='{0}'><pose>{1}</pose><static>{2}</static><link name='l'>
  <inertial><mass>1</mass></inertial>
  <collision name='c'><geometry>{3}</geometry></collision>
  <visual name='v'><geometry>{3}</geometry><material><ambient>{4}</ambient><diffuse>{4}</diffuse>
  </material></visual></link></model>"""
WORLD = f"""<sdf version='1.6'><world name='default'>
<light name='sun' type='directional'><pose>0 0 10 0 0 0</pose><cast_shadows>1</cast_shadows>
  <diffuse>0.9 0.9 0.9 1</diffuse><direction>-0.4 0.3 -0.9</direction></light>
{BOX.format('table', '0 0 0.35 0 0 0', 1, '<box><size>1.2 0.8 0.7</size></box>', '0.5 0.36 0.24 1')}
{BOX.format('cube', '0.1 0.15 1.2 0 0 0.4', 0, '<box><size>0.2 0.2 0.2</size></box>',
            '0.1 0.4 0.7 1')}
{BOX.format('ball', '-0.25 -0.1 0.9 0 0 0', 0, '<sphere><radius>0.12</radius></sphere>',
            '0.85 0.4 0.05 1')}
{BOX.format('can', '0.35 -0.2 0.85 0 0 0', 0,
            '<cylinder><radius>0.08</radius><length>0.3</length></cylinder>', '0.1 0.6 0.3 1')}
<model name='camera'><static>1</static><pose>1.5 -1.2 1.7 0 0.5 2.4</pose><link name='l'>
  <sensor name='s' type='camera'><update_rate>30</update_rate>
  <camera><horizontal_fov>1.0</horizontal_fov>
  <image><width>640</width><height>480</height></image></camera>
  <plugin name='p' filename='libgazebo_ros_camera.so'><cameraName>room</cameraName></plugin>
  </sensor></link></model></world></sdf>"""

out = folder()
(out / "table.world").write_text(WORLD)
world = load_world(out / "table.world")
simulation = Simulation(SimulationConfig(world.time_step, world.gravity, lights=world.lights))
populate(simulation.spawn, world)
frames, camera = [], simulation.camera("/room")
camera.on_frame, camera.enabled = frames.append, True
while simulation.time_ns < 1_500_000_000:  # the cube falls onto the table
    simulation.step()
cv2.imwrite(str(out / "picture.png"), frames[-1].image[..., ::-1])
height = simulation.world.model("cube").pose().matrix()[2, 3]
print(f"height of the cube {height:.3f} m, of the table 0.700 m; {out / 'picture.png'}")
assert 0.79 < height < 0.81
simulation.close()
