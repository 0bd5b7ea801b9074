"""Assess how a microlens array is mounted: what to turn, from one white image, with errors and
verdicts in words.
"""
