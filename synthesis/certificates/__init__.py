"""Certificates: the claim, what it rests on, and its file.

Certificates: the claim, the proof that it rests on, and its file.
"""
