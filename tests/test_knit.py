"""Knits from outside: structures, charts, knitout, presets, both renderers, and what is refused.

Seen red with k2tog's stitches in the wrong order, a purl face that showed legs, and plies that missed each other where the
yarn closes. Geometry is tested in cpp/knit_test.cpp."""
import json
import pathlib
import subprocess

import numpy as np
import OpenEXR
import PIL.Image
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
STRUCTURES = ("jersey", "reverse jersey", "rib 1x1", "rib 2x2", "garter", "seed", "moss", "interlock", "eyelet lace", "cable 4")


@pytest.fixture
def knit(tmp_path):
    """knit(what, name=…, **keys) -> path of a fabric file with that knit."""
    def write(what, name="knit.json", **keys):
        path = tmp_path / name
        path.write_text(json.dumps({"knit": what, **keys}, indent=1))
        return path
    return write


def report(result):
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def layers(folder):
    channels = OpenEXR.File(str(folder / "maps.exr"), separate_channels=True).channels()
    return lambda name: np.flipud(channels[name].pixels).astype("f8")   # row 0 at v = 0


@pytest.mark.parametrize("structure", STRUCTURES)
def test_every_structure_bakes_and_tiles(bake, knit, tmp_path, structure):
    path = knit(structure, yarn={"width": 0.0003, "plies": 2})
    result = report(bake(path, "--json", "-o", tmp_path / "out", "--resolution", 192))
    assert result["coverage"]["warp"] == 0 and sum(result["coverage"].values()) == pytest.approx(1)
    assert 0.5 < result["coverage"]["weft"] <= 1
    assert result["yarns"] == ["yarn"]
    layer = layers(tmp_path / "out")
    for side in ("front", "back"):
        height = layer(f"{side}.height")
        assert np.isfinite(height).all() and np.ptp(height) > 0.0003   # thicker than one yarn
        assert abs(layer(f"{side}.slope.x").mean()) < 0.05 and abs(layer(f"{side}.slope.y").mean()) < 0.05
        for axis in (0, 1):   # over the seam the field steps no more than elsewhere
            steps = np.abs(np.diff(height, axis=axis, append=height.take([0], axis=axis)))
            assert steps.take(-1, axis=axis).mean() < 2.5 * steps.mean()
    assert (layer("front.gap") == layer("back.gap")).all()


def test_lengths_follow_each_other(bake, knit):
    texels = lambda **keys: report(bake(knit("jersey", **keys), "--json", "--resolution", 256))["texels"]
    square = texels(wale_spacing=0.001, course_spacing=0.001)
    assert square == [256, 256]
    assert texels(wale_spacing=0.002, course_spacing=0.001) == [256, 128]
    assert texels(yarn={"width": 0.0004}) == [256, 216]   # Peirce: 4 to 3.364


def test_a_yarn_that_does_not_fit_is_narrowed_and_said(bake, knit):
    result = report(bake(knit("jersey", wale_spacing=0.0005, course_spacing=0.0005, yarn={"width": 0.0004}), "--json"))
    assert any("narrowed to 0.00023 m" in warning for warning in result["warnings"])


def test_cache_knows_knits_apart(bake, knit):
    path = knit("jersey", yarn={"width": 0.0003})
    cached = lambda *extra: report(bake(path, "--json", "--resolution", 64, *extra))["cached"]
    assert not cached()
    assert cached("-D", "yarn.albedo=[0.2,0.3,0.4]", "-D", "yarn.fibre_twist=3")
    for change in ("knit=garter", "yarn.width=0.00025", "wale_spacing=0.0014", "loop_length=0.006", "yarn.aspect=0.6"):
        assert not cached("-D", change), change
    assert cached()


def test_charts_give_the_built_in_structure(bake, knit, tmp_path):
    (tmp_path / "seed.txt").write_text("kp\npk\n")
    (tmp_path / "seed.csv").write_text("k,p\np,k\n")
    keys = {"yarn": {"width": 0.0003}}
    same = [report(bake(knit(what, **keys), "--json", "--resolution", 96, "-o", tmp_path / str(i)))["coverage"]
            for i, what in enumerate(("seed", {"chart": "seed.txt"}, {"chart": "seed.csv"}))]
    assert same[0] == same[1] == same[2]


def test_a_picture_is_colour_work(bake, knit, tmp_path):
    """One pixel a stitch, top row first: the front shows the picture, the back its floats."""
    picture = np.full((6, 8, 3), 240, "u1")
    picture[1:3, 2:5] = [200, 30, 20]
    PIL.Image.fromarray(picture).save(tmp_path / "work.png")
    result = report(bake(knit({"chart": "work.png"}, yarn={"width": 0.0003, "plies": 1}), "--json", "-o", tmp_path / "out"))
    assert sorted(result["yarns"]) == ["yarn #c81e14", "yarn #f0f0f0"]
    layer, red = layers(tmp_path / "out"), result["yarns"].index("yarn #c81e14")
    yarn = layer("front.yarn")
    h, w = yarn.shape
    shown = np.array([[max(yarn[int((5 - y + 0.8) / 6 * h) % h, int((x + dx) / 8 * w)] == red for dx in (0.3, 0.7)) for x in range(8)]
                      for y in range(6)])
    assert (shown == (picture[..., 1] == 30)).mean() > 0.9
    back = layer("back.yarn")[layer("back.gap") == 0]
    assert 0.02 < (back == red).mean() < 0.6
    bare = report(bake(tmp_path / "work.png", "--json"))
    assert bare["yarns"] == result["yarns"]


