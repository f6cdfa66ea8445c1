"""Sweeps that write into a bucket, held against a local S3 server."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import isocat
import isocat._sweep
import pytest

pytest.importorskip("pyarrow")
moto = pytest.importorskip("moto.server", reason="no S3 server: pip install 'moto[server]'")

GRID = {"cycle": ["500us", "1ms"], "host.jitter": ["5us", "100us"]}


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """The URL of a local S3 server."""
    threaded = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    threaded.start()
    host, port = threaded.get_host_and_port()
    yield f"http://{host}:{port}"
    threaded.stop()


@pytest.fixture
def bucket(server: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """An empty bucket named ``rows``, and the environment with the credentials for it."""
    boto3 = pytest.importorskip("boto3")
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_ENDPOINT_URL", server)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "testing")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    bucket = boto3.resource("s3").Bucket("rows")
    bucket.create()
    yield bucket
    bucket.objects.all().delete()
    bucket.delete()


@pytest.fixture
def small() -> isocat.Segment:
    segment = isocat.Segment(cycle="1ms", for_="10ms")
    segment.add("simple_io4")
    return segment


def parts(bucket: Any) -> dict[str, bytes]:
    """The Parquet files in the bucket."""
    found = bucket.objects.filter(Prefix="jitter/part-")
    return {one.key: one.get()["Body"].read() for one in found}


def test_rows_in_a_bucket_are_those_of_a_folder(
    bucket: Any, small: isocat.Segment, tmp_path: Any
) -> None:
    batches = isocat._sweep.Threads(batch=7)
    there = isocat.sweep(small, GRID, seeds=5, to="s3://rows/jitter", executor=batches)
    here = isocat.sweep(small, GRID, seeds=5, to=tmp_path / "jitter", executor=batches)
    assert there.table == here.table == isocat.sweep(small, GRID, seeds=5).table
    written = parts(bucket)
    assert len(written) == 3
    for key, content in written.items():
        assert (tmp_path / key).read_bytes() == content
    with pytest.raises(isocat.InputError, match="resume=True"):
        isocat.sweep(small, GRID, seeds=5, to="s3://rows/jitter", executor=batches)
    again = isocat.sweep(small, GRID, seeds=5, to="s3://rows/jitter", executor=batches, resume=True)
    assert again.runs == 20 and again.table == there.table
    with pytest.raises(isocat.InputError, match="another sweep"):
        isocat.sweep(small, GRID, seeds=6, to="s3://rows/jitter", executor=batches, resume=True)


DRIVER = """
import isocat, isocat._sweep, sys
segment = isocat.Segment(cycle="1ms", for_="500ms")
segment.add("simple_io4")
isocat.sweep(
    segment, {"host.jitter": ["5us", "100us"]}, seeds=200, to="s3://rows/jitter",
    resume=len(sys.argv) > 1, executor=isocat._sweep.Threads(workers=1, batch=8),
)
"""


def test_a_driver_that_is_killed(bucket: Any) -> None:
    driver = subprocess.Popen([sys.executable, "-c", DRIVER])
    deadline = time.monotonic() + 120
    while len(parts(bucket)) < 3:
        assert time.monotonic() < deadline and driver.poll() is None
        time.sleep(0.05)
    driver.kill()
    driver.wait()
    there = parts(bucket)
    assert 3 <= len(there) < 50
    subprocess.run([sys.executable, "-c", DRIVER, "resume"], check=True, timeout=240)
    written = parts(bucket)
    assert len(written) == 50 and all(written[key] == content for key, content in there.items())
    segment = isocat.Segment(cycle="1ms", for_="500ms")
    segment.add("simple_io4")
    whole = isocat.sweep(segment, {"host.jitter": ["5us", "100us"]}, seeds=200)
    pyarrow = pytest.importorskip("pyarrow.dataset")
    rows = pyarrow.dataset("s3://rows/jitter")
    assert rows.to_table().sort_by("number").to_pylist() == whole.table.rows()


def test_a_bucket_that_is_not_there(bucket: Any, small: isocat.Segment) -> None:
    with pytest.raises(OSError, match="expected a bucket that exists") as caught:
        isocat.sweep(small, to="s3://another/jitter")
    assert "s3://another/jitter can't be opened" in str(caught.value)
    with pytest.raises(isocat.InputError, match="a URL that pyarrow knows"):
        isocat.sweep(small, to="s4://rows/jitter")


def test_without_credentials(
    bucket: Any, small: isocat.Segment, monkeypatch: pytest.MonkeyPatch
) -> None:
    isocat.sweep(small, to="s3://rows/jitter")
    words = "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
    with monkeypatch.context() as without:
        without.delenv("AWS_ACCESS_KEY_ID")
        without.delenv("AWS_SECRET_ACCESS_KEY")
        without.setenv("AWS_EC2_METADATA_DISABLED", "true")
        without.setenv("AWS_SHARED_CREDENTIALS_FILE", "/nonexistent")
        # This server lets strangers write what is not there yet, and nothing else.
        with pytest.raises(OSError, match=words) as caught:
            isocat.sweep(small, to="s3://rows/jitter")
        assert "s3://rows/jitter can't be opened" in str(caught.value)
    with monkeypatch.context() as wrong:
        # From here on this server holds keys against those that it has given out: none.
        wrong.setattr("moto.settings.INITIAL_NO_AUTH_ACTION_COUNT", 0)
        with pytest.raises(OSError, match=words):
            isocat.sweep(small, to="s3://rows/jitter")


def test_secrets_of_a_url_are_in_no_message(bucket: Any, small: isocat.Segment) -> None:
    url = "s3://somebody:hunter2@rows/jitter?region=us-east-1"
    isocat.sweep(small, to=url)
    for bad in (url, url.replace("rows", "another"), url + "&colour=red"):
        with pytest.raises((isocat.InputError, OSError)) as caught:
            isocat.sweep(small, to=bad)
        assert "hunter2" not in str(caught.value)
        assert "hunter2" not in str(getattr(caught.value, "found", None))


def test_a_bucket_that_goes_away(bucket: Any, small: isocat.Segment) -> None:
    gone: list[bool] = []

    def take_away(*_: int) -> None:
        # A slow machine may tell its progress once more before it notices.
        if not gone:
            gone.append(True)
            bucket.objects.all().delete()
            bucket.delete()

    executor = isocat._sweep.Threads(batch=50)
    with pytest.raises(OSError, match="part-000000000000.parquet can't be written") as caught:
        isocat.sweep(small, seeds=50, to="s3://rows/jitter", executor=executor, progress=take_away)
    if sys.version_info >= (3, 11):
        assert "resume=True continues" in caught.value.__notes__[0]
    bucket.create()
