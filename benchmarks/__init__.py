"""Measurements that stand in the documentation, each a command of its own."""
