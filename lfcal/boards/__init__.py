"""Boards of known points: made to print, found on flats, their corners located in single
microimages.
"""
