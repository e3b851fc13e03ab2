"""XML edited in its text: attributes of single start tags, comments and layout as they are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from jaxsr._result import InputError

_TAG_END = re.compile(rb'(?:[^>"\']|"[^"]*"|\'[^\']*\')*>')


@dataclass(eq=False)
class Node:
    """An element of a file with the place of its start tag.

    Attributes
    ----------
    file : Path
    start : int
        Offset of ``<`` in the file's bytes.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    start: int
    children: list[Node] = field(default_factory=list)

    def walk(self) -> Iterator[Node]:
        """Yield the element and all in it, in the order of the document."""
        yield self
        for child in self.children:
            yield from child.walk()


@dataclass(eq=False)
class Document:
    """An XML file and those that it includes.

    Attributes
    ----------
    root : Node
        Elements of included files stand in the place of ``<include>``.
    texts : dict
        Bytes of every file.
    includes : list of Node
        The ``<include>`` elements.
    """

    root: Node
    texts: dict[Path, bytes]
    includes: list[Node]
    changes: dict[tuple[Path, int], dict[str, str]] = field(default_factory=dict)
    renamed: dict[tuple[Path, int], str] = field(default_factory=dict)
    inserted: dict[tuple[Path, int], str] = field(default_factory=dict)

    @staticmethod
    def read(path: Path) -> Document:
        """Read a file and, as MuJoCo does, what it includes from the folder of the first file.

        Raises
        ------
        InputError
            A file cannot be read, or is no XML.
        """
        texts: dict[Path, bytes] = {}
        includes: list[Node] = []
        root = _parsed(path, texts)
        _include(root, path.parent, texts, includes)
        return Document(root, texts, includes)

    def set(self, node: Node, values: Mapping[str, str]) -> None:
        """Give an element attributes; those that it has change their value."""
        self.changes.setdefault((node.file, node.start), {}).update(values)
        node.attributes.update(values)

    def rename(self, node: Node, tag: str) -> None:
        """Give an element without content another tag."""
        self.renamed[node.file, node.start] = tag
        node.tag = tag

    def insert(self, node: Node, text: str) -> None:
        """Put an element at the beginning of another one, which is written as two tags."""
        self.inserted[node.file, node.start] = text

    def empty(self, node: Node) -> bool:
        """Whether an element is written as one tag, ``<a/>``."""
        text = self.texts[node.file]
        return text[node.start : _end(text, node.start)].endswith(b"/>")

    def edited(self, file: Path) -> bytes:
        """Return a file with its changes made, every other byte as it is."""
        text = self.texts[file]
        starts = {s for f, s in (*self.changes, *self.renamed, *self.inserted) if f == file}
        for start in sorted(starts, reverse=True):
            end = _end(text, start)
            tag = text[start:end]
            if (file, start) in self.renamed:
                name = self.renamed[file, start].encode()
                tag = re.sub(rb"^<[^\s/>]+", b"<" + name, tag)
            for key, value in self.changes.get((file, start), {}).items():
                tag = _with_attribute(tag, key, value)
            more = self.inserted.get((file, start), "").encode()
            text = text[:start] + tag + more + text[end:]
        return text

    def changed(self, file: Path) -> bool:
        """Whether an element of a file was changed."""
        return any(f == file for f, _ in (*self.changes, *self.renamed))


def _with_attribute(tag: bytes, key: str, value: str) -> bytes:
    """Return a start tag with an attribute set."""
    new = value.encode()
    old = re.search(rb"(\s" + key.encode() + rb"\s*=\s*)(\"[^\"]*\"|'[^']*')", tag)
    if old is not None:
        quote = old[2][:1]
        return tag[: old.start(2)] + quote + new + quote + tag[old.end(2) :]
    close = 2 if tag.endswith(b"/>") else 1
    head = tag[:-close].rstrip()
    return head + b" " + key.encode() + b'="' + new + b'"' + tag[len(head) :]


def _end(text: bytes, start: int) -> int:
    found = _TAG_END.match(text, start)
    assert found is not None  # it was parsed
    return found.end()


def _parsed(path: Path, texts: dict[Path, bytes]) -> Node:
    """Return the tree of one file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", str(path)) from None
    texts[path] = data
    parser = expat.ParserCreate()
    stack: list[Node] = [Node("", {}, path, -1)]

    def start(tag: str, attributes: dict[str, str]) -> None:
        node = Node(tag, dict(attributes), path, parser.CurrentByteIndex)
        stack[-1].children.append(node)
        stack.append(node)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: stack.pop()
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(f"is no XML: {error}", str(path), "Mend the file") from None
    return stack[0].children[0]


def _include(node: Node, folder: Path, texts: dict[Path, bytes], includes: list[Node]) -> None:
    """Put the elements of included files in their place."""
    children: list[Node] = []
    for child in node.children:
        if child.tag != "include":
            _include(child, folder, texts, includes)
            children.append(child)
            continue
        includes.append(child)
        name = child.attributes.get("file", "")
        places = (folder / name, child.file.parent / name)
        found = next((p for p in places if p.is_file()), None)
        if found is None or found in texts:
            continue
        inner = _parsed(found, texts)
        _include(inner, folder, texts, includes)
        children += inner.children
    node.children = children
