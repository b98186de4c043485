"""Withdrawal: a participant's device sends nothing until it is taken up again."""
