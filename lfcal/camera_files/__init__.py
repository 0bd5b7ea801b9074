"""Read and write camera files: our own JSON, and three formats of other programs."""
