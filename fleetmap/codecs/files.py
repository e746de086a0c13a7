"""Files of bytes: written whole or not at all, and read no farther than they may reach."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from fleetmap.model.errors import MapFormatError

MAX_FILE_BYTES = 64 << 20


def write_whole(path: Path, data: bytes) -> None:
    """Write a file; it appears whole or not at all.

    Raises
    ------
    OSError : the folder can't be written
    """
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(temporary, 0o644)  # mkstemp makes files that only the owner reads
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def read_behind(path: Path, magic: bytes) -> bytes:
    """What follows the first bytes of a file, which say what it is.

    Raises
    ------
    MapFormatError : the file is missing, too long, or something else
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise MapFormatError(path=path, field="file", reason=error.strerror or str(error)) from None
    if len(data) > MAX_FILE_BYTES or not data.startswith(magic):
        raise MapFormatError(path=path, field="file", reason=f"expected {magic!r} and at most {MAX_FILE_BYTES} B")
    return data[len(magic) :]