def test_jersey_preset_looks_the_same_in_both_renderers(program, tmp_path):
    scene = {"camera": {"position": [0, 0.05, 0.02], "target": [0, 0, 0], "up": [0, 1, 0], "fov": 12}, "film": {"resolution": [48, 48]},
             "lights": [{"type": "environment", "colour": [0.3, 0.35, 0.4]},
                        {"type": "directional", "direction": [0.6, -0.7, -0.3], "irradiance": [4, 3.9, 3.7], "angular_diameter": 0.53}],
             "objects": [{"shape": "plane", "scale": 0.1, "fabric": str(ROOT / "assets/fabrics/cotton_jersey.json"), "uv_scale": 0.1}]}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    run = lambda name, *arguments: subprocess.run([program(name), *map(str, arguments)], capture_output=True, text=True, timeout=300)
    a, b = tmp_path / "a.exr", tmp_path / "b.exr"
    assert run("render", tmp_path / "scene.json", "-o", a, "--spp", 512, "-q").returncode == 0
    assert run("lookdev", tmp_path / "scene.json", "--headless", "-o", b, "--frames", 512, "-q").returncode == 0
    compared = json.loads(run("compare", b, a, "--json").stdout)
    assert abs(compared["mean_relative_bias"]) < 0.005
    assert compared["z_outliers"] < 0.015


BAD_FABRICS = {
    "unknown structure": ('{\n"knit": "jersy"}', ':2: unknown knit "jersy", expected jersey, reverse jersey'),
    "both": ('{"knit": "jersey",\n"pattern": "plain"}', ':2: pattern: stands beside "knit"'),
    "warp": ('{"knit": "jersey",\n"warp": {}}', ':2: warp: stands beside "knit"'),
    "yarn of a weave": ('{"pattern": "plain 1/1",\n"yarn": {}}', ':2: yarn: a knit\'s, expected "knit" beside it'),
    "spacing": ('{"knit": "jersey",\n"yarn": {"spacing": 0.001}}', ":2: yarn.spacing: a woven yarn's, expected wale_spacing"),
    "section": ('{"knit": "jersey",\n"yarn": {"section": "racetrack"}}', ":2: yarn.section: a woven yarn's: knitted yarns are ellipses"),
    "range": ('{"knit": "jersey",\n"wale_spacing": 0}', ":2: wale_spacing: found 0, expected a number from 4e-05 to 0.1"),
    "loop": ('{"knit": "jersey", "loop_length": 0.0001}', ":1: loop_length: found 0.0001, expected a number from "),
    "two": ('{"knit": {"chart": "a.txt", "knitout": "a.k"}}', ":1: knit: 2 keys, expected one of chart, knitout"),
    "none": ('{"knit": {}}', ":1: knit: 0 keys, expected one of chart, knitout"),
    "key": ('{"knit": {"chrt": "a.txt"}}', ':1: knit.chrt: unknown key "chrt", expected "chart"'),
    "missing chart": ('{"knit": {"chart": "none.txt"}}', "none.txt: no such file"),
    "missing knitout": ('{"knit": {"knitout": "none.k"}}', "none.k: no such file"),
    "type": ('{"knit": 3}', ":1: knit: "),
}


@pytest.mark.parametrize("name", BAD_FABRICS)
def test_bad_knits_name_file_line_and_key(bake, tmp_path, name):
    content, expected = BAD_FABRICS[name]
    (tmp_path / "fabric.json").write_text(content)
    result = bake("fabric.json", "--preview", tmp_path / "sheet.png")
    assert result.returncode == 1 and result.stdout == ""
    assert result.stderr.startswith("selvedge-bake: ") and result.stderr.count("\n") == 1
    assert expected in result.stderr
    assert not (tmp_path / "sheet.png").exists()


BAD_CHARTS = {
    "empty.chart": (b"", "empty.chart: no rows"),
    "html.chart": (b"<html><body>404</body></html>\n", 'html.chart:1: stitch "h"'),
    "binary.chart": (bytes(range(256)), "binary.chart:1: a NUL byte"),
    "ragged.csv": (b"k,k\nk\n", "ragged.csv:2: row has 1 stitches, expected 2 as on line 1"),
    "open.chart": (b"kko\n", "open.chart:1: row 1 from the bottom takes 2 loops"),
    "wide.chart": (b"k" * 5000, "wide.chart:1: a chart of more than 1024 columns"),
    "huge.chart": (b"k\n" * 3_000_000, "huge.chart: "),
    "not.png": (b"k,k\n", "not.png: "),
    "empty.k": (b"", "empty.k:1: an empty file, expected ;!knitout-2"),
    "text.k": (b"hello\n", 'text.k:1: "hello", expected ;!knitout-2'),
    "latin.k": (b";!knitout-2\n\xe9\xff + f1 1\n", 'latin.k:2: operation "??"'),
    "unknown.k": (b";!knitout-2\nfly f1\n", 'unknown.k:2: operation "fly", expected knit'),
    "nothing.k": (b";!knitout-2\n;;Carriers: 1\n", "nothing.k: no loop is drawn through another"),
}


