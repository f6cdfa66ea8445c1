"""Stores the rows of a sweep as they come: a folder or a bucket with a Parquet file for each
batch.
"""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._errors import InputError
from ._isocat import Table

if TYPE_CHECKING:
    from ._isocat import Sweep

# Readers of a folder of Parquet files skip names that begin with "_".
HEAD = "_isocat-sweep.json"
_PART = "part-"


class Store:
    """A folder of parts.

    A part is named after its first run and written completely or not at all, so a driver or a
    machine that fails only loses the parts in progress. ``_isocat-sweep.json`` identifies the
    sweep.
    """

    def __init__(self, files: _Files, identity: str) -> None:
        self._files, self._identity = files, identity

    @classmethod
    def open(cls, to: str | os.PathLike[str], sweep: Sweep, batch: int, resume: bool) -> Store:
        """Begins a folder, or continues one of the same sweep."""
        path = os.fsdecode(to)
        files: _Files = _Bucket(path) if "://" in path else _Folder(path)
        path = _without_secrets(path) if "://" in path else path
        about = json.loads(sweep.identity())
        about["batch"] = batch
        identity = json.dumps(about, indent=1, sort_keys=True) + "\n"
        there = files.read(HEAD)
        if there is None:
            if files.names():
                raise InputError(
                    f"to: {path} has files and no {HEAD}; expected an empty folder, a new one, or that of a sweep",
                    place="to",
                    found="other files",
                    expected="an empty folder",
                )
            files.write(HEAD, identity.encode())
        elif not resume:
            raise InputError(
                f"to: {path} has a sweep already; expected another folder, or resume=True to go on with it",
                place="to",
                found="a sweep",
                expected="another folder, or resume=True",
            )
        else:
            _check_same(path, json.loads(there), about)
        return cls(files, identity)

    def done(self) -> dict[int, list[tuple[int, bool]]]:
        """The existing parts, by their first run: the number of each row, and whether it was as
        expected.
        """
        done = {}
        for name in self._parts():
            part = _pyarrow("resume=True").parquet.read_table(
                self._files.source(name), columns=["number", "as_expected"]
            )
            done[int(name[len(_PART) :].split(".")[0])] = list(
                zip(part["number"].to_pylist(), part["as_expected"].to_pylist())
            )
        return done

    def write(self, start: int, table: Table) -> None:
        """Writes a part."""
        try:
            self._files.write(f"{_PART}{start:012d}.parquet", table.parquet_bytes())
        except OSError as error:
            if sys.version_info >= (3, 11):
                error.add_note("Rows that were written remain: resume=True continues with them.")
            raise

    def finish(self) -> None:
        """Does nothing: each part is already a complete file."""

    def read(self, sweep: Sweep) -> Table:
        """All rows."""
        arrow = _pyarrow("reading rows back")
        tables = [arrow.parquet.read_table(self._files.source(name)) for name in self._parts()]
        if not tables:
            return sweep.empty()
        return _table(arrow.concat_tables(tables), sweep.empty())

    def _parts(self) -> list[str]:
        names = self._files.names()
        return sorted(
            name for name in names if name.startswith(_PART) and name.endswith(".parquet")
        )


def _table(whole: Any, like: Table) -> Table:
    """Converts a table of pyarrow to a ``Table`` with the columns of ``like``."""
    import struct

    columns = []
    for name in like.column_names:
        kind, values = like[name].kind, whole[name].to_pylist()
        optional = whole.schema.field(name).nullable
        present = None
        if any(one is None for one in values):
            present = bytes(one is not None for one in values)
        ends = b""
        if kind == "text":
            texts = [("" if one is None else one).encode() for one in values]
            total, at = 0, []
            for text in texts:
                total += len(text)
                at.append(total)
            data, ends = b"".join(texts), struct.pack(f"<{len(at)}I", *at)
        elif kind == "flag":
            data = bytes(bool(one) for one in values)
        else:
            letter = "q" if kind == "integer" else "d"
            data = struct.pack(
                f"<{len(values)}{letter}", *(0 if one is None else one for one in values)
            )
        columns.append((name, kind, optional, present, data, ends))
    return Table._rebuild(whole.num_rows, columns)


