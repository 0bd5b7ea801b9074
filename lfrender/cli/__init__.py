"""The command line `lfrender`.

Each command reads its inputs, calls functions of the package, and prints figures.
"""
