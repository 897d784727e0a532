"""Tasks: an LTL formula over regions, its DFA, and the problem that they make with systems."""
