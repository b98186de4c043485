"""Says what all programs of the project ask of LSL in the same way."""
