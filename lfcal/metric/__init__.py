"""Metric calibration: optics of the camera, with covariance, from flats of a board."""
