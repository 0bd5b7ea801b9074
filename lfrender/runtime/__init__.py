"""Tools below the mathematics: caches, buffers, quantiles."""
