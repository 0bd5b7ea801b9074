"""Check a calibration on a flat, compare two calibrations, draw a calibration."""
