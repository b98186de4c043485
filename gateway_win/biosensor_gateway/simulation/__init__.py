"""What virtual devices share: their world, wearer, crystal, faults and links."""
