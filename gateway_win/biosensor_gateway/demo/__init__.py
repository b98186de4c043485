"""Agent and node end to end with virtual devices."""
