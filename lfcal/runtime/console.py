"""What command lines share, in one place: see the modules of `command_line`."""

from .command_line.group import Command, CommandGroup, command, grouped
from .command_line.path_arguments import (
    InputPath,
    OutputPath,
    SizeOption,
    page_option,
    raw_video_options,
    several_inputs,
    single_input,
)
from .command_line.report import Report, name_file_in_errors, report_options

__all__ = [
    "Command",
    "CommandGroup",
    "InputPath",
    "OutputPath",
    "Report",
    "SizeOption",
    "command",
    "grouped",
    "name_file_in_errors",
    "page_option",
    "raw_video_options",
    "report_options",
    "several_inputs",
    "single_input",
]
