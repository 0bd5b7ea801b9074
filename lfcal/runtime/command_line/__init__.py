"""What command lines are made of: programs, parameters, progress and figures, Ctrl-C."""

from .parameters import BalanceValue, ExposureValue, OutputPath, Pair, Quantity, several_inputs
from .program import (
    DARK,
    INPUT,
    READING,
    SIZE,
    Program,
    command,
    option,
    output_option,
    report_options,
    with_options,
)
from .report import Report, echo, name_file_in_errors
from .result import Result, json_schema, results_of

__all__ = [
    "DARK",
    "INPUT",
    "READING",
    "SIZE",
    "BalanceValue",
    "ExposureValue",
    "OutputPath",
    "Pair",
    "Program",
    "Quantity",
    "Report",
    "Result",
    "command",
    "echo",
    "json_schema",
    "name_file_in_errors",
    "option",
    "output_option",
    "report_options",
    "results_of",
    "several_inputs",
    "with_options",
]
