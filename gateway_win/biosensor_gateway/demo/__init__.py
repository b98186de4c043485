"""The pair end to end with virtual devices."""
