"""Agents, propositions, task automata, problems and the environments that step them."""

if __name__ == "envs":
    raise ImportError("import `certigym.envs`, not `envs`: this folder is a part of the package certigym")
