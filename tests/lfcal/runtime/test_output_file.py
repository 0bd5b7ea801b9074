"""Output files appear whole or not at all."""

from __future__ import annotations

import os
import stat

import pytest

from lfcal import OutputError
from lfcal.runtime.output_file import atomic_write, check_folder, check_output, make_folder


def test_file_appears_with_its_content_and_ordinary_permissions(tmp_path):
    with atomic_write(tmp_path / "a.json") as temporary:
        assert temporary.suffix == ".json"
        assert not (tmp_path / "a.json").exists()
        temporary.write_text("42")
    assert (tmp_path / "a.json").read_text() == "42"
    assert os.listdir(tmp_path) == ["a.json"]
    (tmp_path / "ordinary").touch()
    assert stat.S_IMODE((tmp_path / "a.json").stat().st_mode) == stat.S_IMODE(
        (tmp_path / "ordinary").stat().st_mode
    )


def test_nothing_is_left_and_the_old_file_stays_when_writing_fails(tmp_path):
    (tmp_path / "a.json").write_text("old")
    with pytest.raises(KeyError), atomic_write(tmp_path / "a.json") as temporary:
        temporary.write_text("half of the n")
        raise KeyError
    assert os.listdir(tmp_path) == ["a.json"]
    assert (tmp_path / "a.json").read_text() == "old"


def test_operating_system_errors_have_the_name_of_the_file(tmp_path):
    with (
        pytest.raises(OutputError, match=r"a\.json: cannot be written"),
        atomic_write(tmp_path / "no" / "a.json"),
    ):
        pass


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("a.txt", "unknown output format"),
        ("a", "unknown"),
        ("no/a.json", "does not exist"),
        ("dir.json", "is a folder"),
    ],
)
def test_impossible_outputs_are_refused_beforehand(tmp_path, name, reason):
    (tmp_path / "dir.json").mkdir()
    with pytest.raises(OutputError, match=reason):
        check_output(tmp_path / name, {".json"})


def test_possible_outputs_leave_no_trace(tmp_path):
    check_output(tmp_path / "a.JSON", {".json"})
    assert os.listdir(tmp_path) == []


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError):
        check_output(tmp_path / "file" / "a.json", {".json"})


def test_an_input_is_not_replaced(tmp_path):
    (tmp_path / "a.json").touch()
    with pytest.raises(OutputError, match="input"):
        check_output(tmp_path / "a.json", {".json"}, [None, tmp_path / "." / "a.json"])
    check_output(tmp_path / "a.json", {".json"}, [tmp_path / "b.json"])


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="there is no such file system here")
@pytest.mark.parametrize("name", ["/proc", "/proc/new"])
def test_a_folder_in_which_nothing_can_be_written_is_refused_beforehand(name):
    with pytest.raises(OutputError, match="cannot be written"):
        check_folder(name)


def test_folders_above_a_new_one_must_exist_unless_they_are_made_too(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        check_folder(tmp_path / "a" / "b")
    assert check_folder(tmp_path / "a" / "b", parents=True) == tmp_path / "a" / "b"
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="does not exist"):
        check_folder(tmp_path / "file" / "b" / "c", parents=True)
    assert os.listdir(tmp_path) == ["file"]


def test_a_folder_that_is_named_like_a_file_is_refused_until_it_exists(tmp_path):
    for name in ("bt.jpg", "v.glb", "film.mov"):
        with pytest.raises(OutputError, match="for a folder leave out"):
            make_folder(tmp_path / name)
    assert os.listdir(tmp_path) == []
    for name in ("plain", "run.1", "2026.11.26", "v1.0"):
        assert make_folder(tmp_path / name).is_dir()
    (tmp_path / "exp.raw").mkdir()
    assert check_folder(tmp_path / "exp.raw").is_dir()
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="is a file"):
        check_folder(tmp_path / "file")
