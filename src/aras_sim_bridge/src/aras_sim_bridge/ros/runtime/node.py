"""The node `gazebo`: it builds the simulation, advertises its ROS interface and shuts it down."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import threading
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import rospy

from aras_sim_bridge.description import world_file
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.errors import SimError, WindowError
from aras_sim_bridge.ros.camera import settings
from aras_sim_bridge.ros.gazebo_api import advertise_gazebo_api
from aras_sim_bridge.ros.gazebo_api.states import ModelStateTopics
from aras_sim_bridge.ros.runtime.clock import ClockPublisher
from aras_sim_bridge.ros.runtime.device_interfaces import DeviceInterfaces
from aras_sim_bridge.ros.runtime.lockstep import Lockstep
from aras_sim_bridge.ros.runtime.node_parameters import NodeParameters
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.restart_record import RestartRecord
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base.compiled import compile_all
from aras_visual_servo_ros.master_watch import MasterWatch
from aras_visual_servo_ros.parameters import InvalidParameterError, get_namespace
from aras_visual_servo_ros.rospy_patches import accept_in_threads
from aras_visual_servo_ros.shutdown import init_node

log = logging.getLogger(__name__)

# Interval at which Python switches threads, s. With the default of 5 ms, the simulation thread
# would wait up to 5 ms for rospy's threads in every step.
SWITCH_INTERVAL = 0.0005
# Time that rospy's threads have at shutdown to send error responses to waiting clients, s.
ERROR_REPLY_TIME = 0.3


class GazeboNode:
    """The simulator node: simulation thread, /clock, lockstep and Gazebo's ROS interface."""

    def __init__(self, parameters: NodeParameters) -> None:
        """Build the simulation, advertise its ROS interface and start simulated time.

        If the parameter `paused` is true, simulated time does not start.

        Raises:
            SimError: the simulation cannot be built.
        """
        self.parameters = parameters
        self.fault: BaseException | None = None
        self._states: ModelStateTopics | None = None
        self.clock = ClockPublisher(parameters.effective_clock_rate)
        self.world_file = world_file.load_world(parameters.world)
        self.thread = SimulationThread(
            self._build,
            make_pacer(parameters, self.world_file),
            after_step=self._after_step,
            after_batch=self._after_batch,
            on_fault=self._on_fault,
            paused=True,  # simulated time starts after all topics and services are advertised
        )
        self.thread.on_time_reset = self._on_time_reset
        self.lockstep: Lockstep | None = None
        if parameters.speed_mode == "lockstep":
            self.lockstep = self.thread.lockstep = Lockstep(
                parameters.lockstep_topics,
                parameters.lockstep_timeout,
                self.thread.receiver.wake,
                parameters.lockstep_period,
            )
        self.thread.start()
        self.restart_record = RestartRecord(parameters.restore)
        before_frame = None if self.lockstep is None else self.lockstep.before_frame
        self.device_interfaces = DeviceInterfaces(self.thread, before_frame, self.restart_record)
        if parameters.enable_ros_network:
            self._states = advertise_gazebo_api(
                self.thread, self.device_interfaces, parameters.extra_interfaces,
                self.world_file.link_attacher,
            )
            settings.mount_world_cameras(self.thread)
            self.device_interfaces.sync()
            self.restart_record.restore()
        if not parameters.paused:
            self.thread.unpause()

    def _on_time_reset(self) -> None:
        self.clock.restart()
        if self.lockstep is not None:
            self.lockstep.end_round()

    def stop(self) -> None:
        """End the simulation; rospy closes the services and topics afterwards."""
        self.thread.stop()
        if self.fault is None:
            # There may be no ROS master any more.
            with contextlib.suppress(OSError, KeyError, rospy.ROSException):
                self.restart_record.clear()

    def _build(self) -> Simulation:
        simulation = build_simulation(self.parameters, self.world_file)
        simulation.before_images = self.clock.publish
        return simulation

    def _after_step(self, time_ns: int) -> None:
        self.clock.update(time_ns)
        if self.lockstep is not None:
            self.lockstep.after_step(time_ns)

    def _after_batch(self, _time_ns: int) -> None:
        if self._states is not None:
            self._states.after_batch(self.thread.simulation)

    def _on_fault(self, error: BaseException) -> None:
        self.fault = error
        rospy.logfatal("the simulation ended: %s: %s", type(error).__name__, error)
        log.debug("", exc_info=error)
        _shut_down("the simulation failed")


