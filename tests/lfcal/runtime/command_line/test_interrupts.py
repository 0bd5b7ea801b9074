"""Ctrl-C ends a command, wherever it lands, and leaves no unfinished file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

PROGRAM = """
import os, signal, sys, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
import cloup
from lfcal.runtime.command_line import Program
from lfcal.runtime.output_file import atomic_write

@cloup.group(cls=Program, name="program", others=("other", ""))
def main():
    pass

@main.command()
def work():
    lock = Lock()
    lock.acquire()
    ThreadPoolExecutor(1).submit(lock.acquire)  # the interpreter would join it for ever
    with atomic_write(Path(sys.argv[2])):
        try:
            print("ready", flush=True)
            time.sleep(60)
        finally:
            {unwind}

sys.argv, path = [sys.argv[0], "work"], sys.argv[1]
sys.argv.append(path)
main(args=["work"])
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for one process")
@pytest.mark.parametrize(
    ("unwind", "interrupts", "most"),
    [("pass", 1, 3.0), ("lock.acquire()", 1, 8.0), ("lock.acquire()", 2, 3.0)],
)
def test_an_interrupt_ends_the_process_though_a_thread_waits_for_ever(
    tmp_path, unwind, interrupts, most
):
    command = [sys.executable, "-c", PROGRAM.format(unwind=unwind), str(tmp_path / "output.tif")]
    default = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    with subprocess.Popen(command, stdout=subprocess.PIPE, preexec_fn=default) as process:
        try:
            assert process.stdout.readline() == b"ready\n"
            start = time.monotonic()
            for _ in range(interrupts):
                process.send_signal(signal.SIGINT)
                time.sleep(0.3)
            assert process.wait(timeout=30) == 130
            assert time.monotonic() - start < most
        finally:
            process.kill()
    assert os.listdir(tmp_path) == []


SERVE = """
import time
import cloup
from lfcal.runtime.command_line import Program
from lfcal.runtime.command_line.interrupts import end_by_interrupt

@cloup.group(cls=Program, name="program", others=("other", ""))
def main():
    pass

@main.command()
def serve():
    with end_by_interrupt():
        print("ready", flush=True)
        time.sleep(60)
    time.sleep(5)
    print("recording is written")

main(args=["serve"])
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for one process")
def test_what_follows_an_interrupt_that_ends_a_page_has_time(tmp_path):
    default = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    with subprocess.Popen(
        [sys.executable, "-c", SERVE], stdout=subprocess.PIPE, preexec_fn=default
    ) as process:
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.read() == b"recording is written\n"
        assert process.wait(timeout=30) == 0


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for one process")
def test_an_error_that_a_library_makes_of_an_interrupt_is_no_traceback(tmp_path):
    default = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    program = PROGRAM.format(unwind="raise ImportError('half imported') from None")
    command = [sys.executable, "-c", program, str(tmp_path / "output.tif")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=default
    ) as process:
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 130
        assert process.stderr.read() == b""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for one process")
@pytest.mark.parametrize("name", ["lfcal", "lfrender"])
def test_an_interrupt_while_the_command_line_is_loaded_ends_without_a_traceback(tmp_path, name):
    # The command line imports click: a slow one stands in for all that is loaded.
    slow = "import time\nprint('loading', flush=True)\ntime.sleep(60)\n"
    (tmp_path / "click.py").write_text(slow)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    default = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    with subprocess.Popen(
        [sys.executable, "-m", name, "--help"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path},
        preexec_fn=default,
    ) as process:
        assert process.stdout.readline() == b"loading\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == -signal.SIGINT
        assert process.stderr.read() == b""
