"""The discs over which microlenses blur: from rims of white images (`rims`, `microimages`) and from
captures (`captures`).
"""
