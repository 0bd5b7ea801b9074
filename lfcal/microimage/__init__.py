"""Properties of microimages that many rooms ask for: lit lenses, profiles over many pixels."""
