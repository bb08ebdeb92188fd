"""Weaves by name, by ISO 9354 code and as rows of x and dots, through selvedge-bake; and a short run of every fuzzer.

Seen red with basket's blocks turned, with the rows taken from the bottom up, and with a fuzzer whose reader aborts."""
import json
import pathlib
import re
import subprocess

import pytest

import evaluate
from test_wif import plain_reader

ROOT = pathlib.Path(__file__).resolve().parents[1]
SCHEMA = json.loads((ROOT / "assets" / "fabrics" / "fabric.schema.json").read_text())
DOCS = (ROOT / "docs" / "patterns.md").read_text()


def drawn(path):
    """Rows of x and dots, the last pick first."""
    return ["".join("x" if up else "." for up in row) for row in reversed(plain_reader(path)[2])]


@pytest.fixture
def export(program, tmp_path):
    """export(pattern or path of a draft) -> its drawdown; the result instead where the program refuses it."""
    def run(pattern, **more):
        path = pattern
        if not isinstance(pattern, pathlib.Path):
            path = tmp_path / "fabric.json"
            path.write_text(json.dumps({"pattern": pattern} | more, indent=1))
        out = tmp_path / "out.wif"
        out.unlink(missing_ok=True)
        result = subprocess.run([program("bake"), path, "--export-draft", out], capture_output=True, text=True, timeout=60)
        assert out.exists() == (result.returncode == 0)
        return drawn(out) if out.exists() else result
    return run


def documented():
    """[(pattern, rows)] of docs/patterns.md: fenced blocks whose first line is the pattern."""
    return [(head, body.split()) for head, body in re.findall(r"```weave\n(.+)\n((?:[x.]+\n)+)```", DOCS)]


@pytest.mark.parametrize("pattern, rows", documented(), ids=lambda value: value if isinstance(value, str) else "")
def test_documented_pictures_are_what_is_woven(export, pattern, rows):
    assert export(pattern) == rows


def test_every_weave_is_listed_documented_and_in_the_schema(program):
    listed = subprocess.run([program("bake"), "--list"], capture_output=True, text=True, check=True).stdout.splitlines()
    weaves = next(k for k, line in enumerate(listed) if "ISO 9354" in line) + 1
    for line in listed[weaves:]:
        knit = re.match(r"[a-z]+( jersey| lace)?", line)[0]
        assert knit in DOCS and any(knit in example for example in SCHEMA["properties"]["knit"]["oneOf"][0]["examples"]), line
    assert len(listed) > weaves
    names = {re.match(r"[a-z ]*[a-z]", line)[0] for line in listed[:weaves] if line[0].isalpha()}
    assert names == {"plain", "basket", "warp rib", "weft rib", "twill", "broken twill", "pointed twill", "herringbone", "satin", "sateen", "crepe"}
    assert any("ISO 9354" in line for line in listed)
    examples = SCHEMA["properties"]["pattern"]["oneOf"][0]["examples"]
    for name in names:
        assert any(pattern.startswith(name) for pattern, _ in documented()) or name == "crepe"
        assert any(example.startswith(name) for example in examples), name
        assert f"`{name}" in DOCS


def test_schema_examples_weave(export):
    for example in SCHEMA["properties"]["pattern"]["oneOf"][0]["examples"]:
        assert isinstance(export(example), list), example


@pytest.mark.parametrize("code, name", [("10-0101-01-00", "plain"), ("10-0202-02-00", "basket 2/2"), ("10-0303-01-00", "warp rib 3"),
                                        ("10-0101-02-00", "weft rib 2"), ("30-0401-01-03", "satin 5"), ("30-0701-01-03", "satin 8/3")])
def test_an_iso_code_is_the_cloth_of_its_name(export, code, name):
    """But for where the repeat begins."""
    rows = export(name)
    shifts = [[row[e:] + row[:e] for row in rows[p:] + rows[:p]] for p in range(len(rows)) for e in range(len(rows[0]))]
    assert export(code) in shifts


def test_herringbone_is_the_shipped_draft(export):
    rows = export(ROOT / "assets" / "drafts" / "herringbone.wif")
    shifts = [[row[e:] + row[:e] for row in rows[p:] + rows[:p]] for p in range(4) for e in range(16)]
    assert export("herringbone 2/2") in shifts


ROWS = ["xx..x", ".xx..", "..xx."]


def test_rows_inline_in_a_file_and_as_input_are_one_cloth(export, tmp_path):
    text = tmp_path / "rows.txt"
    text.write_text("; three picks\n" + "\n".join(ROWS) + "\n")
    assert export({"rows": ROWS}) == ROWS
    assert export({"text": "rows.txt"}) == ROWS
    assert export(text) == ROWS


