"""The shared parts of virtual devices: world, wearer, oscillator, faults and links."""
