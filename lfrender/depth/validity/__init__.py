"""Which lenses are resolved, the reason why others are not, and how reliable each depth is.

From matches, sub-pixel fits and neighbours: too little texture, ambiguous or periodic texture,
unshared content.
"""
