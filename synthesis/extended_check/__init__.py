"""The extended check: proofs on cells done again.

The extended check: certificates on cells proved again, by code that no search reaches, and shields.
"""
