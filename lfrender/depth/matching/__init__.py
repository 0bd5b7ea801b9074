"""Correlates neighbouring microimages at signed shifts and picks one shift per lens by semi-global
matching.

Takes a grey flat with its texture, gives a `MatchResult`: patch size to a fraction of a shift step,
its probability, and the next best one. For `estimate`, which refines it, and for all stages that
check a known depth.
"""
