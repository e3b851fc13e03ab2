"""Lists of files after one option, and the role of each file."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxsr._arguments import (
    FILE_LISTS,
    check_roles,
    expand_file_lists,
    is_model,
    model_and_data,
    results_folder,
    split_names,
)
from jaxsr._files import atomic_directory
from jaxsr._result import InputError


@pytest.mark.parametrize(
    ("typed", "parsed"),
    [
        ("a b --held-out v0 v1", "a b --held-out v0 --held-out v1"),
        ("--held-out v0 v1 --out d", "--held-out v0 --held-out v1 --out d"),
        ("--held-out v0 --out d a b", "--held-out v0 --out d a b"),
        ("--held-out=v0 v1 --seed 1 a", "--held-out=v0 --held-out=v1 --seed 1 a"),
        ("--held-out v0 -- a b", "--held-out v0 -- a b"),
        ("a -- --held-out b c", "a -- --held-out b c"),
        (
            "a --held-out v --validation w x --held-out y",
            "a --held-out v --validation w --validation x --held-out y",
        ),
        ("--simulated s0 s1 --order=2 a b", "--simulated s0 --simulated s1 --order=2 a b"),
        ("--seed -1 a", "--seed -1 a"),
        ("--held-out - v", "--held-out - --held-out v"),
        ("a b", "a b"),
        ("", ""),
    ],
)
def test_each_file_of_a_list_gets_its_option(typed: str, parsed: str) -> None:
    assert expand_file_lists(typed.split()) == parsed.replace("--held-out=", "--held-out ").split()


@pytest.mark.parametrize(
    "typed",
    ["--held-out", "a --held-out --out d", "--validation --held-out v", "--simulated -- a"],
)
def test_a_list_without_a_file_is_refused(typed: str) -> None:
    with pytest.raises(InputError, match="names no file"):
        expand_file_lists(typed.split())


def roles_of(expanded: list[str]) -> dict[str, list[str]]:
    """Parse as click does: each file-list option and --out takes one value."""
    roles: dict[str, list[str]] = {"DATA": []}
    rest = iter(expanded)
    for argument in rest:
        if argument == "--":
            roles["DATA"] += rest
        elif argument.startswith("--"):
            roles.setdefault(argument, []).append(next(rest))
        else:
            roles["DATA"].append(argument)
    return roles


@given(
    st.lists(
        st.tuples(
            st.sampled_from(FILE_LISTS), st.lists(st.sampled_from("abcdef"), min_size=1, max_size=3)
        ),
        max_size=4,
    ),
    st.lists(st.sampled_from("uvw"), min_size=1, max_size=3),
)
def test_any_order_of_blocks_gives_the_same_roles(
    blocks: list[tuple[str, list[str]]], data: list[str]
) -> None:
    wanted: dict[str, list[str]] = {"DATA": data, "--out": ["d"]}
    for option, files in blocks:
        wanted.setdefault(option, []).extend(files)
    typed = list(itertools.chain.from_iterable([option, *files] for option, files in blocks))
    first = roles_of(expand_file_lists([*data, *typed, "--out", "d"]))
    middle = roles_of(expand_file_lists([*typed, "--out", "d", *data]))
    last = roles_of(expand_file_lists(["--out", "d", *typed, "--", *data]))
    assert first == middle == last == wanted


def test_a_file_has_one_role(tmp_path: Path) -> None:
    names = {}
    for name in ("a.csv", "b.csv"):
        names[name] = tmp_path / name
        names[name].write_text("t,x\n")
    a, b = (str(path) for path in names.values())
    check_roles({"DATA": [a], "--held-out": [b]})
    with pytest.raises(InputError, match=r"DATA .*a\.csv and --held-out .*a\.csv"):
        check_roles({"DATA": [a], "--held-out": [b, f"{tmp_path}/./a.csv"]})
    with pytest.raises(InputError, match="one file in two places"):
        check_roles({"DATA": [a, a]})
    os.symlink(a, tmp_path / "soft.csv")
    os.link(a, tmp_path / "hard.csv")
    for other in ("soft.csv", "hard.csv"):
        with pytest.raises(InputError, match="one file in two places"):
            check_roles({"DATA": [a], "--validation": [str(tmp_path / other)]})


def test_missing_files_and_directories_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.csv", tmp_path / ("x" * 300), "with\0null"):
        with pytest.raises(InputError, match="cannot be read"):
            check_roles({"DATA": [str(path)]})
    with pytest.raises(InputError, match="is a directory"):
        check_roles({"DATA": [str(tmp_path)]})


def test_positional_arguments_of_diagnose() -> None:
    assert model_and_data(["m.toml", "a", "b"], None, None) == ("m.toml", ["a", "b"])
    assert model_and_data(["p/f.py:arm", "a"], None, None) == ("p/f.py:arm", ["a"])
    assert model_and_data(["a", "b"], ["s", "r"], "q") == (None, ["a", "b"])
    for arguments, simulated, states in [
        (["a.csv"], None, None),
        (["m.toml"], None, None),
        (["m.toml", "a"], None, "q"),
        (["m.toml", "a"], ["s"], None),
        (["a", "b"], ["s"], None),
    ]:
        with pytest.raises(InputError):
            model_and_data(arguments, simulated, states)
    assert is_model("M.TOML") and not is_model("a.py")


def test_results_do_not_overwrite_inputs(tmp_path: Path) -> None:
    model = tmp_path / "explained.toml"
    model.write_text("")
    written = ("explained.toml",)
    with pytest.raises(InputError, match="overwritten"):
        results_folder(str(tmp_path), {"MODEL": [str(model)]}, written)
    # What the last run wrote goes when the next run writes.
    with atomic_directory(tmp_path / "last") as folder:
        (folder / "learned.toml").write_text("")
    learnt = {"MODEL": [str(tmp_path / "last" / "learned.toml")]}
    with pytest.raises(InputError, match="overwritten"):
        results_folder(str(tmp_path / "last"), learnt, written)
    other = tmp_path / "next"
    assert results_folder(str(other), {"MODEL": [str(model)]}, written) == other
    assert not other.exists()


def test_names() -> None:
    assert split_names("z1, z2", "--states") == ("z1", "z2")
    assert split_names(None, "--states") == ()
    for text in ("", "a,,b", "a,b,a"):
        with pytest.raises(InputError, match="--states"):
            split_names(text, "--states")
