"""Detail of pictures: the noise of the flat, the known blur of its microlenses, and a filter that
undoes it.
"""
