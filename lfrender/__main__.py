"""The program `lfrender`, and `python -m lfrender`: the command line, which Ctrl-C ends while it is
loaded too.
"""

from lfcal.runtime.interrupts import run_program


def run() -> None:
    """Run the command line in this process."""
    run_program("lfrender")


if __name__ == "__main__":
    run()
