"""Tasks: regions, an LTL formula, its DFA, the problem.

Tasks: an LTL formula over regions, its DFA, and the problem that they make with systems.
"""
