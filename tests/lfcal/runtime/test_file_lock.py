"""A locked file names the process that has the lock, and is free again when that process ends."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest

from lfcal import OutputError
from lfcal.runtime.file_lock import file_lock
from lfcal.runtime.output_file import claim

pytest.importorskip("fcntl")

_HOLD = """
import sys, time
from pathlib import Path
from lfcal.runtime.file_lock import file_lock
with file_lock(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    """A process that has the lock of a file."""
    command = [sys.executable, "-c", _HOLD, str(tmp_path / ".picture.tif.lock")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "locked\n"
        yield process
        process.kill()


def test_an_output_that_another_process_writes_is_refused_and_the_process_named(tmp_path, holder):
    found = rf"is being written by process {holder.pid} on \S+ since \d{{4}}-\d\d-\d\d \d\d:"
    with pytest.raises(OutputError, match=found), claim(tmp_path / "picture.tif"):
        pytest.fail("both write")
    with claim(tmp_path / "another.tif"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == [".picture.tif.lock"]


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path, holder):
    holder.kill()
    holder.wait()
    lock = tmp_path / ".picture.tif.lock"
    assert str(holder.pid) in lock.read_text()
    with claim(tmp_path / "picture.tif"):
        assert lock.read_text().startswith(f"process {os.getpid()} on ")
    assert not lock.exists()


def test_a_thread_may_claim_twice_and_another_thread_not(tmp_path):
    errors = []

    def another():
        try:
            with claim(tmp_path / "picture.tif"):
                pass
        except OutputError as error:
            errors.append(error)

    with claim(tmp_path / "picture.tif"):
        with claim(tmp_path / "picture.tif"):
            pass
        thread = threading.Thread(target=another)
        thread.start()
        thread.join()
    assert len(errors) == 1
    another()
    assert len(errors) == 1


def test_whoever_waits_gets_the_lock_after_the_others_though_they_remove_the_file(tmp_path):
    at_once = 0
    most = 0

    def work():
        nonlocal at_once, most
        for _ in range(50):
            with file_lock(tmp_path / "lock", wait=True):
                at_once += 1
                most = max(most, at_once)
                at_once -= 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == 1
    assert not (tmp_path / "lock").exists()


def test_a_folder_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(OutputError, match=r"picture\.tif: cannot be written"):  # noqa: SIM117
        with claim(tmp_path / "none" / "picture.tif"):
            pass
