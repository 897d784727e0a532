"""Action values, and shields that go by them.

Action values under a certificate, and shields that let a learner do what keeps a probability.
"""

from .shield_record import ProductShield, Shield, shield_of
