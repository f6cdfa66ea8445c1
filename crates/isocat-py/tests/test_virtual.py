"""Unmodified programs on a virtual segment, from Python."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import isocat
import pytest

PROGRAM = """
import socket, sys
s = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x88A4))
s.bind((sys.argv[1], 0))
body = bytes([7, 0, 0, 0, 0x30, 0x01, 2, 0, 0, 0, 0, 0, 0, 0])
head = b"\\xff" * 6 + b"\\x02\\0\\0\\0\\0\\x01\\x88\\xa4"
s.send((head + (0x1000 | len(body)).to_bytes(2, "little") + body).ljust(60, b"\\0"))
answer = s.recv(1514)
print("devices", answer[28])
sys.exit(int(sys.argv[2]))
"""


@pytest.fixture
def program(tmp_path: Path) -> list[str]:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    try:
        isocat.virtual([sys.executable, str(path), "vt0", "0"])
    except isocat.InputError as error:
        if "supervise" in str(error) or "kernel" in str(error):
            pytest.skip(f"programs can't be supervised here: {error}")
        raise
    return [sys.executable, str(path), "vt0"]


def test_a_program_for_each_seed(program: list[str], pair: isocat.Segment) -> None:
    runs = isocat.virtual([*program, "0"], pair, seeds=range(7, 10), lateness="50us")
    assert [run.seed for run in runs] == [7, 8, 9] and len(runs.rows()) == 3
    for run in runs:
        assert "devices 2" in run.output and run.verdict == "not-known" and run.code == 3
        assert run.summary["frames"] == 1
    assert not runs.in_sync and len(runs.failed) == 3


def test_what_is_varied(program: list[str], pair: isocat.Segment) -> None:
    runs = isocat.virtual([*program, "0"], pair, grid={"subdevice[*].cable": ["1m", "100m"]})
    assert [run.values for run in runs] == [
        {"subdevice[*].cable": "1m"},
        {"subdevice[*].cable": "100m"},
    ]


def test_bad_input(program: list[str]) -> None:
    with pytest.raises(isocat.InputError, match="a list of the program"):
        isocat.virtual("program vt0")
    with pytest.raises(isocat.InputError, match="seed 1"):
        isocat.virtual(["./there-is-no-such-program", "vt0"])
    with pytest.raises(isocat.InputError, match="expected"):
        isocat.virtual([*program, "0"], lateness="soon")


def test_the_command_of_the_wheel(tmp_path: Path) -> None:
    def command(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "isocat", *words],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
        )

    assert command("--version").stdout.splitlines()[0].endswith(isocat.__version__)
    assert command("run", "--for", "50ms").returncode == 0
    wrong = command("rum")
    assert wrong.returncode == 2 and "error" in wrong.stderr


def test_many_seeds_of_the_command_are_processes_of_the_wheel(
    program: list[str], tmp_path: Path
) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "isocat", "virtual", "--seeds", "2", "--", *program, "0"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode in (1, 3) and "2 runs" in done.stdout, done.stdout + done.stderr
