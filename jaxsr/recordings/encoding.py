"""From bytes to text: encodings, line ends, and what old programs leave at the end of a file."""

from __future__ import annotations

import codecs
import gzip
import io
import zlib

from jaxsr._result import InputError

UNPACKED = 32_000_000
UNPACKED_PER_BYTE = 20
"""Bytes that a compressed file may unpack to; text of numbers shrinks two- to tenfold."""
_MARKS = (
    (codecs.BOM_UTF8, "utf-8", ""),
    (codecs.BOM_UTF32_LE, "utf-32", "UTF-32"),
    (codecs.BOM_UTF32_BE, "utf-32", "UTF-32"),
    (codecs.BOM_UTF16_LE, "utf-16", "UTF-16"),
    (codecs.BOM_UTF16_BE, "utf-16", "UTF-16"),
)


def unpack(raw: bytes, file: str) -> bytes:
    """Return what a ``.gz`` file holds.

    Raises
    ------
    InputError
        If it is damaged, cut off, or unpacks far beyond its size.
    """
    most = UNPACKED + UNPACKED_PER_BYTE * len(raw)
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(raw)) as stream:
            content = stream.read(most + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError("a damaged .gz file, or one cut off", file, "Compress it anew") from error
    if len(content) > most:
        raise InputError(
            f"unpacks to more than {most} bytes, far beyond its size", file, "Unpack it first"
        )
    return content


def decode(raw: bytes, file: str) -> tuple[str, str]:
    """Return the text of a file with plain line ends, and its encoding where that is not UTF-8.

    Raises
    ------
    InputError
        If it is no text.
    """
    text, encoding = _decoded(raw, file)
    text = text.rstrip("\x00\x1a \t\r\n")  # a logger's unused block, Ctrl-Z of old systems
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    head = text[:100_000]
    odd = sum(not (c.isprintable() or c.isspace()) for c in head)
    if odd > 0.01 * len(head):
        raise InputError("not a text file", file, "Give a table with a header line")
    if "\x00" in text:
        raise InputError("zero bytes inside the text", file, "Copy the file anew; it is damaged")
    if not text.strip():
        raise InputError("the file is empty", file, "Give a file with a header and samples")
    return text + "\n", encoding


def _decoded(raw: bytes, file: str) -> tuple[str, str]:
    for mark, codec, name in _MARKS:
        if raw.startswith(mark):
            if codec == "utf-16" and len(raw) % 2:
                raw = raw[:-1]  # one byte of a character that was cut off, or a lone Ctrl-Z
            if codec == "utf-8":
                raw = raw[len(mark) :]
                break
            return raw.decode(codec, errors="replace"), name
    # without a mark: every second byte of UTF-16 text of numbers is zero
    sample = raw[:2000]
    for first, codec in ((1, "utf-16-le"), (0, "utf-16-be")):
        zeros = sample[first::2]
        other = sample[1 - first :: 2]
        if (
            len(zeros) > 8
            and zeros.count(0) > 0.9 * len(zeros)
            and other.count(0) < 0.1 * len(other)
        ):
            return raw[: len(raw) // 2 * 2].decode(codec, errors="replace"), "UTF-16"
    try:
        return raw.decode("utf-8"), ""
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace"), "Latin-1"
