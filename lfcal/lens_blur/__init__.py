"""The discs over which microlenses blur, from rims of white images, boards and captures."""
