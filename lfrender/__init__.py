"""Depth analysis and rendering of focused plenoptic flats."""
