"""Bytes in, one row of numbers for each line or record out."""
