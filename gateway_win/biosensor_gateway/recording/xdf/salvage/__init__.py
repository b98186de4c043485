"""Rewrites a cut or damaged recording as far as it can be read.

:mod:`.survey` reads it and says which bytes to keep, :mod:`.kept` what is known of each
stream by then, :mod:`.rewriting` writes the other file, and :mod:`.outcome` and :mod:`.printing`
tell what was lost.
"""
