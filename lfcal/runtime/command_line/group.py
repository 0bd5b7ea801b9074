"""Groups of commands, listed by workflow, whose user errors are one line on stderr and exit code 2."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import cloup

from ..errors import LightFieldError
from .path_arguments import suggest_similar_names
from .pipes import name_pipes, write_to_stdout

__all__ = ["Command", "CommandGroup", "command", "grouped"]

_USER_ERROR = 2  # exit code


class Command(cloup.Command):
    """A command whose summary in the list of commands is the first sentence of its help, whole."""

    def get_short_help_str(self, limit: int = 0) -> str:
        paragraph = " ".join((self.help or "").partition("\n\n")[0].split())
        return paragraph.partition(". ")[0].rstrip(".") + "."


class CommandGroup(cloup.Group):
    """A command group whose user errors are one line on stderr and exit code 2.

    Parameters
    ----------
    other_programs : mapping of str to str, optional
        Commands of other programs that users look for here, and the program that has each, for the error message.
    file_command : str, optional
        Command to propose where a file is given in the place of a command, with `{}` for the file.
    """

    command_class = Command

    def __init__(
        self, *args: Any, other_programs: Mapping[str, str] | None = None, file_command: str = "", **kwargs: Any
    ):
        super().__init__(*args, **kwargs)
        self.other_programs = dict(other_programs or {})
        self.file_command = file_command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        name = args[0]
        if self.get_command(ctx, name) is None and not ctx.resilient_parsing:
            if name in self.other_programs:
                ctx.fail(f"No such command {name!r}. Did you mean '{self.other_programs[name]} {name}'?")
            if self.file_command and Path(name).is_file():
                ctx.fail(f"No such command {name!r}. Did you mean '{self.name} {self.file_command.format(name)}'?")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        with suggest_similar_names(ctx):
            code = super().invoke(ctx)
        write_to_stdout(ctx)
        return code

    def main(self, *args: Any, **kwargs: Any) -> Any:
        kwargs["standalone_mode"] = False
        if "numpy" not in sys.modules:
            # For matrices as small as ours, threads that wait for each other take several times as long.
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        try:
            # Python warnings are for developers; results have warnings of their own for users.
            with warnings.catch_warnings():
                if not sys.warnoptions:
                    warnings.simplefilter("ignore")
                code = super().main(*args, **kwargs)
        except click.exceptions.NoArgsIsHelpError as error:
            click.echo(error.ctx.get_help() if error.ctx else str(error), err=True)
            sys.exit(_USER_ERROR)
        except click.UsageError as error:
            message = error.format_message()
            if error.ctx:
                message += f"{'' if message.endswith(('.', '?', ')')) else '.'} See '{error.ctx.command_path} --help'."
            self._fail(message)
        except click.ClickException as error:
            self._fail(error.format_message())
        except LightFieldError as error:
            self._fail(str(error))
        except MemoryError:
            self._fail("not enough memory for an image of this size")
        except BrokenPipeError:
            # The reader of our output has ended; without this Python reports it again when it flushes at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(1)
        except OSError as error:
            self._fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        except (KeyboardInterrupt, click.Abort):
            click.echo("interrupted", err=True)
            sys.exit(130)
        sys.exit(code if isinstance(code, int) else 0)

    def _fail(self, message: str) -> None:
        click.echo(f"{self.name or 'error'}: {name_pipes(' '.join(message.split()))}", err=True)
        sys.exit(_USER_ERROR)


def grouped(title: str, *options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Give a command some options, under a title of their own in its help."""
    return cloup.option_group(title, *options)


def command(*examples: str) -> Callable[[Any], Command]:
    """Make a function a command, whose help ends with examples of how it is called."""
    lines = "\n".join(f"  {line}" for line in examples)
    return cloup.command(cls=Command, epilog=f"\b\nExamples:\n{lines}")
