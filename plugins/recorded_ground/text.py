"""Read text files with byte order marks, Windows encodings and any line ends.

In: a file. Out: its lines.
"""

from pathlib import Path

_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def read_lines(path: Path) -> list[str]:
    """Return the file's lines without their ends.

    A file without a byte order mark is read as UTF-8 or else as Windows-1252, which spreadsheets
    write.

    Raises:
        ValueError: the file is not text.
    """
    data = path.read_bytes()
    encoding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    for name in (encoding,) if encoding else ("utf-8", "cp1252"):
        try:
            text = data.decode(name)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text.splitlines()
    raise ValueError("it is not a text file; it holds binary data")
