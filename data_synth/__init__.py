"""Simulated focused plenoptic cameras with known truth."""
