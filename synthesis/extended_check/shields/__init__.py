"""Action values, and shields that go by them.

Action values under a certificate, and shields that let a learner do what keeps a probability.
"""

from .q_values import ActionValues, action_values
from .shield_record import FORMS, ProductShield, Shield, shield_of
from .shield_rule import Case, Choice, decentralised_choice, joint_choice

__all__ = [
    "ActionValues",
    "Case",
    "Choice",
    "FORMS",
    "ProductShield",
    "Shield",
    "action_values",
    "decentralised_choice",
    "joint_choice",
    "shield_of",
]
