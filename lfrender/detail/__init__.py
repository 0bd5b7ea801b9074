"""Detail of pictures: noise, blur of the microlenses, and the filter that undoes both."""
