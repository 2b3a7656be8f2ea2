"""Text files of any origin: byte order marks, Windows' encodings and line ends.

In: a file. Out: its lines.
"""

from pathlib import Path

_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def read_lines(path: Path) -> list[str]:
    """The file's lines without their ends.

    Without a byte order mark it is UTF-8 or, as spreadsheets write it, Windows-1252.

    Raises:
        ValueError: it is no text.
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
    raise ValueError("it is no text; it holds binary data")
