"""Keys of a case file as they are told: every one that the schema takes, with a meaning; and lines of wrong ones."""

import re
from pathlib import Path

import msgspec
import pytest

import mgsgraph
from mgsgraph.case.case_file import HEAD, key_tables, keys_text
from mgsgraph.case.schema import CaseInput, ImageInput
from mgsgraph.errors import InputError

TABLES = {table.path or HEAD: table for table in key_tables()}


def test_every_key_is_there_with_a_meaning_and_a_kind() -> None:
    assert {"head", "images", "orientation", "ties", "spice", "solver", "terrain", "passes.nodes"} <= set(TABLES)
    for kind, name in ((CaseInput, HEAD), (ImageInput, "images")):
        assert [key.name for key in TABLES[name].keys] == [field.name for field in msgspec.structs.fields(kind)]
    for table in TABLES.values():
        assert table.meaning
        for key in table.keys:
            assert key.meaning, f"{table.head} {key.name}"
            assert re.fullmatch(r"[a-z\d\"][\w ,\"+/-]*", key.kind), f"{table.head} {key.name}: {key.kind}"
    (kernels,) = [key for key in TABLES["images"].keys if key.name == "kernels"]
    assert kernels.kind == "list of texts"
    (loss,) = [key for key in TABLES["solver"].keys if key.name == "loss"]
    assert (loss.kind, loss.default) == ('"none", "huber", "cauchy", "tukey"', '"none"')


@pytest.mark.parametrize("name", ["images", "[[images]]", "IMAGES"])
def test_one_table_alone(name: str) -> None:
    text = keys_text(name)
    assert text.startswith("[[images]]")
    assert "\n  isd (text)\n" in text
    assert "[solver]" not in text
    assert max(map(len, text.splitlines())) <= 110


@pytest.mark.parametrize(("name", "near"), [("imags", "images"), ("nodes", "passes.nodes"), ("sulver", "solver")])
def test_a_table_that_there_is_not_names_the_nearest(name: str, near: str) -> None:
    with pytest.raises(InputError, match=f"did you mean {near}"):
        keys_text(name)


WRONG = {
    "in a table of several": ('isd = "image_B', 'isdd = "image_B', r"images\[1\] .*'isdd'; did you mean 'isd'"),
    "in an inline table": ("trend = [", "sub = {a = 1}\ntrend = [", "orientation: .*'sub'"),
    "of another table": ('isd = "image_B', 'sigma_px = 1.0\nisd = "image_B', r"images\[1\] .*it is a key of \[ties\]"),
    "of the wrong kind": ("degree = 2", 'degree = "two"', "orientation.degree: 'two'"),
    "missing": ('network = "network.pvl"\n', "", "ties: no key 'network'"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_wrong_is_named_with_its_line(case_file: Path, fault: str) -> None:
    old, new, said = WRONG[fault]
    text = case_file.read_text(encoding="utf-8")
    assert old in text
    case_file.write_text(text.replace(old, new), encoding="utf-8")
    at = text[: text.index(old)].count("\n") + 1
    line = at - 1 if fault == "missing" else at
    with pytest.raises(InputError, match=rf"case.toml, line {line}, {said}"):
        mgsgraph.read_case(case_file)


def test_data_in_the_place_of_a_case_file_say_how_to_come_by_one(case_file: Path) -> None:
    for data in (case_file.with_name("image_A.isd"), case_file.with_name("network.pvl"), case_file.parent):
        with pytest.raises(InputError, match=f"make one: mgsgraph new {data}"):
            mgsgraph.read_case(data)
