"""`python -m data_synth`: the command line."""

from .cli import main

main(prog_name="lfsynth")
