"""The depth of every scene point, from the depths of the lenses around it and the pixels that show
it.

Second layers and thin structures add depths; hypotheses compete per point by photoconsistency.
"""