def _set_up_log(level: str) -> None:
    """Show the log records of packages that do not use rospy on the console and on /rosout."""
    rosout = logging.getLogger("rosout")
    for name in ("aras_sim_bridge", "aras_visual_servo_base"):
        logger = logging.getLogger(name)
        logger.parent = rosout
        logger.setLevel(level.upper() if level != "warn" else "WARNING")
    if level == "debug":
        rosout.setLevel(logging.DEBUG)


def _shut_down(reason: str) -> None:
    """Log the reason and end the node; may be called from any thread."""
    rospy.logfatal("%s ends: %s", rospy.get_name(), reason)
    rospy.signal_shutdown(reason)


def make_pacer(parameters: NodeParameters, world: WorldFile) -> Pacer:
    """Return the pacer for the parameter speed_mode and the update rate of the world file."""
    factor = parameters.real_time_factor * world.update_rate * world.time_step
    return Pacer(factor if parameters.speed_mode == "real_time" else 0.0)


def build_simulation(parameters: NodeParameters, world: WorldFile) -> Simulation:
    """Return the simulation that the node's parameters and the world file describe."""
    gui = parameters.gui
    if gui and not os.environ.get("DISPLAY"):
        rospy.logwarn("gui is true but DISPLAY is not set; continuing without a window")
        gui = False
    for warning in world.warnings:
        rospy.logwarn("world file: %s", warning)
    scene = world.scene
    if parameters.shadows != "world":
        scene = replace(scene, shadows=parameters.shadows)
    config = SimulationConfig(
        time_step=world.time_step,
        gravity=world.gravity,
        gui=gui,
        renderer=parameters.renderer,
        exposure=parameters.exposure,
        scene=scene,
        seed=parameters.seed,
        legacy_camera_info=parameters.legacy_camera_info,
        ground_plane=world.ground_plane,
        lights=world.lights,
    )
    try:
        simulation = Simulation(config)
    except WindowError as error:
        rospy.logwarn("gui is true but %s; continuing without a window", error)
        simulation = Simulation(replace(config, gui=False))
    simulation.time_ns = world.time_ns
    world_file.populate(partial(simulation.spawn, cameras=settings.read_cameras()), world,
                        partial(rospy.logwarn, "world file: %s"))
    return simulation


class _ShutdownHandler:
    """Handler that ends the node on shutdown, even if the node is still starting."""

    def __init__(self) -> None:
        self.shutdown_event = threading.Event()
        self.node: GazeboNode | None = None
        # rospy calls on_shutdown functions before it closes the topics, so no step uses a closed
        # topic.
        rospy.on_shutdown(self._on_shutdown)
        # If shutdown was requested before this point, rospy does not call _on_shutdown.
        if rospy.core.is_shutdown_requested():
            self.shutdown_event.set()

    def _on_shutdown(self) -> None:
        self.shutdown_event.set()
        if self.node is not None:
            self.node.stop()
            # Give rospy's threads time to send error responses to waiting clients, before rospy
            # closes the connections.
            rospy.rostime.wallsleep(ERROR_REPLY_TIME)


def main(defaults: Mapping[str, object] = MappingProxyType({})) -> int:
    """Run the node `gazebo` and return its exit status.

    defaults: values of the parameters that are not on the parameter server.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    compile_all()
    # Do not subscribe to /clock, because this node publishes it.
    init_node("gazebo", __doc__, disable_rostime=True)
    accept_in_threads()
    shutdown_handler = _ShutdownHandler()
    try:
        values = {**defaults, **get_namespace("~")}
        parameters = NodeParameters.from_mapping(values, rospy.get_name())
        _set_up_log(parameters.log_level)
        if not rospy.has_param("/use_sim_time"):
            rospy.set_param("/use_sim_time", True)
        node = GazeboNode(parameters)
    except (SimError, InvalidParameterError, OSError, rospy.ROSException) as error:
        if not shutdown_handler.shutdown_event.is_set():
            _shut_down(f"it cannot start: {error}")
        return 1
    shutdown_handler.node = node
    if shutdown_handler.shutdown_event.is_set():
        node.stop()
    MasterWatch(rospy.get_name(), parameters.master_check_period).watch(_shut_down)
    rospy.loginfo("%s is up, process %d", rospy.get_name(), os.getpid())
    shutdown_handler.shutdown_event.wait()
    node.stop()
    return 0 if node.fault is None else 1
