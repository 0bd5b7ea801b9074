"""`python -m lfrender`: the command line."""

from .cli.main import main

main(prog_name="lfrender")
