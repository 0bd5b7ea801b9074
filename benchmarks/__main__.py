"""Benchmarks as commands: `python -m benchmarks run`, `compare` or `stress`."""

from __future__ import annotations

import sys


def main(arguments: list[str]) -> None:
    """Run the benchmark that the first argument names."""
    command, rest = (arguments[0], arguments[1:]) if arguments else ("", [])
    if command == "stress":
        from .stress.command import main as stress

        stress(rest)
    elif command == "run":
        from .pareto.command import main as run

        run(rest)
    elif command == "compare":
        from .pareto.compare import main as compare

        compare(rest)
    else:
        sys.exit(f"{__doc__}\nEach tells its options with --help.")


if __name__ == "__main__":
    main(sys.argv[1:])
