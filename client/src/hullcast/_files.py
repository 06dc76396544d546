"""Reads and writes the files that callers name; an error names the argument and the file."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Generator
from typing import Any, cast

from ._arguments import kind, shown
from ._errors import FileNotFound, InvalidArgument


def is_open_file(value: Any) -> bool:
    """Whether a value is a file that the caller has opened."""
    return callable(getattr(value, "read", None)) or callable(getattr(value, "write", None))


def path_of(field: str, value: Any, what: str = "the path of a file") -> str:
    """Checks that `value` is a path, and returns it as a str.

    A number is refused, because Python would take it for a file that is already open.

    Raises:
        InvalidArgument: NOT_A_PATH.
    """
    if isinstance(value, (str, os.PathLike)):
        path: Any = os.fspath(cast("str | os.PathLike[str]", value))
        path = os.fsdecode(path)
        if path and "\0" not in path and _is_name(path):
            return path
        got = shown(path)
    elif is_open_file(value):
        name: Any = getattr(value, "name", None)
        give = f"give its path {name!r}" if isinstance(name, str) else "write it to a file first"
        got = f"an open file: {give}"
    else:
        got = kind(value)
    raise InvalidArgument(f"expected {what}, got {got}", reason="NOT_A_PATH", field=field)


def _is_name(path: str) -> bool:
    """Whether the file system can have a file of this name."""
    try:
        os.fsencode(path)
    except UnicodeEncodeError:
        return False
    return True


def read(field: str, value: Any) -> bytes:
    """Reads the bytes of a regular file.

    Anything else is refused: reading a pipe or a device may wait for ever.

    Raises:
        FileNotFound: the file does not exist.
        InvalidArgument: NOT_A_PATH; or UNREADABLE_FILE, a directory, a pipe, a device, or a file
            without permission.
    """
    path = path_of(field, value)
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISREG(mode):
            with open(path, "rb") as file:
                return file.read()
        what = f"is {_kind_of(mode)}, not a file"
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFound(
            f"{path}: there is no such file", reason="FILE_NOT_FOUND", field=field
        ) from None
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
    except ValueError as error:
        what = f"cannot be read: {error}"
    raise InvalidArgument(f"{path} {what}", reason="UNREADABLE_FILE", field=field)


def writable(field: str, value: Any) -> str:
    """Checks that a file can be written at a path, and returns the path.

    Raises:
        InvalidArgument: NOT_A_PATH; or UNWRITABLE_FILE, the folder does not exist, or there is
            something else than a file at the path.
    """
    path = path_of(field, value)
    folder = os.path.dirname(path) or "."
    what = ""
    if not os.path.isdir(folder):
        what = f"cannot be written: the folder {folder} does not exist"
    elif os.path.isdir(path):
        what = "is a directory, not a file"
    elif not os.access(path if os.path.exists(path) else folder, os.W_OK):
        what = "cannot be written: Permission denied"
    if what:
        raise InvalidArgument(f"{path} {what}", reason="UNWRITABLE_FILE", field=field)
    return path


@contextlib.contextmanager
def writing(field: str, path: str) -> Generator[None]:
    """Converts the system's errors while a file is written, such as a full disk.

    Raises:
        InvalidArgument: UNWRITABLE_FILE.
    """
    try:
        yield
    except OSError as error:
        raise InvalidArgument(
            f"{shown(path)} cannot be written: {error.strerror or error}",
            reason="UNWRITABLE_FILE",
            field=field,
        ) from None


def _kind_of(mode: int) -> str:
    kinds = (
        (stat.S_ISDIR, "a directory"),
        (stat.S_ISFIFO, "a pipe"),
        (stat.S_ISSOCK, "a socket"),
        (stat.S_ISCHR, "a device"),
        (stat.S_ISBLK, "a device"),
    )
    return next((name for test, name in kinds if test(mode)), "something else")
