"""A pytest plugin: tests on a virtual segment, one test case for each seed.

``isocat_segment``, ``isocat_bus`` and ``isocat_seed`` are fixtures. A test that uses one of them is
run once for each seed of ``--isocat-seeds``. The message of a failure has the seed, and the command
that repeats it alone.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from isocat import Bus, Segment


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declares the options."""
    group = parser.getgroup("isocat", "tests on a virtual EtherCAT segment")
    group.addoption(
        "--isocat-seeds",
        type=int,
        default=1,
        metavar="N",
        help="run each test on a segment with this many seeds (default 1)",
    )
    group.addoption(
        "--isocat-seed", type=int, default=1, metavar="SEED", help="the first seed (default 1)"
    )
    group.addoption(
        "--isocat-segment",
        default=None,
        metavar="FILE",
        help="segment file of tests that name none (default: isocat_segment of the ini file, or the built-in segment)",
    )
    parser.addini("isocat_segment", "segment file, relative to the ini file", default="")


def pytest_configure(config: pytest.Config) -> None:
    """Declares the marker, and refuses invalid seeds."""
    config.addinivalue_line(
        "markers",
        "isocat(segment): the segment of isocat_segment and isocat_bus: a path, a dict or an isocat.Segment",
    )
    first: Any = config.getoption("--isocat-seed")
    count: Any = config.getoption("--isocat-seeds")
    if count < 1:
        raise pytest.UsageError(f"--isocat-seeds {count}: expected 1 or more")
    if first < 0:
        raise pytest.UsageError(f"--isocat-seed {first}: expected 0 or more")


def _seeds(config: pytest.Config) -> range:
    first: Any = config.getoption("--isocat-seed")
    count: Any = config.getoption("--isocat-seeds")
    return range(first, first + count)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Makes one test case for each seed."""
    if "isocat_seed" in metafunc.fixturenames:
        seeds = _seeds(metafunc.config)
        metafunc.parametrize(
            "isocat_seed", seeds, ids=lambda seed: f"seed {seed}", scope="function"
        )


@pytest.fixture
def isocat_seed(request: pytest.FixtureRequest) -> int:
    """The seed of this test case."""
    seed: int = request.param
    return seed


@pytest.fixture
def isocat_segment(request: pytest.FixtureRequest, isocat_seed: int) -> Segment:
    """The segment of this test, with the seed of this case.

    Its description is that of ``@pytest.mark.isocat(segment=...)``, else of ``--isocat-segment``,
    else of ``isocat_segment`` in the ini file, else the built-in segment. Each test has its own
    segment, which it may change.
    """
    from isocat import Segment

    segment = _described(request)
    described = Segment.built_in() if segment is None else Segment(segment)
    described.set("seed", isocat_seed)
    return described


def _described(request: pytest.FixtureRequest) -> Any:
    marker = request.node.get_closest_marker("isocat")
    if marker is not None:
        given = marker.kwargs.get("segment", marker.args[0] if marker.args else None)
        if isinstance(given, str):
            # Data of a test are first searched in the folder of its file.
            beside = request.path.parent / given
            return beside if beside.exists() else given
        if given is not None:
            return given
    named = request.config.getoption("--isocat-segment")
    if named:
        return named
    ini = request.config.getini("isocat_segment")
    return request.config.rootpath / ini if ini else None


@pytest.fixture
def isocat_bus(request: pytest.FixtureRequest, isocat_segment: Segment) -> Iterator[Bus]:
    """A bus of the segment. If the test fails, the report has its verdict."""
    with isocat_segment.bus() as bus:
        request.node.stash[_BUS] = bus
        yield bus


_BUS: pytest.StashKey[Any] = pytest.StashKey()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, Any, Any]:
    """Adds the failed seed and the verdict of the judges to the report."""
    report = yield
    seed = getattr(getattr(item, "callspec", None), "params", {}).get("isocat_seed")
    if report.failed and seed is not None:
        name = item.nodeid.split("[")[0]
        report.sections.append(
            (
                "isocat",
                f"seed {seed}; this case alone: pytest '{name}' --isocat-seed {seed} --isocat-seeds 1",
            )
        )
        bus = item.stash.get(_BUS, None)
        if bus is not None and call.when == "call":
            try:
                report.sections.append(("isocat verdict", str(bus.verdict())))
            except Exception as error:  # An error here must not hide the failure of the test.
                report.sections.append(("isocat verdict", f"not to be had: {error}"))
    return report
