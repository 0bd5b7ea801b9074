"""Detail of pictures: the blur of the microlenses, measured on the flat, and a filter that undoes it."""
