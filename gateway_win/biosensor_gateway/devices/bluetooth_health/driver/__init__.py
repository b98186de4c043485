"""Leads the conversation with the device, and turns what it sends into samples."""
