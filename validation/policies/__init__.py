"""Policies trained, compared, and behind shields.

Policies of any origin, trained, compared and run behind shields.
"""

from .actors import NotAnActor, load_actor, save_actor
from .behind import shield
from .comparison import Comparison, compare
from .competitors import Sources, given, label_of, publish
from .probing import Attempt, Probe, probe
from .ranking import Leaderboard, Standing, judged, judging_plan, leaderboard, replayed
from .ranking_page import page_of
from .recording import Recording, record, record_tiers
from .rollout_policies import IdleController, RandomController, as_controller
from .smoothing import smoothed
from .tier_rule import tier_of
from .training import ALGORITHMS, Training, certificate_of, train