def _check_same(path: str, there: dict[str, Any], wanted: dict[str, Any]) -> None:
    for key in sorted(wanted):
        if there.get(key) != wanted[key]:
            found, expected = str(there.get(key))[:200], str(wanted[key])[:200]
            raise InputError(
                f"to: {path} is of another sweep: its {key} is {found}; expected {expected}",
                place=f"{path}/{HEAD}",
                found=found,
                expected=expected,
            )


def _pyarrow(why: str) -> Any:
    try:
        # These submodules are only attributes after they were imported.
        for part in ("pyarrow.fs", "pyarrow.parquet"):
            import_module(part)
        return import_module("pyarrow")
    except ImportError as error:
        raise ImportError(
            f"{why} needs pyarrow, which is not installed: pip install 'isocat[arrow]'"
        ) from error


class _Files:
    """Files of one folder."""

    def names(self) -> list[str]:
        raise NotImplementedError

    def read(self, name: str) -> bytes | None:
        raise NotImplementedError

    def write(self, name: str, content: bytes) -> None:
        raise NotImplementedError

    def source(self, name: str) -> Any:
        """The source from which pyarrow reads the file."""
        raise NotImplementedError


class _Folder(_Files):
    def __init__(self, path: str) -> None:
        self._path = path
        os.makedirs(path, exist_ok=True)

    def names(self) -> list[str]:
        # A file that a process was writing when it ended is ignored.
        return [name for name in os.listdir(self._path) if not name.endswith(".part")]

    def read(self, name: str) -> bytes | None:
        try:
            with open(os.path.join(self._path, name), "rb") as file:
                return file.read()
        except FileNotFoundError:
            return None

    def write(self, name: str, content: bytes) -> None:
        path = os.path.join(self._path, name)
        part = os.path.join(self._path, f"_{name}.{os.getpid()}.part")
        try:
            with open(part, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, path)
        except BaseException as error:
            if os.path.exists(part):
                os.remove(part)
            if isinstance(error, OSError) and error.filename is None:
                error.filename = path
            raise

    def source(self, name: str) -> Any:
        return os.path.join(self._path, name)


class _Bucket(_Files):
    def __init__(self, url: str) -> None:
        self._shown = _without_secrets(url)
        arrow = _pyarrow(f"to={self._shown!r}")
        self._fs = arrow.fs
        try:
            self._files, self._path = arrow.fs.FileSystem.from_uri(url)
            self._files.create_dir(self._path, recursive=True)
        except arrow.ArrowException as error:
            expected = 'a folder, or a URL that pyarrow knows, such as "s3://bucket/folder"'
            raise InputError(
                f"to: found {self._shown}: {error}; expected {expected}",
                place="to",
                found=self._shown,
                expected=expected,
            ) from None
        except OSError as error:
            raise OSError(
                f"to: {self._shown} can't be opened: {error}; {_EXPECTED.get(_scheme(url), _BUCKET)}"
            ) from error

    def names(self) -> list[str]:
        found = self._files.get_file_info(self._fs.FileSelector(self._path))
        return [one.base_name for one in found if one.is_file]

    def read(self, name: str) -> bytes | None:
        try:
            with self._files.open_input_stream(f"{self._path}/{name}") as file:
                content: bytes = file.read()
                return content
        except FileNotFoundError:
            return None

    def write(self, name: str, content: bytes) -> None:
        # An object appears in the bucket when it is closed, so it is never incomplete.
        try:
            with self._files.open_output_stream(f"{self._path}/{name}") as file:
                file.write(content)
        except OSError as error:
            raise OSError(f"to: {self._shown}: {name} can't be written: {error}") from error

    def source(self, name: str) -> Any:
        return self._files.open_input_file(f"{self._path}/{name}")


_BUCKET = "expected a bucket that exists, and credentials that may write to it"
_EXPECTED = {
    "s3": f"{_BUCKET}: AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY in the environment, or a profile in ~/.aws. "
    "A server that is not Amazon's: AWS_ENDPOINT_URL, or ?endpoint_override=HOST:PORT in the URL"
}


def _scheme(url: str) -> str:
    return url.partition("://")[0]


def _without_secrets(url: str) -> str:
    """The URL without ``key:secret@`` and without options, for messages."""
    scheme, _, rest = url.partition("?")[0].partition("://")
    return f"{scheme}://{rest.rpartition('@')[2]}"
