"""Commands that measure the figures of the documentation."""

from .outdated_kernels import discard_outdated

discard_outdated()
