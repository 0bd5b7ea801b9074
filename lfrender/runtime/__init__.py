"""Tools below the mathematics: caches, words of options."""
