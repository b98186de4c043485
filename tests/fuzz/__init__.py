"""Fuzzing of everything that reads what devices, other programs or people have written.

:mod:`.targets` has one function for each reader, which says what must hold for any
bytes; ``corpus/<target>/`` has the inputs from which it is tried. Two runners use them:
``test_corpus.py`` replays the corpora, and ``python -m tests.fuzz`` looks for new
inputs, guided by coverage where atheris runs and with hypothesis elsewhere.
"""
