"""The program `lfrender`, and `python -m lfrender`.

Until a command begins there is nothing to clean up: Ctrl-C ends the process at once, without a
traceback.
"""

import signal


def run() -> None:
    """Run the command line in this process."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from lfrender.cli.main import main

    main(prog_name="lfrender")


if __name__ == "__main__":
    run()
