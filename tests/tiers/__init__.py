"""The three tiers of tests: unit, seams, nightly."""
