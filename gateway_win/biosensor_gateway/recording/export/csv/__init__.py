"""Exports to CSV, exact to the last bit.

:mod:`.wide` writes a table for each stream, with one column per channel; :mod:`.long` writes one
table for all, with one row per value. Lines end in LF, decimals have a point, texts are quoted by
RFC 4180, all is UTF-8.
"""
