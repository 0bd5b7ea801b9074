"""Tools below the mathematics: caches, buffers, loop order, LLVM intrinsics, quantiles, small normal equations."""
