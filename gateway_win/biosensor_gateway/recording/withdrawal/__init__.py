"""Removes one person from recordings, exports and bags, and verifies that nothing is left.

:mod:`.traces` recognises a person's names and pieces of their data and rewrites text files without
the person, :mod:`.recordings` rewrites recordings, and :mod:`.work` searches folders and bags,
plans the changes, executes the plan and searches the remaining files.
"""
