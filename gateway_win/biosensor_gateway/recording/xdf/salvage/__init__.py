"""Rewrites a truncated or damaged recording as far as it can be read.

:mod:`.survey` reads it and determines which bytes to keep, and :mod:`.outcome` writes the
new file and reports what was lost.
"""
