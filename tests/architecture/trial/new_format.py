"""A file format of somebody else's: a name, a step, and values in gal."""

import numpy as np

from structid.data_files.base import FileChannel, FileFormat
from structid.data_files.file_content import FileContent, number


def recognises(content: FileContent) -> bool:
    return content.line(0) == "TABLETOP SHAKER"


def read(content: FileContent) -> list[FileChannel]:
    step = number(content.line(1), content.at(1))
    values = np.array([number(line, content.at(n)) for n, line in enumerate(content.lines[2:], start=2) if line])
    return [FileChannel("table", values, "cm/s^2", dt=step, quantity="acceleration", where=content.at(2))]


FORMAT = FileFormat("tabletop shaker", recognises, read)