@pytest.mark.parametrize("name", BAD_CHARTS)
def test_bad_charts_are_refused_in_a_line(bake, tmp_path, name):
    content, expected = BAD_CHARTS[name]
    (tmp_path / name).write_bytes(content)
    result = bake(name)
    assert result.returncode == 1 and result.stdout == ""
    assert expected in result.stderr and result.stderr.count("\n") == 1


def test_a_picture_beyond_the_limits_is_refused(bake, tmp_path):
    PIL.Image.fromarray(np.zeros((1025, 4, 3), "u1")).save(tmp_path / "tall.png")
    assert "4 x 1025 pixels, expected at most 1024 a side" in bake("tall.png").stderr
    PIL.Image.fromarray(np.random.default_rng(1).integers(0, 255, (12, 12, 3)).astype("u1")).save(tmp_path / "photo.png")
    assert "more than 32 colours" in bake("photo.png").stderr


# Real files: the number of yarns of the fabric, or why it is refused.
KNITOUT = {
    "singlejersey.knitout": 1, "garter.knitout": 1, "rib-2x2.knitout": 1, "interlock.knitout": 1, "MilanoRib.knitout": 1,
    "Tutorial1_helloworld.k": 1, "Tutorial2_rib1x1.k": 1, "d_truncated.k": 1, "k.knitout": 1, "kniterate_small-square.k": 1,
    "image-kp-half-rib.k": 1,
    "kniterate_annotated-knitout-1.k": ": no repeat: the longest even run is 1 of 7 rows",
    "intarsia.knitout": ": this loop stays open where",
    "kniterate_split.k": ":16: split: draws a loop out of loops that stay, which is not covered",
    "hyperbolic-plane.knitout": ": this loop stays open where",
    "khoury_jacquard_seed.k": ": this loop stays open where",
    "khoury_seed_jacquard.k": ": this loop stays open where",
    "kniterate_colorwork-cheese.k": ": this loop stays open where",
    "kniterate_small-square.kc": ":1: ",
}


@pytest.mark.shared_data
@pytest.mark.parametrize("name", KNITOUT)
def test_real_knitout_bakes_or_says_why_not(bake, knit, shared_data, name):
    fabric = knit({"knitout": str(shared_data / "knit" / name)}, yarn={"width": 0.0003, "plies": 1})
    result = bake(fabric, "--json", "--resolution", 64)
    if isinstance(KNITOUT[name], int):
        assert len(report(result)["yarns"]) == KNITOUT[name]
    else:
        assert result.returncode == 1 and result.stderr.count("\n") == 1
        where, why = KNITOUT[name].rsplit(": ", 1)
        assert f"{name}{where}" in result.stderr and why in result.stderr


@pytest.mark.shared_data
def test_real_knitout_has_the_face_that_its_name_says(bake, knit, shared_data, tmp_path):
    """Share of covered texels where the yarn runs along the wales, front and back."""
    def legs(name):
        fabric = knit({"knitout": str(shared_data / "knit" / name)}, yarn={"width": 0.0003, "plies": 1})
        assert bake(fabric, "-q", "--resolution", 128, "-o", tmp_path / name).returncode == 0
        layer = layers(tmp_path / name)
        return [(np.abs(layer(f"{s}.azimuth")[layer(f"{s}.gap") == 0] - np.pi / 2) < np.pi / 4).mean() for s in ("front", "back")]
    front, back = legs("singlejersey.knitout")
    assert front > 0.7 and back < 0.5
    front, back = legs("garter.knitout")
    assert front == pytest.approx(back, abs=0.03) and front < 0.7
    front, back = legs("interlock.knitout")
    assert front == pytest.approx(back, abs=0.03) and front > 0.7


@pytest.mark.shared_data
def test_real_chart_pictures_bake(bake, knit, shared_data):
    """The charts of textiles-lab: a pixel a stitch. 40 x 60 stitches are a tile of 2000 texels: only reading is asked for here."""
    for name in ("image-kp-half-rib.png", "image-lace-test.png"):
        picture = np.asarray(PIL.Image.open(shared_data / "knit" / name).convert("RGB"))[:6, :8]
        PIL.Image.fromarray(picture).save(knit("jersey").parent / name)
        result = report(bake(knit({"chart": name}), "--json", "--resolution", 64))
        assert len(result["yarns"]) == len(np.unique(picture.reshape(-1, 3), axis=0))
