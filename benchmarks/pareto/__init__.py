"""Run time against error of every method and setting (`python -m benchmarks run`), and the
comparison of two runs.
"""
