"""Takes one person out of recordings, exports and bags: a plan first, then the work, then a proof.

:mod:`.traces` says what names a person and what of the data would give them away, :mod:`.planning`
looks through folders, :mod:`.recordings`, :mod:`.texts` and :mod:`.bags` write files again without
them, and :mod:`.work` carries the plan out and searches all that is left.
"""
