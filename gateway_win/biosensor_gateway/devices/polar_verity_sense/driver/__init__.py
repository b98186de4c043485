"""Leads the conversation with the device; what it shares with the strap is that one's."""
