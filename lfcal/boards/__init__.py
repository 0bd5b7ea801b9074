"""Calibration boards: drawn for print, found on flats, their corners fitted in microimages."""
