"""Light and its numbers: tone curves, brightness, white balance, and the blur of optics."""
