"""The world that virtual devices share: wearer, crystal, faults and links."""
