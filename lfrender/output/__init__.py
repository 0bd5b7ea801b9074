"""Files of results: pictures, stacks, animations, depth in colours, point clouds; their formats and
metadata.

Also the errors of results against known truth, and the intermediate results of long runs.
"""
