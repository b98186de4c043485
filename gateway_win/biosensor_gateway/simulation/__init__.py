"""What virtual devices share: world, wearer, oscillator, faults and links."""
