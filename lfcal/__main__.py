"""`python -m lfcal`: the command line."""

from .cli.main import main

main(prog_name="lfcal")
