"""Services of libgazebo_ros_link_attacher.so, for worlds that contain this plug-in."""

from __future__ import annotations

from gazebo_ros_link_attacher.srv import Attach, AttachRequest

from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world.attachments import LinkPair

NAMESPACE = "/link_attacher_node"


@service_handler(Attach)
def attach(simulation: Simulation, request: AttachRequest) -> Fields:
    """Fix the second link of the request to the first one, at their current relative pose."""
    simulation.world.attachments.attach(_read_links(request))


@service_handler(Attach)
def detach(simulation: Simulation, request: AttachRequest) -> Fields:
    """Release the second link of the request from the first one.

    The links must be in the same order as in the request for `attach`.
    """
    simulation.world.attachments.detach(_read_links(request))


def _read_links(request: AttachRequest) -> LinkPair:
    return LinkPair(request.model_name_1, request.link_name_1, request.model_name_2,
                request.link_name_2)
