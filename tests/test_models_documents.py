"""Files that are no model file, and text that is more than one: one clear line, in no time."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from jaxsr._result import InputError
from jaxsr.models import Simulator, parse_model
from jaxsr.models.document import MAX_CHARACTERS, parse_document

PLAIN = """# at 20 °C
[model]
states = ["q"]
outputs = ["y"]
[equations]
q = "-q"
[readings]
y = "q"
"""


@pytest.mark.parametrize(
    "data",
    [
        PLAIN.encode(),
        PLAIN.encode("utf-8-sig"),
        PLAIN.encode("utf-16"),
        b"\xfe\xff" + PLAIN.encode("utf-16-be"),
        PLAIN.replace("\n", "\r\n").encode(),
    ],
    ids=["plain", "byte order mark", "UTF-16", "UTF-16 big-endian", "CRLF"],
)
def test_text_as_editors_save_it_is_read(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_bytes(data)
    assert Simulator.from_file(tmp_path / "m.toml").model.equations == {"q": "-q"}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (PLAIN.encode("latin-1"), "line 1: invalid start byte). Save it as TOML in UTF-8"),
        (PLAIN.encode("utf-16-le"), "UTF-8"),
        (b"\x89PNG\r\n\x1a\n" + bytes(500), "cannot be read as text (line 1"),
        (bytes(1000), "is not valid TOML"),
        (b"t,y\n0,1\n", "is not valid TOML: Expected '=' after a key"),
        (b"", "no [model] table. Start with"),
    ],
)
def test_files_of_another_kind(data: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_bytes(data)
    with pytest.raises(InputError) as caught:
        Simulator.from_file(tmp_path / "m.toml")
    assert str(caught.value).startswith("m.toml: ") and message in str(caught.value)


def test_places_where_no_file_is(tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "file.toml").write_text(PLAIN)
    (tmp_path / "loop.toml").symlink_to(tmp_path / "loop.toml")
    places = {
        "none.toml": "no such model file. Check the path",
        "folder.toml": "is a folder. Name the model file in it",
        "file.toml/m.toml": "no such model file",
        "loop.toml": "cannot be read: ",
        f"{'a' * 300}.toml": "cannot be read: ",
        "nul\0.toml": "is no path of a file",
    }
    for place, message in places.items():
        with pytest.raises(InputError) as caught:
            Simulator.from_file(tmp_path / place)
        assert message in str(caught.value) and str(caught.value).isprintable()
        assert len(str(caught.value)) < 350
    if os.path.exists("/dev/zero"):
        with pytest.raises(InputError, match="longer than"):
            Simulator.from_file("/dev/zero")


def test_a_file_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "m.toml").write_text(PLAIN)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    # Root may read everything, so that the permission is taken where the file is opened.
    monkeypatch.setattr("builtins.open", refuse)
    with pytest.raises(InputError, match=r"m\.toml: cannot be read: Permission denied"):
        Simulator.from_file(tmp_path / "m.toml")


N = MAX_CHARACTERS - 50
BOMBS = {
    "arrays": "x = " + "[" * N,
    "closed arrays": "x = " + "[" * (N // 2) + "]" * (N // 2),
    "tables": "x = " + "{a=" * (N // 3),
    "dotted key": "a" + ".a" * (N // 2) + " = 1",
    "spaced dots": "a" + " . a" * (N // 4) + " = 1",
    "quoted dots": '"."' + '.".."' * (N // 5) + " = 1",
    "dotted header": "[" + "a." * (N // 2) + "a]",
    "dots in a table": "x = { a" + ".a" * (N // 2) + " = 1 }",
    "quotes": '"' * N,
    "open text": 'x = """' + '\\"""' * (N // 4),
    "both texts": "\"\"\"'''" * (N // 6),
    "backslashes": 'x = """' + "\\" * N,
    "digits": "x = " + "1" * N,
    "hexadecimal": "x = 0x" + "f" * N,
    "tables without end": "".join(f"[a{i}]\n" for i in range(N // 10)),
    "too long": "#" * (N + 100),
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_in_time(name: str) -> None:
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        parse_model(BOMBS[name], "m.toml")
    assert time.process_time() - began < 2.0
    assert str(caught.value).startswith("m.toml") and len(str(caught.value)) < 450


def test_brackets_and_dots_in_text_are_text() -> None:
    text = "x = '" + "[." * 300 + "'\n# " + "{.a" * 300 + '\ny = """\n' + "a.b" * 300 + '"""\n'
    assert set(parse_document(text, "m.toml")) == {"x", "y"}
    assert parse_document("x = [" + "1.5, " * 300 + "]", "m.toml")["x"] == [1.5] * 300
