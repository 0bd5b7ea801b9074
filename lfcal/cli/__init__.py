"""The command line `lfcal`: calibrate a camera, show, compare and convert camera files."""
