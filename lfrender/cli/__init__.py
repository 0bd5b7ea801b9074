"""The command line `lfrender`: each command reads its inputs, calls the functions of the package
and prints figures.
"""
