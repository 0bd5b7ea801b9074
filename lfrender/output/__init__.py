"""Files of results: pictures, animations, depth in colours, point clouds, metadata.

Also the errors of results against known truth, and the intermediate results of long runs.
"""
