"""What all tests share."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import isocat
import pytest

pytest_plugins = ["pytester"]
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def pair() -> isocat.Segment:
    """Two drives in SYNC0, for 100 ms."""
    segment = isocat.Segment(cycle="1ms", for_="100ms")
    segment.add("kollmorgen_akd2g", name="axis 1", mode="dc-sync0")
    segment.add("kollmorgen_akd2g", name="axis 2", mode="dc-sync0", cable="30m", clock="-35ppm")
    return segment


@pytest.fixture(scope="session")
def main_device() -> ModuleType:
    """The example's MainDevice."""
    path = ROOT / "crates/isocat-py/examples/main_device.py"
    spec = importlib.util.spec_from_file_location("main_device", path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["main_device"] = module
    spec.loader.exec_module(module)
    return module
