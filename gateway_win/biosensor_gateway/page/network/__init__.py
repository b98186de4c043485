"""The LSL streams of the network, ours and other programs', as the source of the page."""
