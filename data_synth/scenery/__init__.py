"""What the surfaces of simulated scenes show: procedural textures, a facade, branches and leaves,
as arrays.
"""
