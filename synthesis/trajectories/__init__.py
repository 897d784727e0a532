"""Nominal trajectories with feedback, in reachable sets.

Nominal trajectories with feedback: reachable sets, and the chance that they keep to the task.
"""
