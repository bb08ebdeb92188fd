"""docs/fabrics.md is true: every preset has its section, pictures and row, and the rows are what the programs say today.

Seen red with a preset's tex changed, with a row's reflectance off by 0.02, and with a map sheet removed."""
import json
import re

import pytest

import fabric_pages

PAGE = (fabric_pages.DOCS / "fabrics.md").read_text()
PRESETS = dict(fabric_pages.presets())
MEASURED = 4      # last cells of a row: R and T
STALE = 0.01      # a change of the model that moves one of those by more asks for ./dev fabrics


def test_every_preset_has_its_section_and_pictures_and_nothing_else_has():
    assert re.findall(r'^## <a name="(\w+)"></a>', PAGE, re.M) == list(PRESETS)
    pictures = {f"{name}{suffix}.jpg" for name in PRESETS for suffix in ("", "_maps")}
    assert set(re.findall(r"\]\(fabrics/([^)]+)\)", PAGE)) == pictures == {path.name for path in (fabric_pages.DOCS / "fabrics").iterdir()}


@pytest.mark.parametrize("name", PRESETS)
def test_the_row_of_a_preset_is_what_the_program_says(program, name, monkeypatch, tmp_path):
    monkeypatch.setattr(fabric_pages, "BIN", program("bake").parent)
    monkeypatch.setenv("SELVEDGE_CACHE", str(tmp_path))
    report = json.loads(fabric_pages.run("selvedge-bake", fabric_pages.FABRICS / f"{name}.json", "--albedo", "--json"))
    assert report["warnings"] == []
    said = next(line for line in PAGE.splitlines() if f"](#{name})" in line).strip("| ").split(" | ")
    found = fabric_pages.row(name, PRESETS[name], report)
    assert said[:-MEASURED] == found[:-MEASURED]
    assert [float(cell) for cell in said[-MEASURED:]] == pytest.approx([float(cell) for cell in found[-MEASURED:]], abs=STALE)
