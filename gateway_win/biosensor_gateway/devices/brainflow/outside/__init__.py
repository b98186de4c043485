"""Runs BrainFlow in a process, and maybe in a Python, of its own: it is never in the agent's."""
