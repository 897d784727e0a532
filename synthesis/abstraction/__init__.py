"""Finite Markov models, and the product automaton.

Abstraction: a finite Markov model of each agent, and the product automaton of models and task.
"""
