"""Assess from one white image how a microlens array is mounted, and what to turn."""
