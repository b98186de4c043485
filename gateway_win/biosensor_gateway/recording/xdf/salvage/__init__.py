"""Rewrites a truncated or damaged recording as far as it can be read.

:mod:`.survey` reads it and determines which bytes to keep, :mod:`.outcome` writes the new file,
and :mod:`.printing` reports what was lost.
"""
