"""The named problems of several agents, a file each."""