def test_rows_bake(program, tmp_path):
    path = tmp_path / "rows.txt"
    path.write_text("x...\n.x..\n..x.\n...x\n")
    result = subprocess.run([program("bake"), path, "--json", "--resolution", "64"], capture_output=True, text=True, timeout=60,
                            env={"SELVEDGE_CACHE": str(tmp_path / "cache")})
    assert result.returncode == 0, result.stderr
    coverage = json.loads(result.stdout)["coverage"]
    assert coverage["weft"] > 1.5 * coverage["warp"] and coverage["gap"] < 0.15


@pytest.mark.parametrize("pattern, said", [
    ("twil 2/2", ":2: unknown pattern \"twil 2/2\", expected plain; basket N or N/M; warp rib"),
    ("twill\n2/2", ":2: unknown pattern \"twill?2/2\", expected"),
    ("satin 6", ":2: pattern \"satin 6\": no regular satin"),
    ("40-0101-01-00", ":2: ISO 9354 code \"40-0101-01-00\": another kind of weave, expected 10 or 11 (plain), 20 or 21 (twill), 30 or 31 (satin)"),
    ("20-0201-01-00", ":2: ISO 9354 code \"20-0201-01-00\": a step outside the repeat, expected 01 to"),
    ({"rows": ["x.", ".x."]}, ":5: a row of 3 crossings, expected 2 as in the first row"),
    ({"rows": ["x.", ".y"]}, ":5: character 2 is \"y\", expected x (end over pick) or . (under)"),
    ({"rows": []}, ": no rows, expected rows of x and ."),
    ({"rows": "x."}, ":3: pattern.rows: no list"),
    ({"rows": [1]}, ":4: pattern.rows.0: found 1, expected text"),
    ({"rows": ["x"], "wif": "a.wif"}, ":2: pattern: 2 keys, expected one of wif, text, rows"),
    ({}, ":2: pattern: 0 keys, expected one of wif, text, rows"),
    ({"text": "none.txt"}, "none.txt"),
])
def test_what_is_no_weave_is_refused_in_one_line(export, pattern, said):
    result = export(pattern)
    assert result.returncode == 1
    assert said in result.stderr and result.stderr.count("\n") == 1, result.stderr


@pytest.mark.parametrize("yarn, said", [
    ({"section": "oval"}, ":4: warp.section: found \"oval\", expected one of ellipse, racetrack"),
    ({"section": "racetrack", "aspect": 1.1}, ":5: warp.aspect: found 1.1, expected at most 1: a race-track is wider than high"),
    ({"fibre": "hemp"}, ":4: warp.fibre: found \"hemp\", expected "),
    ({"tex": 0}, ":4: warp.tex: found 0, expected a number from 0.1"),
])
def test_yarns_that_cannot_be_are_refused_in_one_line(export, yarn, said):
    result = export("plain", warp=yarn)
    assert result.returncode == 1
    assert said in result.stderr and result.stderr.count("\n") == 1, result.stderr


def test_tex_gives_the_width_and_a_stated_width_wins(program, tmp_path):
    path = tmp_path / "fabric.json"
    path.write_text(json.dumps({"pattern": "plain", "warp": {"tex": 20, "plies": 1, "aspect": 1}, "weft": {"tex": 20, "width": 0.0003}}))
    lengths = json.loads(subprocess.run([program("bake"), path, "--json", "--resolution", "64"], capture_output=True, text=True, check=True).stdout)["lengths"]
    assert lengths["warp"] == {"spacing": pytest.approx(0.0005), "width": pytest.approx(0.0001671, rel=1e-3)}   # Peirce
    assert lengths["weft"]["width"] == pytest.approx(0.0003)


def test_yarn_enumerations_are_the_schema_s(export):
    """The message lists what the program takes."""
    yarn = SCHEMA["$defs"]["yarn"]["properties"]
    for key in ("section", "fibre"):
        assert set(export("plain", warp={key: "?"}).stderr.split("expected one of ")[1].strip().split(", ")) == set(yarn[key]["enum"])


FUZZERS = sorted(ROOT.glob("tests/cpp/fuzz_*.cpp"))


@pytest.mark.parametrize("reader", [path.stem.removeprefix("fuzz_") for path in FUZZERS if path.stem != "fuzz_main"])
def test_a_short_run_of_every_fuzzer_finds_nothing(reader, shared_data, tmp_path):
    """The long runs, under sanitizers and led by coverage: ./dev fuzz."""
    corpus = [ROOT / "assets" / "drafts", *(folder for name in ("wif", "wif_malformed", "knit") if (folder := shared_data / name).is_dir())]
    run = subprocess.run([evaluate.BIN / f"selvedge-fuzz-{reader}", "--seconds", "3", *corpus], capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert run.returncode == 0 and run.stdout.endswith("no finding\n"), run.stderr
    assert int(run.stdout.split()[0]) > 100
