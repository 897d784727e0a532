"""Certificates: the claim, the proof that it rests on, and its file."""
