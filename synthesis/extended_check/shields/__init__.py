"""Action values, and shields that go by them.

Action values under a certificate, and shields that let a learner do what keeps a probability.
"""

from .q_values import action_values
from .shield_record import ProductShield, Shield, shield_of
from .shield_rule import Choice

__all__ = [
    "Choice",
    "ProductShield",
    "Shield",
    "action_values",
    "shield_of",
]
