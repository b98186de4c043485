"""What runs in a process, and maybe in a Python, of its own: BrainFlow is never in the agent's."""
