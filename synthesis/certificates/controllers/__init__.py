"""Controllers that carry a policy out.

Controllers that carry a policy out, and policies that come from elsewhere.
"""

from .agent_controller import AgentController
from .controller import Controller
from .given_policies import LOCAL, Decentralised, InputTable, Policy, Vectorized, decentralised, vectorized
from .network_controller import JointNetworkController, NetworkController
from .path_controller import PathController
from .path_covariances import covariances_along
from .product_controller import ProductController
from .timed_controller import TimedController
from .vertex_controller import VertexController, interpolated
