"""Systems: stochastic dynamics of agents.

Systems: stochastic dynamics of agents, with their distributions and expressions, on numpy or accelerators.
"""
