"""Commands of the live page: services, restarted nodes, replaced robot and target."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rosnode
import rospy
import rosservice
import yaml
from aras_sim_bridge.srv import StepWorld
from controller_manager_msgs.msg import ControllerState
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from gazebo_msgs.srv import DeleteModel, GetModelState, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion
from run_messages import ARM
from std_srvs.srv import Empty, Trigger

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import RefusedRequestError
from aras_visual_servo_bench.ros import page_commands as page
from aras_visual_servo_bench.ros.graph_listener import GraphListener, make_listener_settings
from aras_visual_servo_bench.visualization.run_drawing import RunDrawing
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.schemes import SCHEMES

SOURCES = Path(__file__).parents[3] / "src"

NODE, CAMERA = "/aras_visual_servo_controller", "/gazebo/cameras/labrob/camera"
MANAGER = "/two/controller_manager"


RUNS = 'echo "$@ $$"; exec sleep 60'
DIES = """echo; echo "[FATAL] the first"; echo "[FATAL] [17.5, 3.25]: no such scheme"
echo "[x-2] process has died"; exec sleep 60"""


@pytest.fixture
def asked(graph, life, monkeypatch, tmp_path, roslaunch):
    """Commands for the robot `robo`, and the services that they call; `calls` lists the requests.
    """
    settings = make_listener_settings({"namespace": "/two/"})
    it = SimpleNamespace(graph=graph, life=life, calls=[], running={NODE, "/other"}, killed=[])
    it.listener, it.settings = GraphListener(settings), settings
    it.actions = page.PageCommands(it.listener, settings, tmp_path / "kept", "robo")

    def serve(name, kind, **answer):
        def service(request):
            it.calls.append((name, *(getattr(request, field) for field in request.__slots__)))
            return kind._response_class(**answer)

        rospy.Service(name, kind, service)

    def kill(names):
        it.killed.append(sorted(names))
        life.steps = [lambda: None, lambda: it.running.difference_update(names)]

    def read_launch():
        """Return the arguments of the launch that runs, and its process."""
        while not (text := it.log.read_text()).endswith("\n"):
            pass
        *words, pid = text.split()
        return words, Path("/proc") / pid

    it.serve, it.read_launch, it.log = serve, read_launch, it.actions.directory / "log/nodes.txt"
    roslaunch(RUNS)
    monkeypatch.setattr(rosnode, "get_node_names", lambda: sorted(it.running))
    monkeypatch.setattr(rosnode, "kill_nodes", kill)
    monkeypatch.setattr(rosservice, "get_service_node",
                        lambda name: NODE if name == "/two/controller/start" else None)
    yield it
    it.actions.close()


def use_arm(asked, arm):
    asked.listener.run_trace = RunDrawing(arm)


def test_what_may_be_chosen(asked):
    goals = asked.actions.directory / "goals"
    goals.mkdir(parents=True)
    (goals / "mine.yaml").touch()
    (goals / "2016.yaml").touch()
    found = asked.actions.list_choices()
    assert found["schemes"] == sorted(set(SCHEMES) - {"stereo_points", "stereo_pose"})
    assert found["laws"] == ["adaptive", "diagonal", "pi", "proportional", "sliding_mode"]
    assert found["starts"] == ["none", "2015", "2016"]
    assert found["goals"] == ["auto", "2015", "2016", "mine"]
    assert found["cameras"] == ["calibrated", "fisheye", "noisy", "original", "rolling", "wide"]
    assert found["targets"] == ["aras", "circle", "four_dots", "heptagon", "l_shape", "line_grid",
                                "marker", "poster", "square", "triangle"]
    assert found["gains"] == found["joints"] == []
    asked.graph.parameters |= {f"{NODE}/{key}": f"my {key}"
                               for key in ("scheme", "law", "start", "desired")}
    asked.graph.subscribers[f"{NODE}/gains/parameter_updates"](Config(
        doubles=[DoubleParameter("slope", 0.1 + 0.2), DoubleParameter("gain", 5.0)]))
    use_arm(asked, Arm.from_urdf(ARM, "camera_optical_frame"))
    found = asked.actions.list_choices()
    assert [found[key][-1] for key in ("schemes", "laws", "starts", "goals")] == [
        "my scheme", "my law", "my start", "my desired"]
    assert found["gains"] == ["gain", "slope"] and found["joints"] == ["slide", "elbow"]
    assert asked.actions.gains == {"slope": 0.3, "gain": 5.0}


def test_what_runs_now(asked, monkeypatch):
    actions, told = asked.actions, asked.graph.parameters
    begin = {"scheme": "moments", "law": "proportional", "start": "2016", "goal": "auto"}
    assert actions.read_selection() == {**begin, "camera": "original"}
    actions.selection["target"] = "poster"
    told |= {f"{NODE}/law": "pi", f"{NODE}/desired": 2015, f"{NODE}/gain": 3.0}
    told |= {f"{CAMERA}/width": 321}
    assert actions.read_selection() == {**begin, "law": "pi", "goal": "2015", "camera": "",
                               "target": "poster"}
    told[NODE] = "no namespace"
    assert actions.read_selection() == {**begin, "camera": "", "target": "poster"}
    del told[f"{CAMERA}/width"]
    told[CAMERA] = yaml.safe_load((SOURCES / "aras_visual_servo_gazebo/config/cameras/wide.yaml")
                                  .read_text())
    assert [actions.read_selection()["camera"] for _ in range(2)] == ["wide"] * 2

    def gone(*_):
        raise OSError

    monkeypatch.setattr(rospy, "get_param", gone)
    assert actions.read_selection() == {}


def test_the_loop_and_the_simulation_are_asked_by_their_services(asked):
    actions = asked.actions
    asked.serve("/two/controller/hold", Trigger, success=True, message="hold: holding")
    assert actions.control_loop("hold") == "hold: holding"
    assert asked.life.waited == [("/two/controller/hold", 5.0)]
    words = {"pause_physics": "simulation paused", "unpause_physics": "simulation resumed",
             "reset_simulation": "simulation reset to time 0"}
    for name, said in words.items():
        with pytest.raises(RefusedRequestError,
                           match=rf"^/gazebo/{name} does not answer \(is the simul"):
            actions.control_clock(name)
        asked.serve(f"/gazebo/{name}", Empty)
        assert actions.control_clock(name) == said
    asked.serve("/gazebo/step_world", StepWorld, success=True, sim_time=rospy.Time(3, 5 * 10**8))
    assert actions.step(17) == "17 steps, to 3.500 s" and asked.calls[-1][1] == 17
    asked.serve("/gazebo/step_world", StepWorld, success=False, status_message="time goes on")
    with pytest.raises(RefusedRequestError, match="^time goes on$"):
        actions.step(1)
    def gone(*_):
        raise OSError("gone")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rospy, "wait_for_service", gone)
        with pytest.raises(RefusedRequestError, match="hold does not answer"):
            actions.control_loop("hold")
    for ask in (lambda: actions.control_loop("stop"), lambda: actions.set_gain("gain", 1.0)):
        with pytest.raises(RefusedRequestError,
                           match=r"answer \(is the controller node running\?\)$"):
            ask()
    after = Config(doubles=[DoubleParameter("gain", 2.53217), DoubleParameter("slope", 9.0)])
    asked.serve(f"{NODE}/gains/set_parameters", Reconfigure, config=after)
    assert actions.set_gain("gain", 2.7) == "gain is 2.532"
    assert asked.calls[-1][1].doubles == [DoubleParameter("gain", 2.7)]
    with pytest.raises(RefusedRequestError, match="the running control law has no gain zero"):
        actions.set_gain("zero", 1.0)


def test_nodes_that_servo_are_ended_and_begun_with_what_was_chosen(asked):
    actions, life = asked.actions, asked.life
    asked.graph.parameters[NODE] = {"scheme": "old"}
    actions.gains = {"gain": 3.0}
    assert actions.restart_nodes("points", "pi", "2015", "auto") == (
        "servoing with points, law pi, from 2015 to auto")
    assert asked.killed == [[NODE]] and life.slept == [0.1, 0.1]
    assert NODE not in asked.graph.parameters and actions.gains == {}
    words, first = asked.read_launch()
    assert words == ["aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
                     "scheme:=points", "law:=pi", "start:=2015", "goal:=auto"]
    assert first.exists()
    own = actions.directory / "goals" / "mine.yaml"
    own.parent.mkdir()
    own.touch()
    assert actions.restart_nodes("points", "pi", "none", "mine").endswith("from none to mine")
    words, second = asked.read_launch()
    assert words[-1] == f"goal:={own}" and second.exists() and not first.exists()
    actions.close()
    assert not second.exists()


@pytest.mark.parametrize(("script", "why", "sleeps"), [
    (DIES, "no such scheme", 1), (RUNS, "the nodes do not answer", 600)])
def test_nodes_that_do_not_come_up_are_ended_and_why_is_said(asked, monkeypatch, roslaunch, script,
                                                             why, sleeps):  # fmt: skip
    roslaunch(script)
    asked.running.clear()

    def wait_for_text(_name):
        while asked.log.read_text().count("\n") != script.count("echo"):
            pass
        return "/another"

    monkeypatch.setattr(rosservice, "get_service_node", wait_for_text)
    with pytest.raises(RefusedRequestError, match=f"^the controller did not start: {why}$"):
        asked.actions.restart_nodes("points", "pi", "2015", "auto")
    assert abs(asked.life.slept.count(0.1) - sleeps) < 3
    if script is RUNS:
        assert not asked.read_launch()[1].exists()


def test_whether_a_controller_is_there(asked, monkeypatch):
    for found in ("rosrpc://one:1", None):
        monkeypatch.setattr(rosservice, "get_service_uri", lambda name, found=found: (
            found if name == "/two/controller/start" else "other"))
        assert asked.actions.has_controller() is (found is not None)
    for fault in (OSError, rosservice.ROSServiceException):
        def gone(_name, fault=fault):
            raise fault

        monkeypatch.setattr(rosservice, "get_service_uri", gone)
        monkeypatch.setattr(rosservice, "get_service_node", gone)
        assert asked.actions.has_controller() is True
        asked.running.clear()
        with pytest.raises(RefusedRequestError, match="the nodes do not answer"):
            asked.actions.restart_nodes("points", "pi", "2015", "auto")


def test_a_goal_is_moved_in_the_camera_s_frame_each_time_from_where_it_was(asked, shipped_arm):
    arm = shipped_arm
    use_arm(asked, arm)
    asked.graph.parameters |= {f"{NODE}/law": "pi", f"{NODE}/scheme": "points",
                               f"{NODE}/desired": "2015", f"{NODE}/start": "2016"}
    first = Goal.load(asked.settings.package / "config/goal_2015.yaml").for_arm(arm)
    moved = (0.01, -0.02, -0.01)
    words = asked.actions.move_goal(*moved, 0.0)
    assert words == "servoing with points, law pi, from none to moved"
    path = asked.actions.directory / "goals" / "moved.yaml"
    assert asked.read_launch()[0][2:] == ["scheme:=points", "law:=pi", "start:=none",
                                          f"goal:={path}"]
    assert path.read_text().startswith("# Goal with an offset from the live page.")
    wanted = first.world_T_camera @ matrix_from_xyz_rpy(moved, np.zeros(3))
    made = Goal.load(path)
    np.testing.assert_allclose(made.world_T_camera, wanted, atol=1e-4)
    np.testing.assert_allclose(arm.pose(made.get_joints(arm.names)), wanted, atol=1e-4)
    # The nodes have the moved goal now, and the next way begins where the first one did.
    asked.graph.parameters |= {f"{NODE}/desired": str(path), f"{NODE}/start": "none"}
    asked.actions.move_goal(0.0, 0.0, -0.01, 0.1)
    wanted = first.world_T_camera @ matrix_from_xyz_rpy((0.0, 0.0, -0.01), (0.0, 0.0, 0.1))
    np.testing.assert_allclose(Goal.load(path).world_T_camera, wanted, atol=1e-4)
    asked.actions.restart_nodes("points", "pi", "none", "2016")
    asked.graph.parameters[f"{NODE}/desired"] = "2016"
    asked.actions.move_goal(0.0, 0.0, 0.0, 0.0)
    other = Goal.load(asked.settings.package / "config/goal_2016.yaml").for_arm(arm)
    np.testing.assert_allclose(Goal.load(path).world_T_camera, other.world_T_camera, atol=1e-4)
    # A turn that this arm has but for 0.004 degrees: the goal is what is seen where it can be.
    said = asked.actions.move_goal(0.0, 0.0, 0.0, 0.1)
    made = Goal.load(path)
    wanted = other.world_T_camera @ matrix_from_xyz_rpy(np.zeros(3), (0.0, 0.0, 0.1))
    np.testing.assert_allclose(made.world_T_camera, wanted, atol=2e-4)
    left = wanted[:3, :3].T @ made.world_T_camera[:3, :3]
    angle = np.degrees(np.linalg.norm(left - left.T) / np.sqrt(8.0))
    assert 0.003 < angle < 0.006
    assert said.endswith("to moved; the nearest reachable pose differs from the requested one by "
                         f"0.000 mm and {angle:.3f} degrees")  # fmt: skip
    reached = arm.pose(made.get_joints(arm.names))
    np.testing.assert_allclose(made.world_T_camera, reached, rtol=0.0, atol=1e-9)
    with pytest.raises(RefusedRequestError, match="^this goal is not possible: "):
        asked.actions.move_goal(9.0, 0.0, 0.0, 0.0)
    with pytest.raises(RefusedRequestError, match="the nearest posture found is 19.8 mm"):
        asked.actions.move_goal(0.0, 0.0, 0.02, 0.0)


def test_a_goal_needs_a_robot_and_a_place_to_keep_it(asked, shipped_arm):
    with pytest.raises(RefusedRequestError, match="^there is no robot yet$"):
        asked.actions.move_goal(0.0, 0.0, 0.0, 0.0)
    use_arm(asked, shipped_arm)
    asked.actions.directory.write_text("a file")
    with pytest.raises(RefusedRequestError, match="cannot write"):
        asked.actions.move_goal(0.0, 0.0, 0.0, 0.0)


def serve_robot(asked, **answers):
    there = [ControllerState("arm", "running", "t", []),
             ControllerState("hand", "stopped", "t", [])]
    asked.serve(f"{MANAGER}/list_controllers", ListControllers, controller=there)
    asked.serve("/gazebo/delete_model", DeleteModel, success=True)
    asked.serve("/gazebo/spawn_urdf_model", SpawnModel, success=answers.get("spawned", True),
                status_message="no room")
    asked.serve(f"{MANAGER}/load_controller", LoadController, ok=True)
    asked.serve(f"{MANAGER}/switch_controller", SwitchController, ok=answers.get("switched", True))


def test_a_robot_gets_another_camera_and_its_controllers_again(asked):
    asked.graph.parameters |= {"/robot_description": "<robot/>", CAMERA: {"width": 1, "noise": 2}}
    serve_robot(asked)
    assert asked.actions.change_camera("wide") == "the robot has the camera wide"
    assert asked.calls == [
        (f"{MANAGER}/list_controllers",), ("/gazebo/delete_model", "robo"),
        ("/gazebo/spawn_urdf_model", "robo", "<robot/>", "", Pose(), ""),
        (f"{MANAGER}/load_controller", "arm"), (f"{MANAGER}/load_controller", "hand"),
        (f"{MANAGER}/switch_controller", ["arm"], [], 2, False, 0.0)]
    made = asked.graph.parameters[CAMERA]
    assert made["camera_matrix"]["fx"] == 110.0 and "noise" not in made
    assert asked.actions.selection["camera"] == "wide"
    serve_robot(asked, switched=False)
    with pytest.raises(RefusedRequestError, match="its controllers did not start: reset"):
        asked.actions.change_camera("fisheye")
    serve_robot(asked, spawned=False)
    del asked.graph.parameters[CAMERA]
    with pytest.raises(RefusedRequestError, match="^the robot could not be respawned: no room$"):
        asked.actions.change_camera("fisheye")
    assert asked.actions.selection["camera"] == "wide"
    asked.graph.services.pop("/gazebo/delete_model")
    with pytest.raises(RefusedRequestError,
                       match="^/gazebo/delete_model does not answer: timeout exc"):
        asked.actions.change_camera("fisheye")
    asked.graph.services.pop(f"{MANAGER}/list_controllers")
    with pytest.raises(RefusedRequestError,
                       match=r"answer \(are the robot's controllers loaded\?\)$"):
        asked.actions.change_camera("fisheye")


def test_a_target_is_put_where_the_one_before_lay(asked):
    lay = Pose(Point(0.1, 0.2, 0.3), Quaternion(0.1, 0.2, 0.3, 0.4))
    asked.serve("/gazebo/get_model_state", GetModelState, success=True, pose=lay)
    asked.serve("/gazebo/delete_model", DeleteModel, success=True)
    asked.serve("/gazebo/spawn_urdf_model", SpawnModel, success=True)
    assert asked.actions.change_target("poster") == "the target is poster"
    text = asked.graph.parameters["/target_description"]
    assert "poster" in text
    assert asked.calls == [
        ("/gazebo/get_model_state", "target", ""), ("/gazebo/delete_model", "target"),
        ("/gazebo/spawn_urdf_model", "target", text, "", lay, "")]
    assert asked.actions.selection == {"target": "poster"}
    asked.serve("/gazebo/spawn_urdf_model", SpawnModel, success=False, status_message="no room")
    with pytest.raises(RefusedRequestError, match="^no room$"):
        asked.actions.change_target("circle")
    asked.serve("/gazebo/get_model_state", GetModelState, success=False)
    with pytest.raises(RefusedRequestError, match="no model named target .* with target:=circle"):
        asked.actions.change_target("circle")
    assert asked.actions.selection == {"target": "poster"}
    assert asked.graph.parameters["/target_description"] == text
