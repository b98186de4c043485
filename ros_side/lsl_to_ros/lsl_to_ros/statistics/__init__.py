"""Counts received and lost samples, and converts their stamps."""
