"""The program `lfcal`, and `python -m lfcal`: the command line, which Ctrl-C ends while it is
loaded too.
"""

from lfcal.runtime.interrupts import run_program


def run() -> None:
    """Run the command line in this process."""
    run_program("lfcal")


if __name__ == "__main__":
    run()
