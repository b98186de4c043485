"""The agent's side of a board that BrainFlow reads."""
