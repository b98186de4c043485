"""Builds the Windows installer: on Linux under Wine, and on Windows itself."""
