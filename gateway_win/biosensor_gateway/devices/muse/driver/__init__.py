"""Leads the conversation with the headband, and turns what it sends into samples."""
