"""The pytest plugin, on a project of its own."""

from __future__ import annotations

import pytest

PROJECT = """
import pytest

def test_segment(isocat_segment, isocat_seed):
    report = isocat_segment.run("20ms")
    assert report.seed == isocat_seed
    assert isocat_seed != 3, "the third is bad"

@pytest.mark.isocat(segment="machine.toml")
def test_bus(isocat_bus):
    assert isocat_bus.names == ["one", "two"]

@pytest.mark.isocat({"cycle": "2ms", "subdevice": [{"device": "simple_io4"}]})
def test_dict(isocat_segment):
    assert isocat_segment.cycle_ns == 2_000_000

def test_without():
    pass
"""

MACHINE = """cycle = "1ms"
[[subdevice]]
device = "simple_io4"
name = "one"
[[subdevice]]
device = "simple_io4"
name = "two"
"""


@pytest.fixture
def project(pytester: pytest.Pytester) -> pytest.Pytester:
    pytester.makepyfile(test_machine=PROJECT)
    pytester.path.joinpath("machine.toml").write_text(MACHINE)
    return pytester


def test_one_case_for_each_seed(project: pytest.Pytester) -> None:
    result = project.runpytest_subprocess("--isocat-seeds", "4", "-v")
    result.assert_outcomes(passed=12, failed=1)
    result.stdout.fnmatch_lines(
        [
            "*test_segment?seed 3? FAILED*",
            "*the third is bad*",
            "seed 3; this case alone: pytest 'test_machine.py::test_segment' --isocat-seed 3 --isocat-seeds 1",
        ]
    )
    again = project.runpytest_subprocess(
        "test_machine.py::test_segment",
        "--isocat-seed",
        "3",
        "--isocat-seeds",
        "1",
    )
    again.assert_outcomes(failed=1)


def test_the_segment_of_the_project(project: pytest.Pytester) -> None:
    project.makepyfile(
        test_machine="def test_it(isocat_segment):\n    assert len(isocat_segment) == 2\n"
    )
    project.runpytest_subprocess().assert_outcomes(failed=1)
    by_option = project.runpytest_subprocess("--isocat-segment", "machine.toml")
    by_option.assert_outcomes(passed=1)
    project.makeini("[pytest]\nisocat_segment = machine.toml\n")
    project.runpytest_subprocess().assert_outcomes(passed=1)


def test_a_failure_on_a_bus_has_the_verdict(project: pytest.Pytester) -> None:
    project.makepyfile(test_machine="def test_it(isocat_bus):\n    assert False\n")
    result = project.runpytest_subprocess()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*isocat verdict*"])


def test_bad_input(project: pytest.Pytester) -> None:
    for words in (["--isocat-seeds", "0"], ["--isocat-seed", "-1"]):
        result = project.runpytest_subprocess(*words)
        assert result.ret == pytest.ExitCode.USAGE_ERROR
        result.stderr.fnmatch_lines([f"ERROR: {' '.join(words)}: expected *"])
    result = project.runpytest_subprocess("--isocat-segment", "no.toml")
    result.stdout.fnmatch_lines(["*No such file or directory*"])
