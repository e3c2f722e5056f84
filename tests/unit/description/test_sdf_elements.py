"""Every element of SDF 1.4 to 1.9 acts, or is named in one line, or has no meaning here.

The lists are those of the specification (http://sdformat.org/spec), each with a value that is not
its default. An element acts where the description that is read differs by it.
"""

import pytest

from aras_sim_bridge.description import world_file

LINK = "<model name='m'><link name='l'>{}</link></model>"
BOX = "<geometry><box><size>1 2 3</size></box></geometry>"
CAMERA = LINK.format("<sensor name='s' type='{type}'>{{}}</sensor>")
JOINT = ("<model name='m'><link name='a'/><link name='l'/><joint name='j' type='revolute'><parent>a"
         "</parent><child>l</child>{}</joint></model>")
INERTIAL = "<inertial>{}</inertial>"
VISUAL = "<visual name='v'>" + BOX + "{}</visual>"
COLLISION = "<collision name='c'>" + BOX + "{}</collision>"
# where, with {} for the element: (elements with values, those without a meaning here)
PLACES = {
    "{}": (
        "<gravity>0 0 -3</gravity> <wind><linear_velocity>1 0 0</linear_velocity></wind>"
        " <light name='k' type='point'/> <model name='n'><link name='l'/></model>"
        " <actor name='k'/> <road name='k'/> <plugin name='k' filename='libk.so'/>"
        " <joint name='k' type='fixed'/> <frame name='k' attached_to='x'/>"
        " <include><uri>model://sun</uri></include>"
        " <state><sim_time>3 0</sim_time></state>"
        " <population name='k'><model name='n'><link name='l'/></model><box><size>1 1 1</size>"
        "</box><model_count>2</model_count><distribution><type>random</type></distribution>"
        "</population>",
        "<gui/> <audio/> <atmosphere type='adiabatic'><temperature>3</temperature></atmosphere>"
        " <magnetic_field>1 2 3</magnetic_field> <spherical_coordinates/>"),
    "<physics type='ode'>{}</physics>": (
        "<max_step_size>0.002</max_step_size> <real_time_update_rate>5</real_time_update_rate>"
        " <gravity>0 0 -3</gravity> <max_contacts>3</max_contacts>",
        "<real_time_factor>2</real_time_factor> <bullet/> <simbody/> <dart/>"),
    "<physics type='ode'><ode><solver>{}</solver></ode></physics>": (
        "<type>world</type> <min_step_size>0.3</min_step_size> <iters>3</iters> <sor>1</sor>"
        " <precon_iters>3</precon_iters> <use_dynamic_moi_rescaling>1</use_dynamic_moi_rescaling>"
        " <friction_model>box_model</friction_model> <island_threads>3</island_threads>"
        " <thread_position_correction>1</thread_position_correction>", ""),
    "<physics type='ode'><ode><constraints>{}</constraints></ode></physics>": (
        "<cfm>0.3</cfm> <erp>0.7</erp> <contact_max_correcting_vel>3</contact_max_correcting_vel>"
        " <contact_surface_layer>0.3</contact_surface_layer>", ""),
    "<scene>{}</scene>": (
        "<ambient>1 0 0 1</ambient> <background>1 0 0 1</background> <sky/>"
        " <fog><type>linear</type></fog>",
        "<shadows>0</shadows> <grid>0</grid> <origin_visual>0</origin_visual>"),
    "<scene><sky>{}</sky></scene>": (
        "<time>3</time> <sunrise>3</sunrise> <sunset>3</sunset> <clouds><speed>3</speed></clouds>"
        " <cubemap_uri>x</cubemap_uri>", ""),
    "<light name='k' type='spot'>{}</light>": (
        "<cast_shadows>1</cast_shadows> <intensity>3</intensity> <diffuse>1 0 0 1</diffuse>"
        " <specular>1 0 0 1</specular> <direction>1 0 0</direction> <pose>1 0 0 0 0 0</pose>"
        " <visualize>0</visualize> <light_on>0</light_on>"
        " <attenuation><range>3</range></attenuation> <attenuation><linear>3</linear>"
        "</attenuation> <attenuation><constant>3</constant></attenuation>"
        " <attenuation><quadratic>3</quadratic></attenuation>"
        " <spot><inner_angle>0.1</inner_angle></spot> <spot><outer_angle>2</outer_angle></spot>"
        " <spot><falloff>3</falloff></spot>", ""),
    "<model name='m'><link name='l'/>{}</model>": (
        "<static>1</static> <self_collide>1</self_collide> <enable_wind>1</enable_wind>"
        " <pose>1 0 0 0 0 0</pose> <frame name='k' attached_to='x'/> <gripper name='k'/>"
        " <include><uri>model://k</uri></include> <plugin name='k' filename='libk.so'/>"
        " <model name='n'><link name='l'/></model>",
        "<allow_auto_disable>0</allow_auto_disable>"),
    LINK: (
        "<gravity>0</gravity> <enable_wind>1</enable_wind> <self_collide>1</self_collide>"
        " <kinematic>1</kinematic> <pose>1 0 0 0 0 0</pose> <velocity_decay><linear>1</linear>"
        "</velocity_decay> <audio_sink/> <audio_source/> <battery name='k'/>"
        " <projector name='k'/> <light name='k' type='point'/> <particle_emitter name='k'/>"
        " <sensor name='k' type='ray'/> <sensor name='k' type='gps'/>"
        " <sensor name='k' type='altimeter'/> <sensor name='k' type='logical_camera'/>"
        " <sensor name='k' type='magnetometer'/> <sensor name='k' type='rfid'/>"
        " <sensor name='k' type='sonar'/> <sensor name='k' type='wireless_transmitter'/>",
        "<must_be_base_link>1</must_be_base_link>"),
    LINK.format(INERTIAL): (
        "<mass>3</mass> <pose>1 0 0 0 0 0</pose> <inertia><ixx>3</ixx><iyy>3</iyy></inertia>"
        " <fluid_added_mass><xx>1</xx></fluid_added_mass> <density>3</density>", ""),
    LINK.format(VISUAL): (
        "<cast_shadows>0</cast_shadows> <laser_retro>3</laser_retro>"
        " <transparency>0.5</transparency> <pose>1 0 0 0 0 0</pose> <meta><layer>3</layer></meta>"
        " <visibility_flags>3</visibility_flags> <plugin name='k' filename='libk.so'/>", ""),
    LINK.format(VISUAL.format("<material>{}</material>")): (
        "<script><name>Gazebo/Red</name></script> <shader type='pixel'/> <lighting>0</lighting>"
        " <ambient>1 0 0 1</ambient> <diffuse>1 0 0 1</diffuse> <specular>1 0 0 1</specular>"
        " <emissive>1 0 0 1</emissive> <render_order>3</render_order> <double_sided>1"
        "</double_sided> <shininess>3</shininess> <pbr/>", ""),
    LINK.format(COLLISION): (
        "<laser_retro>3</laser_retro> <pose>1 0 0 0 0 0</pose> <density>3</density>",
        "<max_contacts>3</max_contacts>"),
    LINK.format("<collision name='c'>{}</collision>"): (
        "<geometry><heightmap/></geometry> <geometry><polyline/></geometry>"
        " <geometry><image/></geometry> <geometry><ellipsoid/></geometry>"
        " <geometry><sphere><radius>1</radius></sphere></geometry>"
        " <geometry><mesh><uri>file:///x.stl</uri></mesh></geometry>"
        " <geometry><box><size>1 1 1</size><skin>3</skin></box></geometry>"
        " <geometry><mesh><uri>file:///x.stl</uri><submesh><name>k</name></submesh></mesh>"
        "</geometry>", "<geometry><empty/></geometry>"),
    LINK.format(COLLISION.format("<surface>{}</surface>")): (
        "<bounce><restitution_coefficient>0.5</restitution_coefficient></bounce>"
        " <soft_contact><dart/></soft_contact>", ""),
    LINK.format(COLLISION.format("<surface><friction>{}</friction></surface>")): (
        "<bullet><friction>3</friction></bullet> <ode><mu>0.3</mu></ode> <ode><mu2>0.3</mu2></ode>"
        " <ode><fdir1>1 0 0</fdir1></ode> <ode><slip1>3</slip1></ode> <ode><slip2>3</slip2></ode>"
        " <torsional><patch_radius>3</patch_radius></torsional>"
        " <torsional><surface_radius>3</surface_radius></torsional>"
        " <torsional><ode><slip>3</slip></ode></torsional>",
        # of a contact without a radius
        "<torsional><coefficient>3</coefficient></torsional>"
        " <torsional><use_patch_radius>0</use_patch_radius></torsional>"),
    LINK.format(COLLISION.format("<surface><contact>{}</contact></surface>")): (
        "<collide_without_contact>1</collide_without_contact> <collide_bitmask>3</collide_bitmask>"
        " <collide_without_contact_bitmask>3</collide_without_contact_bitmask>"
        " <category_bitmask>3</category_bitmask> <poissons_ratio>0.1</poissons_ratio>"
        " <elastic_modulus>3</elastic_modulus> <ode><soft_cfm>3</soft_cfm></ode>"
        " <ode><soft_erp>0.3</soft_erp></ode> <ode><kp>3</kp></ode> <ode><kd>3</kd></ode>"
        " <ode><max_vel>3</max_vel></ode> <ode><min_depth>3</min_depth></ode>"
        " <bullet><kp>3</kp></bullet>", ""),
    JOINT: (
        "<pose>1 0 0 0 0 0</pose> <gearbox_ratio>3</gearbox_ratio> <thread_pitch>3</thread_pitch>"
        " <gearbox_reference_body>l</gearbox_reference_body> <screw_thread_pitch>3"
        "</screw_thread_pitch> <axis2><xyz>1 0 0</xyz></axis2> <sensor name='k' type='ray'/>", ""),
    JOINT.format("<axis>{}</axis>"): (
        "<xyz>1 0 0</xyz> <initial_position>0.3</initial_position>"
        " <limit><lower>-1</lower></limit> <limit><upper>1</upper></limit> <limit><effort>1"
        "</effort></limit> <limit><velocity>1</velocity></limit> <limit><stiffness>3</stiffness>"
        "</limit> <limit><dissipation>3</dissipation></limit> <dynamics><damping>1</damping>"
        "</dynamics> <dynamics><friction>1</friction></dynamics> <dynamics><spring_reference>1"
        "</spring_reference></dynamics> <dynamics><spring_stiffness>1</spring_stiffness>"
        "</dynamics> <mimic joint='k'/>", ""),
    JOINT.format("<physics>{}</physics>"): (
        "<ode><cfm_damping>1</cfm_damping></ode> <ode><fudge_factor>1</fudge_factor></ode>"
        " <ode><cfm>1</cfm></ode> <ode><erp>1</erp></ode> <ode><bounce>1</bounce></ode>"
        " <ode><max_force>1</max_force></ode> <ode><velocity>1</velocity></ode>"
        " <ode><limit><cfm>1</cfm></limit></ode> <ode><limit><erp>1</erp></limit></ode>"
        " <ode><suspension><cfm>1</cfm></suspension></ode>"
        " <ode><suspension><erp>1</erp></suspension></ode>",
        # the first is of a closed chain, where it acts
        "<simbody><must_be_loop_joint>1</must_be_loop_joint></simbody>"
        " <provide_feedback>1</provide_feedback> <ode><provide_feedback>1</provide_feedback></ode>"
        " <ode><implicit_spring_damper>1</implicit_spring_damper></ode>"),
    CAMERA.format(type="camera").format("<camera name='c'/>{}"): (
        "<update_rate>3</update_rate> <pose>1 0 0 0 0 0</pose> <topic>k</topic>"
        " <enable_metrics>1</enable_metrics> <plugin name='k' filename='libk.so'/>",
        "<always_on>1</always_on> <visualize>1</visualize>"),
    CAMERA.format(type="camera").format("<camera name='c'>{}</camera>"): (
        "<pose>1 0 0 0 0 0</pose> <horizontal_fov>1</horizontal_fov> <image><width>30</width>"
        "</image> <image><height>30</height></image> <image><format>L8</format></image>"
        " <image><anti_aliasing>1</anti_aliasing></image> <clip><near>0.3</near></clip>"
        " <clip><far>9</far></clip> <save enabled='1'><path>/x</path></save>"
        " <depth_camera><output>points</output></depth_camera> <visibility_mask>1"
        "</visibility_mask> <distortion><k1>0.1</k1></distortion> <distortion><k2>0.1</k2>"
        "</distortion> <distortion><k3>0.1</k3></distortion> <distortion><p1>0.1</p1></distortion>"
        " <distortion><p2>0.1</p2></distortion> <distortion><center>0.1 0.1</center></distortion>"
        " <optical_frame_id>k</optical_frame_id> <segmentation_type>k</segmentation_type>"
        " <camera_info_topic>k</camera_info_topic> <triggered>1</triggered>"
        " <trigger_topic>k</trigger_topic>"
        " <noise><type>gaussian</type><stddev>0.1</stddev></noise>", ""),
    CAMERA.format(type="camera").format("<camera name='c'><lens>{}</lens></camera>"): (
        "<type>equidistant</type> <intrinsics><fx>30</fx></intrinsics> <intrinsics><fy>30</fy>"
        "</intrinsics> <intrinsics><cx>30</cx></intrinsics> <intrinsics><cy>30</cy></intrinsics>"
        " <intrinsics><s>3</s></intrinsics> <projection><p_fx>3</p_fx></projection>"
        " <custom_function><c1>3</c1></custom_function>",
        "<env_texture_size>64</env_texture_size>"),
    CAMERA.format(type="wideanglecamera").format("<camera name='c'><lens>{}</lens></camera>"): (
        "<type>equidistant</type> <scale_to_hfov>0</scale_to_hfov> <cutoff_angle>1</cutoff_angle>"
        " <custom_function><c1>3</c1></custom_function> <intrinsics><fx>30</fx></intrinsics>",
        "<env_texture_size>64</env_texture_size>"),
}


def cases():
    for place, (acting, idle) in PLACES.items():
        for elements, has_meaning in ((acting, True), (idle, False)):
            for element in elements.replace("> <", ">\n<").splitlines():
                yield place, element, has_meaning


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    file = tmp_path_factory.mktemp("world") / "w.world"

    def made(inside):
        file.write_text(f"<sdf version='1.9'><world name='w'>{inside}</world></sdf>")
        found = world_file.load_world(str(file))
        return found.warnings, repr(found).replace(repr(found.warnings), "")

    return made


@pytest.mark.parametrize(("place", "element", "has_meaning"), list(cases()))
def test_each_element_acts_or_is_named_once(read, place, element, has_meaning):
    before, plain = read(place.replace("{}", ""))
    warnings, given = read(place.replace("{}", element))
    named = [text for text in warnings if text not in before]
    if has_meaning:
        assert len(named) == 1 or (given != plain and not named), named
    else:
        assert not named
