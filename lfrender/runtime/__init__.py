"""Tools below the mathematics: caches, buffers, words of options."""
