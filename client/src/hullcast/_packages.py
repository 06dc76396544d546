"""Finds the files that a URDF names."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from . import _files
from ._arguments import iterable, kind, ordered
from ._errors import FileNotFound, InvalidArgument

#: The URL schemes in which the first folder is a package's name.
_PACKAGES = ("package", "model")


class Packages:
    """The folders in which the files of meshes are looked up.

    Args:
        own: the folder that contains the URDF.
        packages: as for `Robot`.
    """

    def __init__(self, own: Path, packages: Any) -> None:
        self._own = own
        ros = _entries("ROS_PACKAGE_PATH")
        ament = [prefix / "share" for prefix in _entries("AMENT_PREFIX_PATH")]
        self._folders = [*_folders(packages), *ros, *ament]

    def find(self, name: str, where: str) -> Path:
        """Finds the file that a mesh's `filename` names.

        Raises:
            FileNotFound: no folder has the file. The message begins with `where`.
        """
        scheme, separator, rest = name.rpartition("://")
        scheme = scheme.lower()
        if separator and scheme not in ("file", *_PACKAGES):
            raise FileNotFound(
                f"{where}: {name!r} is not read: files are named by package://, file:// or a path",
                reason="FILE_NOT_FOUND",
            )
        for path in dict.fromkeys((rest, unquote(rest) if separator else rest)):
            for place in self._places(scheme, path):
                if place.is_file():
                    return place
        advice = ""
        if scheme in _PACKAGES:
            package = rest.strip("/").partition("/")[0]
            advice = f"; give the folder that holds the package {package!r} as `packages`"
        raise FileNotFound(f"{where}: {name!r} is not found{advice}", reason="FILE_NOT_FOUND")

    def _places(self, scheme: str, path: str) -> Iterable[Path]:
        if scheme not in _PACKAGES:
            yield self._own / path  # an absolute path stays unchanged
            return
        # Both package://name/... and package:///name/... refer to the folder `name`.
        path = path.lstrip("/")
        package = path.partition("/")[0]
        for folder in self._folders:
            yield folder / path
            if folder.name == package:
                yield folder.parent / path
        for above in (self._own, *self._own.parents):
            yield above / path
            if above.name == package:
                yield above.parent / path


def _entries(variable: str) -> list[Path]:
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _folders(packages: Any) -> list[Path]:
    ordered("packages", packages)
    single = isinstance(packages, (str, os.PathLike))
    if not single and not iterable(packages):
        raise InvalidArgument(
            f"expected a folder or a list of folders, got {kind(packages)}",
            reason="NOT_A_PATH",
            field="packages",
        )
    given: list[Any] = [packages] if single else list(packages)
    return [
        Path(_files.path_of("packages", folder, "a folder or a list of folders")).resolve()
        for folder in given
    ]
