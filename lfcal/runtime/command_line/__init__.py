"""What command lines are made of: programs, parameters, progress and figures, Ctrl-C."""

from .parameters import ExposureValue, InputPath, OutputPath, Pair, Quantity, several_inputs
from .program import Program, command, option, report_options, with_options
from .report import Report, echo, name_file_in_errors

__all__ = [
    "ExposureValue",
    "InputPath",
    "OutputPath",
    "Pair",
    "Program",
    "Quantity",
    "Report",
    "command",
    "echo",
    "name_file_in_errors",
    "option",
    "report_options",
    "several_inputs",
    "with_options",
]
