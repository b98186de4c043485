"""Shimmer3 GSR+ (LogAndStream firmware), over Bluetooth Classic."""
