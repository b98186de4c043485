"""The agent's side of a line sensor."""
