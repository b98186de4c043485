"""Runs BrainFlow in a separate process, possibly with a different Python."""
