"""Simulation relations between an agent and a grid of cells.

Simulation relations between a continuous agent and a grid of cells, and how surely they hold.
"""
