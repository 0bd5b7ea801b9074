"""Benchmark of captures saved in other ways: every form is compared with the flat as it is where that lies in it."""

from __future__ import annotations

import re

import cv2

from benchmarks import saved_forms


def test_forms_of_a_flat_have_its_centres_and_mode(house, tmp_path, capsys):
    path = tmp_path / "house.png"
    cv2.imwrite(str(path), house.flat[:, :, ::-1])
    saved_forms.main([str(path)])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 17
    for line in lines:
        off = re.search(r"centres off by ([\d.]+) pitches", line)
        assert off is not None and float(off[1]) < 0.05, line
    shares = [float(line.split("; ")[1].split(" %")[0]) for line in lines]
    assert 50 < shares[0] < 100
    assert max(abs(share - shares[0]) for share in shares) < 4
    assert "off by 0.0000 pitches" in lines[0]
