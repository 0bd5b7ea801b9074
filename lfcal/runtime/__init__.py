"""Base of both packages: errors, files, command lines, notebooks, kernels, arrays."""
