"""The build on Linux: a Windows Python under Wine freezes the program."""
