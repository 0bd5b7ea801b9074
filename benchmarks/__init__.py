"""Measurements that stand in the documentation, each a command of its own."""

from .outdated_kernels import discard_outdated

discard_outdated()
