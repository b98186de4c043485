"""The contents of recordings, piece by piece."""
