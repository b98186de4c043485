"""The world that virtual devices share: wearer, oscillator, faults and links."""
