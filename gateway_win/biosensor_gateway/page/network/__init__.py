"""The streams of the network as the source of the page: ours and other programs'."""
