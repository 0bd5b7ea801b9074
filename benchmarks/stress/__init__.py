"""Stress tests of every stage: `python -m benchmarks stress [--full]`."""
