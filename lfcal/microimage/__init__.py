"""Properties of single microimages that many rooms ask for: whether their lenses are lit."""
