"""A set of recordings and its files: origin, checksums, licence, citation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import quote

ORIGIN = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class SourceFile:
    """One file that a data set is made from.

    Parameters
    ----------
    path : str
        Place in a local data folder, relative to the data set's own folder.
    upstream : str
        Path in the origin repository.
    sha256 : str
        Expected checksum of the file at `path`, hexadecimal.
    commit : str, optional
        Commit that holds the file where it is not the data set's.
    notice : str, optional
        Name under which a licence or readme is copied beside the recordings.
    raw : tuple of str, optional
        Paths in the origin repository where it holds the values in a form of its own. The file at
        `path` is then made from these, and `upstream` is empty.
    by_hand : str, optional
        Why the file is only taken from a local folder.
    """

    path: str
    upstream: str
    sha256: str
    commit: str = ""
    notice: str = ""
    raw: tuple[str, ...] = ()
    by_hand: str = ""


@dataclass(frozen=True)
class Dataset:
    """One set of recordings.

    Parameters
    ----------
    name, title : str
        Short name for commands, and what the set is.
    repository, commit : str
        Origin, as ``owner/name`` on GitHub and a full commit hash.
    sources : tuple of SourceFile
        Upstream files with their checksums.
    model : str
        Textbook simulator, a file of ``jaxsr/datasets/models``; empty where it is written from
        the set's own robot description.
    further : tuple of str, optional
        More model files of ``jaxsr/datasets/models``, written beside under their own names.
    licence, citation : str
        Terms of the data and whom to cite.
    left_out : str
        Physics that the textbook simulator leaves out.
    """

    name: str
    title: str
    repository: str
    commit: str
    sources: tuple[SourceFile, ...]
    model: str
    licence: str
    citation: str
    left_out: str
    further: tuple[str, ...] = ()

    @property
    def files(self) -> Mapping[str, str]:
        """Expected SHA-256 of every file, by its path in a local data folder."""
        return {source.path: source.sha256 for source in self.sources}

    def url(self, source: SourceFile, origin: str = ORIGIN) -> str:
        """Return the address of one upstream file."""
        return self.address(source.upstream, source.commit, origin)

    def address(self, upstream: str, commit: str = "", origin: str = ORIGIN) -> str:
        """Return the address of a path in the origin repository."""
        return f"{origin}/{self.repository}/{commit or self.commit}/{quote(upstream)}"
