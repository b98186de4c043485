"""Removes one person from recordings, exports and bags, and verifies that nothing is left.

:mod:`.traces` recognises a person's names and pieces of their data, :mod:`.recordings`,
:mod:`.texts` and :mod:`.bags` rewrite files without the person, and :mod:`.work` searches folders,
plans the changes, executes the plan and searches the remaining files.
"""
