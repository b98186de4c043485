"""Vernier Go Direct respiration belt (GDX-RB), over Bluetooth LE."""
