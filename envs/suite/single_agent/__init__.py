"""The named problems of one agent, a file each."""
